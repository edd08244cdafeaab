"""What the PC can tell the controller, and how it says that it was done.

The numbers are those of the KRL program that ships with the driver; EthernetKRL and KUKAVARPROXY
carry the same ones.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from tronlab.geometry.poses import FloatArray

FREE: Final = -1
"""S or T that leaves the choice to the controller."""


class CommandType(IntEnum):
    """What is to be done."""

    PING = 0
    PTP_AXIS = 1
    PTP_CARTESIAN = 2
    LIN = 3
    HOLD = 9


class Refusal(IntEnum):
    """Why a command was not carried out; 0 if it was."""

    NONE = 0
    UNKNOWN_TYPE = 1
    AXIS_LIMIT = 2
    RAIL_LIMIT = 3
    NOT_READY = 4
    HELD = 5
    FAILED = 6


class Refused(Exception):  # noqa: N818  # what happens, and no mistake of anyone's
    """A command is not carried out."""

    def __init__(self, refusal: Refusal) -> None:
        super().__init__(refusal.name)
        self.refusal = refusal


@dataclass(frozen=True, slots=True)
class CartesianPosition:
    """A position as the controller writes it: E6POS, without the external axes after E1."""

    x_mm: float
    y_mm: float
    z_mm: float
    a_deg: float
    b_deg: float
    c_deg: float
    status: int
    turn: int
    e1_mm: float


@dataclass(frozen=True, slots=True)
class Command:
    """One command; ``position`` or ``axes`` counts, as its type says."""

    number: int
    """Id of the EthernetKRL message, or LAB_SEQ."""
    type: int
    velocity_pct: float
    acceleration_pct: float
    axes: FloatArray
    """A1 to A6 in degrees and E1 in millimetres, shape (7,)."""
    position: CartesianPosition
    tool: int = 0
    base: int = 0
    is_complete: bool = True
    """False if elements of the message were missing."""

    @property
    def is_move(self) -> bool:
        """Look whether it moves the robot."""
        return self.type in (CommandType.PTP_AXIS, CommandType.PTP_CARTESIAN, CommandType.LIN)

    @property
    def is_readable(self) -> bool:
        """Look whether all numbers that count are there; in KRL a value can be undefined."""
        counted = [self.velocity_pct, self.acceleration_pct]
        if self.type == CommandType.PTP_AXIS:
            counted += [float(value) for value in self.axes]
        if self.type in (CommandType.PTP_CARTESIAN, CommandType.LIN):
            p = self.position
            counted += [p.x_mm, p.y_mm, p.z_mm, p.a_deg, p.b_deg, p.c_deg, p.e1_mm]
        return not self.is_move or bool(np.isfinite(counted).all())
