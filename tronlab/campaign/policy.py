"""What a campaign does about an error of a device: try again, connect again, wait, or stop."""

from dataclasses import dataclass
from enum import Enum

from tronlab.errors import (
    AccessDeniedError,
    DeviceError,
    DeviceTimeoutError,
    IncompleteFrameError,
    NotConnectedError,
    NotReadyError,
    NotSettledError,
    SafetyError,
    TrackingLostError,
)

MAX_ATTEMPTS = 3
"""Failures of one shot until the run gives up; waiting for a safe cell is none."""

PAUSES_S = (1.0, 5.0)
"""Before the second and the third try: whoever stands in the beam may go on."""

ROBOT = "robot"
"""Name of the device that is never connected again by itself: nobody knows what it does."""


class Remedy(Enum):
    """What to do before the shot is taken again."""

    RETRY = "retry"
    """Nothing: the device answers, and the next try may succeed."""
    RECONNECT = "reconnect"
    """Close the device and connect it again."""
    WAIT = "wait"
    """Wait until a person has made the cell safe."""
    STOP = "stop"
    """The shot is not taken again: the run ends."""


@dataclass
class Setbacks:
    """What has gone wrong with one shot so far."""

    failures: int = 0
    suspensions: int = 0
    unsafe_since_s: float | None = None
    """When the cell was found unsafe; None if it was safe at the last move."""
    lost: str | None = None
    """Device to connect again before the next attempt."""

    @property
    def attempt(self) -> int:
        """Get the number of the attempt in hand, from 1: each setback begins another."""
        return 1 + self.failures + self.suspensions


def remedy_for(error: BaseException | None) -> Remedy:
    """Choose the remedy for an error."""
    match error:
        case SafetyError():
            return Remedy.WAIT
        case TrackingLostError() | NotSettledError() | IncompleteFrameError() | NotReadyError():
            return Remedy.RETRY
        case AccessDeniedError():
            return Remedy.STOP
        case DeviceError(device=device) if device == ROBOT:
            return Remedy.STOP
        case NotConnectedError() | DeviceTimeoutError():
            return Remedy.RECONNECT
        case _:
            return Remedy.STOP
