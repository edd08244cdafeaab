"""Modbus map of the room's PLC as this driver knows it; addresses count from 0.

The safety inputs are discrete inputs: Modbus has no function that writes them.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from drivers.room.options import WordOrder

MAP_VERSION: Final = 1
MAGIC: Final = 123456.0
"""Constant that shows whether both sides agree on the order of words."""


class Coil(IntEnum):
    """What this computer may ask for; the PLC decides, and drops it when the heartbeat stops."""

    LAMP = 0
    CURTAIN = 1
    WARNING_LIGHT = 2


class InputRegister(IntEnum):
    """What the PLC says; floats and 32-bit counts take two registers."""

    MAP_VERSION = 0
    HEARTBEAT = 1
    STATE = 2
    ERROR_CODE = 3
    AIR = 10
    """Temperature in degrees Celsius, pressure in hPa, humidity in per cent: three floats."""
    UPTIME = 30
    MAGIC = 40


class HoldingRegister(IntEnum):
    """What this computer tells the PLC."""

    HEARTBEAT = 0


class PlcState(IntEnum):
    """What the PLC's program is doing."""

    STARTING = 0
    READY = 1
    REQUESTS_DROPPED = 2
    """It missed this computer's heartbeat."""
    STOPPED = 3
    """Emergency stop, or the lamp is too hot."""


@dataclass(frozen=True, slots=True)
class SafetyInputs:
    """The discrete inputs 0 to 7, in this order; they can only be read."""

    is_emergency_stop_released: bool
    is_door_closed: bool
    is_area_clear: bool
    is_robot_automatic: bool
    """The robot is in AUT or EXT."""
    is_curtain_closed: bool
    is_lamp_too_hot: bool
    is_rail_enabled: bool
    is_watchdog_ok: bool


N_SAFETY_INPUTS: Final = 8
N_STATUS_REGISTERS: Final = 4
N_AIR_REGISTERS: Final = 6


def float_from_words(words: Sequence[int], *, word_order: WordOrder) -> float:
    """Read a 32-bit float from two registers.

    Args:
        words: The registers, shape (2,), by rising address.
        word_order: ``big``: the high half has the lower address.
    """
    return float(struct.unpack(">f", _in_order(words, word_order))[0])


def count_from_words(words: Sequence[int], *, word_order: WordOrder) -> int:
    """Read an unsigned 32-bit number from two registers, shape (2,)."""
    return int.from_bytes(_in_order(words, word_order), "big")


def _in_order(words: Sequence[int], word_order: WordOrder) -> bytes:
    high, low = words if word_order == "big" else reversed(words)
    return struct.pack(">HH", high, low)
