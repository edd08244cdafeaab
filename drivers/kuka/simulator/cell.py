"""The cell as the controller's own safety sees it; armed faults change it."""

from dataclasses import dataclass
from enum import IntEnum

from drivers.kuka.simulator import faults as f
from tronlab.twin.state import Faults


class Mode(IntEnum):
    """Position of the key switch; the number is that of ``Flags/@Mode``."""

    T1 = 1
    T2 = 2
    AUT = 3
    EX = 4


@dataclass(frozen=True, slots=True)
class Cell:
    """Whether the robot may move."""

    is_estop_released: bool
    is_guard_closed: bool
    are_drives_on: bool
    mode: Mode
    has_stop_message: bool

    @property
    def is_program_active(self) -> bool:
        """Look whether the program runs; everything that is amiss stops it."""
        return self.are_drives_on and not self.has_stop_message and self.mode is not Mode.T1


def look_at_cell(faults: Faults, *, has_stop_message: bool = False) -> Cell:
    """Give the state of the cell.

    Args:
        faults: What is armed.
        has_stop_message: The controller itself has stopped the program.
    """
    is_estop_released = not faults.is_armed(f.EMERGENCY_STOP)
    is_guard_closed = not faults.is_armed(f.GUARD_OPEN)
    is_safe = is_estop_released and is_guard_closed
    return Cell(
        is_estop_released=is_estop_released,
        is_guard_closed=is_guard_closed,
        are_drives_on=is_safe and not faults.is_armed(f.DRIVES_OFF),
        mode=Mode.T1 if faults.is_armed(f.WRONG_MODE) else Mode.AUT,
        has_stop_message=has_stop_message or not is_safe or faults.is_armed(f.STOP_MESSAGE),
    )
