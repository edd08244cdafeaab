"""A simulated Vaisala PTU300 on its service port."""

import time
from collections.abc import Callable
from typing import Final

from drivers.room.simulator.scene import RoomState
from tronlab.twin.state import Faults

_PROMPT: Final = b">"
_END: Final = b"\r\n"
_NOISE: Final = b"\xf0\x0f P# 1\x7f13 2 hPb\x00T"


class Ptu300:
    """The sensor: it echoes what is typed, answers ``send``, and has a run mode.

    Args:
        state: Gives the air.
        faults: ``room.air_silent``, ``room.air_garbage`` and ``room.air_missing``.
        is_running: Whether it is in run mode from the start, as it may have been left.
        interval_s: Between the lines of run mode.
    """

    def __init__(
        self,
        state: Callable[[], RoomState],
        faults: Faults,
        *,
        is_running: bool = False,
        interval_s: float = 0.2,
    ) -> None:
        self._state = state
        self._faults = faults
        self._is_running = is_running
        self._interval_s = interval_s
        self._last_s = time.monotonic()
        self._typed = b""

    def receive(self, data: bytes) -> bytes:
        """Take what is typed; a carriage return ends a command."""
        if self._faults.is_armed("room.air_silent"):
            self._typed = b""
            return b""
        *commands, self._typed = (self._typed + data.replace(b"\n", b"")).split(b"\r")
        echo = b"" if self._is_running else data.replace(b"\r", _END)
        return echo + b"".join(self._command(command.strip().lower()) for command in commands)

    def spontaneous(self) -> bytes:
        """Give a line when in run mode and its time has come."""
        now_s = time.monotonic()
        if not self._is_running or now_s - self._last_s < self._interval_s:
            return b""
        self._last_s = now_s
        return b"" if self._faults.is_armed("room.air_silent") else self._line()

    def _command(self, command: bytes) -> bytes:
        match command:
            case b"s":
                self._is_running = False
            case b"r" if not self._is_running:
                self._is_running = True
                return b""
            case b"send" if not self._is_running:
                return self._line() + _PROMPT
            case _ if self._is_running:
                return b""
            case b"form /":
                return b"OK" + _END + _PROMPT  # it has no other format to restore this from
            case _:
                pass
        return _PROMPT

    def _line(self) -> bytes:
        if self._faults.is_armed("room.air_garbage"):
            return _NOISE + _END
        state = self._state()
        temperature = f"{state.air_temperature_k - 273.15:3.1f}"
        if self._faults.is_armed("room.air_missing"):
            temperature = "****.*"
        pressure = f"{state.air_pressure_pa / 100.0:6.1f}"
        humidity = f"{state.relative_humidity * 100.0:3.1f}"
        line = f"P= {pressure} hPa T= {temperature} 'C RH= {humidity} %RH"
        return line.encode("ascii") + _END
