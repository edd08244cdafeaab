"""The photometric functions once more, for Dr.Jit's arrays.

Written from the publications that ``photometry`` names and not from ``photometry_kernel``: where
two renderers agree, the formulas have been written down twice.
"""

from typing import Any

from tronlab.render.photometry import Hapke, Lambert, LommelSeeliger, LunarLambert, Photometry


def reflected(dr: Any, photometry: Photometry, mu0: Any, mu: Any, phase_rad: Any) -> Any:
    """Give the radiance factor of a surface, scaled as in ``photometry``.

    Args:
        dr: Dr.Jit.
        photometry: The function.
        mu0: Cosine of the angle of incidence, positive.
        mu: Cosine of the angle of emission, not negative.
        phase_rad: Angle between the directions to lamp and camera.
    """
    match photometry:
        case Lambert():
            return mu0
        case LommelSeeliger():
            return 2 * mu0 / (mu0 + mu)
        case LunarLambert(weight=weight):
            share = _moons_share(dr, phase_rad) if weight is None else weight
            return mu0 * (1 + share * (2 / (mu0 + mu) - 1))
        case Hapke():
            return _hapke(dr, photometry, mu0, mu, phase_rad)


def _moons_share(dr: Any, phase_rad: Any) -> Any:
    """Give L(g) of McEwen (Lunar and Planetary Science XXVII, 1996); it stays 0 from its root."""
    g = dr.rad2deg(phase_rad)
    return dr.maximum(1 - 1.9e-2 * g + 2.42e-4 * g**2 - 1.46e-6 * g**3, 0)


def _hapke(dr: Any, model: Hapke, mu0: Any, mu: Any, phase_rad: Any) -> Any:
    """Give pi times the bidirectional reflectance (Hapke, JGR 86, 1981, equation 16).

    That is without coherent backscatter and macroscopic roughness.
    """
    w = model.single_scattering_albedo
    b, c = model.phase_asymmetry, model.phase_backward
    half_tangent = dr.tan(0.5 * dr.minimum(phase_rad, 3.1415))
    surge = model.opposition_amplitude / (1 + half_tangent / model.opposition_width)
    cosine = dr.cos(phase_rad)
    lobes = (1 + c) / 2 * _henyey_greenstein(b, cosine)
    lobes += (1 - c) / 2 * _henyey_greenstein(-b, cosine)
    multiple = _multiple_scattering(dr, w, mu0) * _multiple_scattering(dr, w, mu) - 1
    return w / 4 * mu0 / (mu0 + mu) * ((1 + surge) * lobes + multiple)


def _henyey_greenstein(b: float, cosine: Any) -> Any:
    """Give a lobe of mean 1 over the sphere; b > 0 lies towards the lamp."""
    return (1 - b**2) / (1 - 2 * b * cosine + b**2) ** 1.5


def _multiple_scattering(dr: Any, w: float, x: Any) -> Any:
    """Give H(x) of Hapke (Icarus 157, 2002, equation 13)."""
    gamma = (1 - w) ** 0.5
    r0 = (1 - gamma) / (1 + gamma)
    x = dr.maximum(x, 1e-6)
    return 1 / (1 - w * x * (r0 + (1 - 2 * r0 * x) / 2 * dr.log((1 + x) / x)))
