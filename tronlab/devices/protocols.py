"""What each kind of device must do. Calls block; when one returns, what it says is true.

Every method may raise ``NotConnectedError``, ``DeviceTimeoutError`` or ``DeviceFaultError``.
"""

from collections.abc import Mapping
from typing import Literal, Protocol, TypeAlias, runtime_checkable

from tronlab.devices.readings import (
    DeviceIdentity,
    Frame,
    PointReading,
    PoseReading,
    Posture,
    RobotReading,
    RobotTarget,
    RoomReading,
)

OperatorTask: TypeAlias = Literal["place_board", "remove_board"]


@runtime_checkable
class Device(Protocol):
    """What all devices have in common."""

    @property
    def name(self) -> str:
        """Get the name errors and logs use."""
        ...

    def connect(self) -> None:
        """Open the connection and make the device ready; it moves nothing."""
        ...

    def close(self) -> None:
        """Close the connection; may be called twice, and before ``connect``."""
        ...

    def identify(self) -> DeviceIdentity:
        """Read maker, model, serial number and firmware from the device."""
        ...


@runtime_checkable
class Diagnosable(Protocol):
    """A device that can say in which state it is; not every one can."""

    def diagnose(self) -> Mapping[str, str]:
        """Read what a person wants to know of its state, by name; changes and moves nothing."""
        ...


@runtime_checkable
class Robot(Device, Protocol):
    """An arm on a rail."""

    def check(self, target: RobotTarget) -> None:
        """Return if the target can be reached; move nothing.

        Raises:
            LimitError: Rail or arm cannot reach it; the message names the limit.
        """
        ...

    def move(self, target: RobotTarget, *, timeout_s: float) -> None:
        """Move there; when this returns the robot stands still at the target.

        Raises:
            LimitError: As ``check``, before anything moved.
        """
        ...

    def read(self) -> RobotReading:
        """Read rail and flange pose from the encoders."""
        ...

    def stop(self) -> None:
        """Stop any motion at once; may be called from another thread during ``move``."""
        ...


@runtime_checkable
class MotionModel(Protocol):
    """A robot that can say how it would move; needs no connection, and not every one can."""

    def posture_for(self, target: RobotTarget, *, near: Posture | None = None) -> Posture:
        """Choose how to stand at a target, with the least motion from ``near``.

        Raises:
            LimitError: Rail or arm cannot reach it; the message names the limit.
        """
        ...

    def move_duration_s(self, start: Posture, end: Posture) -> float:
        """Estimate how long ``move`` takes from one posture to another, coming to rest included."""
        ...


@runtime_checkable
class PoseTracker(Device, Protocol):
    """A laser tracker that measures reflectors (3 DoF) and a T-MAC (6 DoF)."""

    def identify_target(self) -> DeviceIdentity:
        """Read which T-MAC the tracker sees."""
        ...

    def measure_point(self, target: str, *, window_s: float) -> PointReading:
        """Measure the named reflector, averaging over ``window_s``.

        Raises:
            TrackingLostError: The beam does not reach it.
        """
        ...

    def measure_pose(self, *, window_s: float) -> PoseReading:
        """Measure the T-MAC, averaging over ``window_s``; it must stand still meanwhile.

        Raises:
            TrackingLostError: The beam does not reach it, or its rotation is not determined.
        """
        ...


@runtime_checkable
class Camera(Device, Protocol):
    """A camera triggered by software."""

    def configure(self, *, exposure_s: float, gain_db: float, pixel_format: str) -> None:
        """Set how frames are taken; when this returns the next frame is taken that way.

        Raises:
            LimitError: The camera cannot do it; the message says what it can.
        """
        ...

    def grab(self, *, timeout_s: float) -> Frame:
        """Trigger one exposure and give its frame: exposed wholly after this call began."""
        ...


@runtime_checkable
class RoomIO(Device, Protocol):
    """Doors, lamp and air of the room."""

    def read(self) -> RoomReading:
        """Read the state of the room."""
        ...

    def switch_lamp(self, *, on: bool) -> None:
        """Switch the lamp; when this returns it burns, or is dark."""
        ...


@runtime_checkable
class Operator(Device, Protocol):
    """Whoever does what no device can do; a person, or the twin."""

    def perform(self, task: OperatorTask) -> None:
        """Have the task done; when this returns it is done."""
        ...
