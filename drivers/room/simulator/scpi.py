"""A simulated lamp supply that speaks SCPI as an Agilent E3632A does over RS-232."""

from collections import deque
from typing import Final

from drivers.room.simulator.lamp import SimulatedLamp
from tronlab.twin.state import Faults

RATED_V: Final = 30.9
RATED_A: Final = 7.21

_QUEUE_LENGTH: Final = 20
_UNDEFINED_HEADER: Final = (-113, "Undefined header")
_WRONG_TYPE: Final = (-104, "Data type error")
_OUT_OF_RANGE: Final = (-222, "Data out of range")
_OVERFLOW: Final = (-350, "Too many errors")
_LOCAL: Final = (550, "Command not allowed in local")


class ScpiSupply:
    """The supply; its output feeds the lamp, which draws the set current times its level.

    Args:
        lamp: What it feeds.
        faults: ``room.supply_silent`` and ``room.supply_error``.
        serial: Its serial number.
    """

    def __init__(self, lamp: SimulatedLamp, faults: Faults, *, serial: str) -> None:
        self._lamp = lamp
        self._faults = faults
        self._identity = f"tronlab,simulated supply,{serial or '0'},1.0"
        self._volts = self._amperes = 0.0
        self._is_on = False
        self._is_remote = False
        self._errors: deque[tuple[int, str]] = deque()
        self._pending = b""

    def receive(self, data: bytes) -> bytes:
        """Take bytes, and give the answers of the lines that end in them."""
        if self._faults.is_armed("room.supply_silent"):
            self._pending = b""
            return b""
        *lines, self._pending = (self._pending + data).split(b"\n")
        answers = (self._line(line.decode("ascii", "replace").strip()) for line in lines)
        return b"".join(f"{answer}\r\n".encode() for answer in answers if answer)

    def spontaneous(self) -> bytes:
        """Send nothing unasked."""
        return b""

    def _line(self, line: str) -> str:
        header, _, argument = line.upper().partition(" ")
        if not header:
            return ""
        if header == "SYST:REM":
            self._is_remote = True
        elif not self._is_remote:
            self._fault(_LOCAL)
        elif header.endswith("?"):
            return self._query(header)
        else:
            self._command(header, argument.strip())
        return ""

    def _query(self, header: str) -> str:
        answers = {
            "*IDN?": lambda: self._identity,
            "SYST:ERR?": self._next_error,
            "VOLT?": lambda: _number(self._volts),
            "CURR?": lambda: _number(self._amperes),
            "OUTP?": lambda: str(int(self._is_on)),
            "MEAS:VOLT?": lambda: _number(self._volts * self._is_on),
            "MEAS:CURR?": lambda: _number(self._amperes * self._lamp.level * self._is_on),
        }
        if header not in answers:
            self._fault(_UNDEFINED_HEADER)
            return ""
        return answers[header]()

    def _next_error(self) -> str:
        code, text = self._errors.popleft() if self._errors else (0, "No error")
        return f'{code:+d},"{text}"'

    def _command(self, header: str, argument: str) -> None:
        if header in {"VOLT", "CURR", "OUTP"} and self._faults.strike("room.supply_error"):
            self._fault(_OVERFLOW)
            return
        match header, argument:
            case "VOLT", number:
                self._volts = self._setting(number, self._volts, highest=RATED_V)
            case "CURR", number:
                self._amperes = self._setting(number, self._amperes, highest=RATED_A)
            case "OUTP", ("ON" | "1"):
                self._switch(on=True)
            case "OUTP", ("OFF" | "0"):
                self._switch(on=False)
            case "*RST", "":
                self._volts = self._amperes = 0.0
                self._switch(on=False)
            case "*CLS", "":
                self._errors.clear()
            case _:
                self._fault(_UNDEFINED_HEADER)

    def _switch(self, *, on: bool) -> None:
        self._is_on = on
        self._lamp.power(on=on)

    def _setting(self, text: str, kept: float, *, highest: float) -> float:
        try:
            value = float(text)
        except ValueError:
            self._fault(_WRONG_TYPE)
            return kept
        if not 0.0 <= value <= highest:
            self._fault(_OUT_OF_RANGE)
            return kept
        return value

    def _fault(self, error: tuple[int, str]) -> None:
        if len(self._errors) < _QUEUE_LENGTH:
            self._errors.append(error)
        else:
            self._errors[-1] = _OVERFLOW


def _number(value: float) -> str:
    return f"{value:+.8E}"
