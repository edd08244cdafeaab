"""What the two ways into the controller have in common: commands, state, and the seam itself.

The robot program on the controller (``drivers/kuka/controller``) executes one command after the
other. It tells the number of the command it accepted last and of the one it finished last.
"""

from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Protocol

from scipy.spatial.transform import RigidTransform

from drivers.kuka.position import Axes
from tronlab.devices.readings import DeviceIdentity

MAKER = "KUKA"
LARGEST_ID = 2**31 - 1
"""An INT of the controller."""
FREE = -1
"""S or T (``kinematics.status_and_turn``) that is left to the controller. This driver always does:
a motion by axes has no need of them, and a straight one does not heed them."""


class CommandKind(IntEnum):
    """What the robot program can do; this driver has no need of PING and PTP_CARTESIAN."""

    PING = 0
    PTP_AXES = 1
    PTP_CARTESIAN = 2
    LINEAR = 3
    HOLD = 9


class Refusal(IntEnum):
    """Why a command was not carried out; the program may know more reasons than these."""

    NONE = 0
    UNKNOWN_KIND = 1
    AXIS_LIMIT = 2
    RAIL_LIMIT = 3
    NOT_READY = 4
    HELD = 5
    MOTION_FAILED = 6


class Mode(StrEnum):
    """The key switch of the controller."""

    T1 = "T1"
    T2 = "T2"
    AUT = "AUT"
    EXT = "EXT"


@dataclass(frozen=True, slots=True)
class Command:
    """One command; every member is always sent, whatever kind it is."""

    kind: CommandKind
    axes: Axes
    base_from_flange: RigidTransform
    velocity_pct: int
    acceleration_pct: int


@dataclass(frozen=True, slots=True)
class ControllerState:
    """What the controller says of itself."""

    reading: int
    """Number of this state: another one has another number."""
    accepted_id: int
    """Number of the command accepted last."""
    done_id: int
    """Number of the command finished or refused last."""
    error: int
    """Why command ``done_id`` was not carried out (``Refusal``); 0 if it was."""
    axes: Axes
    """Where the encoders say it stands."""
    is_moving: bool
    has_stop_message: bool
    are_drives_on: bool
    is_emergency_stop_released: bool
    is_guard_closed: bool
    mode: Mode
    override_pct: int
    is_program_active: bool
    time_s: float
    """When it arrived, seconds since 1970 UTC."""


class MotionBackend(Protocol):
    """A way into the controller; safe to use from several threads.

    ``call`` is the driver's method in whose name something is done, for errors.

    Every method but ``close`` may raise ``NotConnectedError``, ``DeviceTimeoutError``,
    ``ProtocolError`` or ``DeviceFaultError``.
    """

    def connect(self) -> None:
        """Open the connection; nothing moves."""
        ...

    def close(self) -> None:
        """Close it, whatever state it is in."""
        ...

    def identify(self, *, call: str) -> DeviceIdentity:
        """Read which controller and robot this is."""
        ...

    def state(self, *, call: str) -> ControllerState:
        """Read the state as it is after this call began."""
        ...

    def position(self, *, call: str) -> RigidTransform:
        """Read where the controller says its tool is in its base, metres.

        That is ``base_from_flange`` if both are number 0 and the rail is not coupled; there is none
        before the robot program has set them.
        """
        ...

    def send(self, command: Command, *, call: str) -> int:
        """Send a command and give its number; this does not wait for anything."""
        ...


def next_id(last_id: int) -> int:
    """Give the number of the command after one."""
    return last_id % LARGEST_ID + 1
