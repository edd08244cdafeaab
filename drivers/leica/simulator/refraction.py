"""Refractive index of air: Edlen's equation as revised by Birch and Downs (Metrologia 31, 1994)."""

from math import exp
from typing import Final

from tronlab.devices.readings import AirReading

IFM_WAVELENGTH_UM: Final = 0.6328
"""Of the interferometer's laser (helium-neon)."""
ADM_WAVELENGTH_UM: Final = 0.795
"""Of the absolute distance meter's; the AT901's own is not published, this is a usual one."""
_STEP_UM: Final = 1e-4


def ifm_index(air: AirReading) -> float:
    """Give the index that an interferometer sees: that of the phase."""
    return _phase_index(air, IFM_WAVELENGTH_UM)


def adm_index(air: AirReading) -> float:
    """Give the index that modulated light sees: that of the group."""
    low, high = (_phase_index(air, ADM_WAVELENGTH_UM + sign * _STEP_UM) for sign in (-1.0, 1.0))
    slope = (high - low) / (2.0 * _STEP_UM)
    return _phase_index(air, ADM_WAVELENGTH_UM) - ADM_WAVELENGTH_UM * slope


def _phase_index(air: AirReading, wavelength_um: float) -> float:
    wavenumber2 = wavelength_um**-2
    celsius = air.temperature_k - 273.15
    standard = 1e-8 * (8342.54 + 2406147.0 / (130.0 - wavenumber2) + 15998.0 / (38.9 - wavenumber2))
    density = (
        air.pressure_pa
        / 96095.43
        * (1.0 + 1e-8 * (0.601 - 0.00972 * celsius) * air.pressure_pa)
        / (1.0 + 0.0036610 * celsius)
    )
    vapour_pa = air.relative_humidity * _saturation_pa(celsius)
    return 1.0 + standard * density - vapour_pa * (3.7345 - 0.0401 * wavenumber2) * 1e-10


def _saturation_pa(celsius: float) -> float:
    """Give the pressure of saturated vapour over water, by Magnus (Sonntag 1990)."""
    return 611.2 * exp(17.62 * celsius / (243.12 + celsius))
