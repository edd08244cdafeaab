"""How a surface reflects light: the photometric functions of planetary science.

Each gives the radiance factor, pi times the bidirectional reflectance r(i, e, g) of Hapke, where i
is the angle of incidence, e of emission and g the phase angle, mu0 = cos i and mu = cos e. With the
lamp's intensity as in ``renderer.Lamp``, the radiance of a surface is ``intensity * albedo *
reflected / distance^2``. The first three are 1 at i = e = g = 0, so that the albedo is the normal
albedo; Hapke's has its own brightness, and the albedo scales it.

    B. Hapke, Journal of Geophysical Research 86 (1981), 3039: Hapke's model.
    B. Hapke, Icarus 157 (2002), 523: its better function H.
    B. Hapke, Theory of Reflectance and Emittance Spectroscopy, 2nd edition, Cambridge 2012.
    A. S. McEwen, Icarus 92 (1991), 298: the lunar-Lambert function.
    A. S. McEwen, Lunar and Planetary Science XXVII (1996), 841: the Moon's L(g).
    H. Sato et al., Journal of Geophysical Research: Planets 119 (2014), 1775: the Moon's values.
"""

from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BeforeValidator, Field

from tronlab.yaml_models import Model


class Lambert(Model):
    """Equally bright from all sides: ``mu0``."""

    kind: Literal["lambert"] = "lambert"


class LommelSeeliger(Model):
    """A dark medium that scatters once: ``2 mu0 / (mu0 + mu)``.

    It says nothing of light that is scattered again: a surface of albedo 1 would send back more
    than it gets. For dark surfaces, of albedo 0.25 and less, it never does.
    """

    kind: Literal["lommel_seeliger"] = "lommel_seeliger"


class LunarLambert(Model):
    """McEwen's lunar-Lambert function: ``L 2 mu0 / (mu0 + mu) + (1 - L) mu0``.

    The Moon's L(g) is ``1 - 0.019 g + 0.242e-3 g^2 - 1.46e-6 g^3``, g in degrees (McEwen 1996). It
    is held at 0 where that would be negative, beyond 104 degrees.
    """

    kind: Literal["lunar_lambert"] = "lunar_lambert"
    weight: Annotated[float, Field(ge=0, le=1)] | None = None
    """L, the share of Lommel-Seeliger, for all phase angles; without it the Moon's L(g)."""


class Hapke(Model):
    """Hapke's model of a particulate surface, without macroscopic roughness.

    ``w/4 mu0/(mu0 + mu) [(1 + B(g)) p(g) + H(mu0) H(mu) - 1]`` (Hapke 1981, equation 16), with

    - ``B(g) = B0 / (1 + tan(g/2) / h)``, the opposition surge by shadow hiding (Hapke 2012, 9.22);
    - ``p(g) = (1 + c)/2 (1 - b^2) / (1 - 2 b cos g + b^2)^(3/2) + (1 - c)/2 (1 - b^2) / (1 + 2 b
      cos g + b^2)^(3/2)``, the double Henyey-Greenstein function (Hapke 2012, 6.7a);
    - ``1/H(x) = 1 - w x (r0 + (1 - 2 r0 x)/2 ln((1 + x)/x))``, ``r0 = (1 - s)/(1 + s)``, ``s =
      sqrt(1 - w)`` (Hapke 2002, equation 13), within 1 % of Chandrasekhar's function, where the
      form of 1981 is within 4 %.

    The defaults are the mare at the landing site of Apollo 11, 643 nm: the cell at 23.5 degrees
    east and 0.5 degrees north of the maps of Sato et al. (2014). Their surge takes in what coherent
    backscattering adds, so that B0 exceeds 1. They were found together with a mean slope of 23.7
    degrees below the maps' resolution. That roughness is left out here: the terrain has slopes and
    shadows of its own, which would count twice.
    """

    kind: Literal["hapke"] = "hapke"
    single_scattering_albedo: Annotated[float, Field(gt=0, lt=1)] = 0.222
    """w."""
    phase_asymmetry: Annotated[float, Field(ge=0, lt=1)] = 0.254
    """b: how narrow both lobes of the phase function are."""
    phase_backward: Annotated[float, Field(ge=-1, le=1)] = 0.160
    """c: the backward lobe has the share (1 + c) / 2 of the light, the forward lobe the rest."""
    opposition_amplitude: Annotated[float, Field(ge=0, le=4)] = 1.993
    """B0: at phase angle 0, light scattered once is 1 + B0 times as strong."""
    opposition_width: Annotated[float, Field(gt=0, le=1)] = 0.0597
    """h: the surge has half its height at the phase angle 2 atan(h)."""


def by_name(value: Any) -> Any:
    """Let a function be asked for by its name alone: ``photometry: lambert``."""
    return {"kind": value} if isinstance(value, str) else value


Photometry: TypeAlias = Annotated[
    Lambert | LommelSeeliger | LunarLambert | Hapke, Field(discriminator="kind")
]
PhotometryName: TypeAlias = Literal["lambert", "lommel_seeliger", "lunar_lambert", "hapke"]
PhotometryField: TypeAlias = Annotated[
    Photometry, BeforeValidator(by_name, json_schema_input_type=PhotometryName | Photometry)
]
"""As a YAML file has it: a name, or a mapping with ``kind`` and the function's parameters."""


def reflected(
    photometry: Photometry,
    cos_incidence: ArrayLike,
    cos_emission: ArrayLike,
    phase_rad: ArrayLike,
) -> NDArray[np.float64]:
    """Give the radiance factor of a surface of albedo 1.

    Args:
        photometry: The photometric function.
        cos_incidence: Cosine of the angle of incidence.
        cos_emission: Cosine of the angle of emission; taken as 0 where it is negative.
        phase_rad: Angle between the directions to the lamp and to the eye.

    Returns:
        Of the shape the arguments are broadcast to; 0 where the lamp is not over the surface.
    """
    # numba takes half a second to import: not for everybody who names a photometric function.
    from tronlab.render import photometry_kernel

    cos_incidence, cos_emission, phase = np.broadcast_arrays(cos_incidence, cos_emission, phase_rad)
    is_facing = cos_incidence > 0
    factor = photometry_kernel.reflected(
        photometry_kernel.numbers_of(photometry),
        np.where(is_facing, cos_incidence, 1.0),
        np.maximum(cos_emission, 0.0),
        np.cos(phase),
    )
    return np.where(is_facing, factor, 0.0)
