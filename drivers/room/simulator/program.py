"""The program of the simulated PLC: what its inputs, coils and registers hold at every moment.

The tables here are written for the simulator alone, so that a mistake in the driver's shows.
"""

import math
import struct
from collections.abc import Sequence
from typing import Final

from drivers.room.options import WordOrder
from drivers.room.simulator.lamp import SimulatedLamp
from drivers.room.simulator.scene import Call, Scene
from tronlab.errors import DeviceFaultError, DeviceTimeoutError
from tronlab.twin.state import Faults

N_COILS: Final = 5
N_DISCRETE_INPUTS: Final = 8
N_HOLDING_REGISTERS: Final = 14
N_INPUT_REGISTERS: Final = 42

CYCLE_S: Final = 0.1
"""The program looks at the room ten times a second."""
MISSED_HEARTBEAT_S: Final = 2.0
"""Requests are dropped when the other side's heartbeat has not changed for so long."""

_LAMP, _CURTAIN = 0, 1
_CURTAIN_PER_S: Final = 100.0
_STARTING, _READY, _REQUESTS_DROPPED, _STOPPED = range(4)
_COLD_LAMP_C, _HOT_LAMP_C = 24.0, 95.0
_LIT_LUX, _DARK_LUX = 850.0, 0.5
_KELVIN: Final = 273.15


class SilenceError(Exception):
    """The PLC does not answer this request."""


class PlcProgram:
    """The program; ``cycle`` runs it.

    Args:
        scene: The room.
        lamp: What its contactor feeds.
        faults: See ``FAULTS``.
        word_order: Of 32-bit values.
        now_s: Time, seconds, of any zero.
    """

    def __init__(
        self,
        scene: Scene,
        lamp: SimulatedLamp,
        faults: Faults,
        *,
        word_order: WordOrder,
        now_s: float,
    ) -> None:
        self._scene, self._lamp, self._faults = scene, lamp, faults
        self._word_order: WordOrder = word_order
        self._coils = [False] * N_COILS
        self._holding = [0] * N_HOLDING_REGISTERS
        self._begun_s = self._cycle_s = now_s
        self._room = scene.state()
        self._heartbeat = 0
        self._other_heartbeat_s = -math.inf
        self._curtain_pct = 0.0
        self._error_code = 0
        self._is_silent_once = False
        full = struct.unpack(">HH", struct.pack(">f", 100.0))
        self._holding[10:14] = 2 * (full if word_order == "big" else full[::-1])

    @property
    def coils(self) -> list[bool]:
        """Get the coils."""
        return list(self._coils)

    @property
    def holding_registers(self) -> list[int]:
        """Get the holding registers."""
        return list(self._holding)

    def cycle(self, now_s: float) -> None:
        """Run once: look at the room, drop what is no longer allowed, move the curtain."""
        self._room = self._scene.state()
        if not self._faults.is_armed("room.heartbeat_stopped"):
            self._heartbeat = int(now_s - self._begun_s) % 0x10000
        if not self._hears_heartbeat(now_s):
            self._coils = [False] * N_COILS
        if self._must_be_dark():
            self._coils[_LAMP] = False
        self._move_curtain(now_s - self._cycle_s)
        self._cycle_s = now_s
        self._drive_lamp()

    def discrete_inputs(self) -> list[bool]:
        """Give the discrete inputs."""
        is_stopped = self._faults.is_armed("room.emergency_stop")
        is_open = self._faults.is_armed("room.door_open")
        is_closed = self._room.is_door_closed and not is_open
        return [
            not is_stopped,
            is_closed,
            is_closed,  # nobody can be seen in a room without a door
            True,
            self._curtain_pct >= 100.0,
            self._is_too_hot(),
            not is_stopped,
            True,
        ]

    def input_registers(self, now_s: float) -> list[int]:
        """Give the input registers."""
        registers = [0] * N_INPUT_REGISTERS
        registers[0:4] = 1, self._heartbeat, self._state(now_s), self._error_code
        room, is_hot = self._room, self._is_too_hot()
        registers[10:12] = self._float(room.air_temperature_k - _KELVIN)
        registers[12:14] = self._float(room.air_pressure_pa / 100.0)
        registers[14:16] = self._float(room.relative_humidity * 100.0)
        registers[16:18] = self._float(_HOT_LAMP_C if is_hot else _COLD_LAMP_C)
        registers[20:22] = self._float(_DARK_LUX + _LIT_LUX * self._lamp.level)
        registers[30:32] = self._ordered(struct.pack(">I", int(now_s - self._begun_s)))
        registers[40:42] = self._float(123456.0)
        return registers

    def write_coils(self, first: int, values: Sequence[bool], now_s: float) -> None:
        """Take requests; without a heartbeat, or where it is not safe, they are not kept.

        Raises:
            SilenceError: The rig file's script wants no answer.
        """
        if first <= _LAMP < first + len(values) and not self._begin("switch_lamp"):
            return
        if self._hears_heartbeat(now_s):
            self._coils[first : first + len(values)] = values
        if self._must_be_dark():
            self._coils[_LAMP] = False
        self._drive_lamp()

    def write_holding_registers(self, first: int, values: Sequence[int], now_s: float) -> bool:
        """Take settings; give False where one makes no sense, and keep none then."""
        registers = list(self._holding)
        registers[first : first + len(values)] = values
        if not all(0.0 <= self._percent(registers, at) <= 100.0 for at in (10, 12)):
            return False
        if registers[0] != self._holding[0]:
            self._other_heartbeat_s = now_s
        self._holding = registers
        self._drive_lamp()
        return True

    def begin_read(self) -> None:
        """Count that a driver reads the state of the room.

        Raises:
            SilenceError: The rig file's script wants no answer.
        """
        self._begin("read")

    def _begin(self, call: Call) -> bool:
        """Ask the rig file's script whether the call may go on; a fault sets the error code."""
        self._error_code = 0
        try:
            self._scene.begin(call)
        except DeviceTimeoutError as error:
            raise SilenceError from error
        except DeviceFaultError as error:
            self._error_code = error.code
            return False
        return True

    def _state(self, now_s: float) -> int:
        if self._must_be_dark():
            return _STOPPED
        return _READY if self._hears_heartbeat(now_s) else _REQUESTS_DROPPED

    def _hears_heartbeat(self, now_s: float) -> bool:
        return now_s - self._other_heartbeat_s <= MISSED_HEARTBEAT_S

    def _must_be_dark(self) -> bool:
        return self._faults.is_armed("room.emergency_stop") or self._is_too_hot()

    def _is_too_hot(self) -> bool:
        return self._faults.is_armed("room.over_temperature")

    def _drive_lamp(self) -> None:
        self._lamp.dim_by_plc(self._percent(self._holding, 10) / 100.0)
        self._lamp.close_contactor(closed=self._coils[_LAMP])

    def _move_curtain(self, duration_s: float) -> None:
        wanted = self._percent(self._holding, 12) if self._coils[_CURTAIN] else 0.0
        step = _CURTAIN_PER_S * duration_s
        self._curtain_pct += min(max(wanted - self._curtain_pct, -step), step)

    def _percent(self, registers: Sequence[int], at: int) -> float:
        high, low = registers[at : at + 2]
        if self._word_order == "little":
            high, low = low, high
        return struct.unpack(">f", struct.pack(">HH", high, low))[0]

    def _float(self, value: float) -> tuple[int, int]:
        return self._ordered(struct.pack(">f", value))

    def _ordered(self, data: bytes) -> tuple[int, int]:
        high, low = struct.unpack(">HH", data)
        is_wrong = self._faults.is_armed("room.wrong_word_order")
        is_swapped = (self._word_order == "little") is not is_wrong
        return (low, high) if is_swapped else (high, low)
