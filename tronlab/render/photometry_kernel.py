# pyright: basic
"""The photometric functions in numbers: one formula for kernels and for arrays.

The functions use arithmetic alone that numpy does on arrays and numba on numbers; inside a kernel
they are compiled into it. Cosines are of the angles of incidence, emission and phase; the first two
must not be negative, and not both 0.
"""

from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from tronlab.render.photometry import Hapke, LunarLambert, Photometry

LAMBERT, LOMMEL_SEELIGER, LUNAR_LAMBERT, HAPKE = range(4)
_KINDS = {
    "lambert": LAMBERT,
    "lommel_seeliger": LOMMEL_SEELIGER,
    "lunar_lambert": LUNAR_LAMBERT,
    "hapke": HAPKE,
}
_MCEWEN_1996 = (1.0, -0.019, 0.242e-3, -1.46e-6)
"""The Moon's L(g), in powers of the phase angle in degrees."""
_N_VALUES = 5

inlined: Any = register_jitable(nogil=True, error_model="numpy", _nrt=False, forceinline=True)


class PhotometryNumbers(NamedTuple):
    """A photometric function as the kernels see it."""

    kind: int
    """LAMBERT, LOMMEL_SEELIGER, LUNAR_LAMBERT or HAPKE."""
    values: tuple[float, ...]
    """Five parameters, those not needed 0. Lunar-Lambert: L(g) in powers of g in degrees. Hapke: w,
    b, c, B0 and h."""


def numbers_of(photometry: Photometry) -> PhotometryNumbers:
    """Give a photometric function as the kernels see it."""
    values: tuple[float, ...] = ()
    if isinstance(photometry, LunarLambert):
        values = _MCEWEN_1996 if photometry.weight is None else (photometry.weight,)
    elif isinstance(photometry, Hapke):
        values = (
            photometry.single_scattering_albedo,
            photometry.phase_asymmetry,
            photometry.phase_backward,
            photometry.opposition_amplitude,
            photometry.opposition_width,
        )
    padded = *values, *[0.0] * (_N_VALUES - len(values))
    return PhotometryNumbers(_KINDS[photometry.kind], padded)


@inlined
def reflected(numbers, cos_incidence, cos_emission, cos_phase):
    """Give the radiance factor that ``numbers`` stands for; formulas in ``photometry``."""
    if numbers.kind == LAMBERT:
        return cos_incidence
    if numbers.kind == LOMMEL_SEELIGER:
        return lommel_seeliger(cos_incidence, cos_emission)
    if numbers.kind == LUNAR_LAMBERT:
        share = lunar_share(numbers.values, cos_phase)
        one_scattering = lommel_seeliger(cos_incidence, cos_emission)
        return share * one_scattering + (1.0 - share) * cos_incidence
    return hapke(numbers.values, cos_incidence, cos_emission, cos_phase)


@inlined
def lommel_seeliger(mu0, mu):
    """Give 2 mu0 / (mu0 + mu)."""
    return 2.0 * mu0 / (mu0 + mu)


@inlined
def lunar_share(powers, cos_phase):
    """Give L(g), the share of Lommel-Seeliger, not below 0."""
    g = np.degrees(arccosine(cos_phase))
    share = powers[0] + g * (powers[1] + g * (powers[2] + g * powers[3]))
    return np.maximum(share, 0.0)


@inlined
def hapke(values, mu0, mu, cos_phase):
    """Give pi r(i, e, g) of Hapke's model without macroscopic roughness."""
    w, b, c, amplitude, width = values
    surge = 1.0 + shadow_hiding(amplitude, width, cos_phase)
    once = surge * double_henyey_greenstein(b, c, cos_phase)
    often = chandrasekhar_h(w, mu0) * chandrasekhar_h(w, mu) - 1.0
    return 0.25 * w * mu0 / (mu0 + mu) * (once + often)


@inlined
def shadow_hiding(amplitude, width, cos_phase):
    """Give B(g), with tan(g/2) from the cosine of g."""
    tan_half = np.sqrt(np.maximum(1.0 - cos_phase, 0.0) / np.maximum(1.0 + cos_phase, 1e-12))
    return amplitude / (1.0 + tan_half / width)


@inlined
def double_henyey_greenstein(b, c, cos_phase):
    """Give p(g): a backward lobe of weight (1 + c) / 2 and a forward lobe of (1 - c) / 2."""
    backward = 1.0 - 2.0 * b * cos_phase + b * b
    forward = 1.0 + 2.0 * b * cos_phase + b * b
    lobes = (1.0 + c) / (backward * np.sqrt(backward)) + (1.0 - c) / (forward * np.sqrt(forward))
    return 0.5 * (1.0 - b * b) * lobes


@inlined
def chandrasekhar_h(w, x):
    """Give H(x) for isotropic scatterers in Hapke's approximation of 2002."""
    root = np.sqrt(1.0 - w)
    r0 = (1.0 - root) / (1.0 + root)
    x = np.maximum(x, 1e-12)
    return 1.0 / (1.0 - w * x * (r0 + 0.5 * (1.0 - 2.0 * r0 * x) * np.log((1.0 + x) / x)))


@inlined
def arccosine(x):
    """Give the arc cosine to 2e-8 rad, without the branches that keep loops from being vectorised.

    Abramowitz and Stegun, Handbook of Mathematical Functions (1964), equation 4.4.46.
    """
    a = np.minimum(np.abs(x), 1.0)
    series = 0.0066700901 - 0.0012624911 * a
    series = 0.0308918810 + a * (-0.0170881256 + a * series)
    series = 0.0889789874 + a * (-0.0501743046 + a * series)
    series = 1.5707963050 + a * (-0.2145988016 + a * series)
    return 0.5 * np.pi - np.copysign(0.5 * np.pi - np.sqrt(1.0 - a) * series, x)
