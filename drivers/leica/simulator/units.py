"""Units of the emScon TPI; the simulated tracker itself reckons in SI."""

from dataclasses import dataclass
from math import pi
from typing import Final

_LENGTHS_M: Final = (1.0, 1e-3, 1e-6, 0.3048, 0.9144, 0.0254)
"""Metre, millimetre, micron, foot, yard, inch."""
_ANGLES_RAD: Final = (1.0, pi / 180.0, pi / 200.0)
"""Radian, degree, gon."""
_PRESSURES_PA: Final = (100.0, 100.0, 1000.0, 133.322387415, 6894.757293168, 249.08891, 3386.389)
"""mbar, hPa, kPa, mmHg, psi, inH2O, inHg (conventional values, NIST SP 811)."""
_CELSIUS, _FAHRENHEIT = 0, 1
_ZERO_CELSIUS_K: Final = 273.15

N_CHOICES: Final = (len(_LENGTHS_M), len(_ANGLES_RAD), 2, len(_PRESSURES_PA), 1)
"""How many units there are for length, angle, temperature, pressure and humidity."""


@dataclass(frozen=True, slots=True)
class Units:
    """What a client wants lengths, angles, temperatures and pressures in (command 5)."""

    length: int
    angle: int
    temperature: int
    pressure: int
    humidity: int

    @property
    def m_per_length(self) -> float:
        """Get metres per unit of length."""
        return _LENGTHS_M[self.length]

    @property
    def rad_per_angle(self) -> float:
        """Get radians per unit of angle."""
        return _ANGLES_RAD[self.angle]

    @property
    def pa_per_pressure(self) -> float:
        """Get pascals per unit of pressure."""
        return _PRESSURES_PA[self.pressure]

    def kelvin(self, temperature: float) -> float:
        """Give a temperature of the client in kelvin."""
        if self.temperature == _FAHRENHEIT:
            temperature = (temperature - 32.0) / 1.8
        return temperature + _ZERO_CELSIUS_K

    def temperature_of(self, temperature_k: float) -> float:
        """Give a temperature as the client wants it."""
        celsius = temperature_k - _ZERO_CELSIUS_K
        return celsius if self.temperature == _CELSIUS else 1.8 * celsius + 32.0
