"""The air sensor: a Vaisala PTU300 on a serial line."""

import re
import time
from contextlib import suppress
from typing import Final

from drivers.room.options import AirOptions
from drivers.room.serial_line import SerialLine
from tronlab.devices.readings import AirReading, DeviceIdentity
from tronlab.errors import NotReadyError, ProtocolError

_ZERO_CELSIUS_K: Final = 273.15
_PA_PER_HPA: Final = 100.0

_RANGES: Final = {
    "temperature": (-40.0, 60.0, "degrees Celsius"),
    "pressure": (500.0, 1100.0, "hPa"),
    "relative humidity": (0.0, 100.0, "per cent"),
}
"""Beyond these no room has such air: the sensor is broken, or its output misread."""

_QUANTITIES: Final = (("P", "hPa"), ("T", "'C"), ("RH", "%RH"))
_NUMBER: Final = r"[-+]?\d+(?:\.\d+)?"
_PATTERNS: Final = {
    name: re.compile(rf"\b{name}=\s*(?P<value>{_NUMBER}|[*.]*\*[*.]*)\s*(?P<unit>'?[%A-Za-z]+)")
    for name, _ in _QUANTITIES
}

_STOP_STREAMING: Final = b"s\r"
_SEND: Final = b"send\r"
_ECHOES: Final = (b"", _STOP_STREAMING.strip(), _SEND.strip())
_LAST_LINE_S: Final = 0.2
"""For a line on its way when streaming was stopped; 45 characters at 4800 baud take 0.1 s."""


class MissingValueError(ValueError):
    """The sensor prints stars where a value belongs."""


def air_reading(*, temperature_c: float, pressure_hpa: float, humidity_pct: float) -> AirReading:
    """Make a reading in SI units.

    Raises:
        ValueError: No room has such air; NaN included.
    """
    values = (temperature_c, pressure_hpa, humidity_pct)
    for (name, (low, high, unit)), value in zip(_RANGES.items(), values, strict=True):
        if not low <= value <= high:
            raise ValueError(f"{name} is {value:g} {unit}, expected {low:g} to {high:g}")
    return AirReading(
        temperature_k=temperature_c + _ZERO_CELSIUS_K,
        pressure_pa=pressure_hpa * _PA_PER_HPA,
        relative_humidity=humidity_pct / 100.0,
    )


def parse_air(line: str) -> AirReading:
    """Read a line in the sensor's default format.

    For example ``P= 1013.2 hPa T= 31.1 'C RH= 38.3 %RH`` (PTU300 manual, serial line operation).

    Raises:
        MissingValueError: Stars stand for a value.
        ValueError: The line is not of this format, or no room has such air.
    """
    pressure_hpa, temperature_c, humidity_pct = (
        _value(line, name, unit) for name, unit in _QUANTITIES
    )
    return air_reading(
        temperature_c=temperature_c, pressure_hpa=pressure_hpa, humidity_pct=humidity_pct
    )


def _value(line: str, name: str, unit: str) -> float:
    match = _PATTERNS[name].search(line)
    if match is None:
        raise ValueError(f"no '{name}= NUMBER {unit}' in '{line}'")
    if match["unit"] != unit:
        raise ValueError(f"{name} is in {match['unit']}, expected {unit}")
    if "*" in match["value"]:
        raise MissingValueError(f"{name} is missing")
    return float(match["value"])


class AirSensor:
    """A Vaisala PTU300 that prints its default format.

    Args:
        options: Its serial line.
        device: Name of the device whose part it is.
    """

    def __init__(self, options: AirOptions, *, device: str) -> None:
        self._line = SerialLine(options, what="air sensor", device=device)
        self._device = device

    def connect(self) -> None:
        """Open the line, end a run mode it may be in, and see that it answers.

        Raises:
            NotConnectedError: The line cannot be opened.
            DeviceTimeoutError: It does not answer.
            ProtocolError: It prints another format.
        """
        self._line.open()
        self._line.write(_STOP_STREAMING)
        time.sleep(_LAST_LINE_S)
        with suppress(NotReadyError):  # it answers; a missing value matters when one is wanted
            self.read()

    def close(self) -> None:
        """Close the line; may be called twice."""
        self._line.close()

    def identify(self) -> DeviceIdentity:
        """Give maker and model; the default format says no more."""
        return DeviceIdentity(maker="Vaisala", model="PTU300", serial="", firmware="")

    def read(self) -> AirReading:
        """Measure the air.

        Raises:
            NotReadyError: It gives stars instead of a value; it may be warming up.
            ProtocolError: It prints something else.
            DeviceTimeoutError: It does not answer.
        """
        self._line.discard()
        self._line.write(_SEND)
        line = self._answer()
        try:
            return parse_air(line.decode("ascii", "backslashreplace"))
        except MissingValueError as error:
            raise NotReadyError(
                f"air sensor: {error}; it warms up, or its probe is broken",
                device=self._device,
                code=0,
            ) from None
        except ValueError as error:
            raise ProtocolError(
                f"air sensor: {error}; restore its format with the command 'form /'",
                device=self._device,
                sent=_SEND,
                received=line,
            ) from None

    def _answer(self) -> bytes:
        """Give the first line that is neither echo nor prompt."""
        until_s = self._line.deadline_s()
        while (line := self._line.read_line(until_s=until_s)).strip(b"> ") in _ECHOES:
            pass
        return line
