"""What a campaign does about an error: try again, wait, give the shot up, or end the run."""

from collections import Counter
from dataclasses import dataclass, field
from typing import TypeAlias

from tronlab.campaign.config import CampaignConfig, RetryRule
from tronlab.campaign.suspension import Condition, Patience, Suspension
from tronlab.dataset.records import ErrorClass
from tronlab.errors import (
    AccessDeniedError,
    DatasetError,
    DeviceError,
    DeviceTimeoutError,
    IncompleteFrameError,
    NotConnectedError,
    NotReadyError,
    NotSettledError,
    QualityError,
    SafetyError,
    TrackingLostError,
)

ROBOT = "robot"
"""Name of the device that is never connected again by itself: nobody knows what it does."""


class LampDriftError(DeviceError):
    """The light on the model is not what it was, and the campaign wants to wait for it."""


class DiskNearlyFullError(DatasetError):
    """There is less room on the disk than the campaign wants before it takes a shot."""


_CLASSES: tuple[tuple[type[DeviceError], ErrorClass], ...] = (
    (SafetyError, "unsafe"),
    (TrackingLostError, "tracking_lost"),
    (NotSettledError, "not_settled"),
    (IncompleteFrameError, "incomplete_frame"),
    (NotReadyError, "not_ready"),
    (QualityError, "quality"),
    (LampDriftError, "quality"),
)
"""What a device that answers may say, and get over."""


@dataclass(frozen=True, slots=True)
class Again:
    """Another attempt follows."""

    pause_s: float


@dataclass(frozen=True, slots=True)
class Wait:
    """The run is suspended; another look follows."""

    pause_s: float


@dataclass(frozen=True, slots=True)
class GiveUp:
    """Its attempts are used up: ``retry.on_failure`` says what now."""


@dataclass(frozen=True, slots=True)
class End:
    """Nothing helps: the run ends."""


Reaction: TypeAlias = Again | Wait | GiveUp | End


OF_THE_DEVICE: frozenset[ErrorClass | None] = frozenset({"lost_connection", "not_ready"})
"""What will happen to the next shot as well: it ends the run when attempts are used up."""


def class_of(error: BaseException | None) -> ErrorClass | None:
    """Give the class of an error that another attempt may help against; None: none does."""
    for kind, name in _CLASSES:
        if isinstance(error, kind):
            return name
    is_lost = isinstance(error, NotConnectedError | DeviceTimeoutError)
    if not is_lost or isinstance(error, AccessDeniedError) or error.device == ROBOT:
        return None
    return "lost_connection"


def pause_before_next_s(rule: RetryRule, n_failures: int) -> float | None:
    """Give the pause before another attempt after so many failures; None: they are too many."""
    if n_failures >= rule.max_attempts:
        return None
    return rule.pauses_s[min(n_failures, len(rule.pauses_s)) - 1]


@dataclass
class Setbacks:
    """What has gone wrong with one shot, or one drift check, so far."""

    task: str
    """Its name in messages."""
    config: CampaignConfig
    n_failures: Counter[ErrorClass] = field(default_factory=Counter[ErrorClass], init=False)
    """Attempts that came to nothing; a suspension counts once, however often one has looked."""
    suspension: Suspension | None = field(default=None, init=False)
    """What the run waits for; stays when it has waited in vain."""
    _patience: Patience = field(init=False)

    @property
    def attempt(self) -> int:
        """Get the number of the attempt in hand, from 1."""
        return 1 + self.n_failures.total()

    def react(self, error: BaseException | None, *, now_s: float, is_in_place: bool) -> Reaction:
        """Note a setback, and say what to do about it.

        Args:
            error: Why the attempt came to nothing.
            now_s: The time, seconds since anything.
            is_in_place: Whether the robot reached its target in this attempt: the cell was safe
                then, so that an unsafe one is another wait.
        """
        condition = self._condition(error)
        if condition is None:
            self.suspension = None
            return self._count_failure(error)
        if not self.waits_for(condition) or (condition == "unsafe" and is_in_place):
            self._suspend(condition, error, now_s)
        pause_s = self._patience.next_pause_s(now_s)
        if pause_s is not None:
            return Wait(pause_s)
        return GiveUp() if condition == "beam" else End()

    def waits_for(self, condition: Condition) -> bool:
        """Tell whether the run is suspended because of this."""
        return self.suspension is not None and self.suspension.condition == condition

    def renew_patience(self, now_s: float) -> None:
        """Wait as long again: a person has looked after it."""
        if self.suspension is not None:
            self._patience = Patience(self.config.suspend, now_s)

    def _condition(self, error: BaseException | None) -> Condition | None:
        """Tell for what to wait after an error; None: for nothing."""
        match error:
            case SafetyError():
                return "unsafe"
            case LampDriftError():
                return "lamp"
            case DiskNearlyFullError():
                return "disk"
            case TrackingLostError() if self.config.suspend.on_beam_lost:
                rule = self.config.retry.tracking_lost
                is_last = self.n_failures["tracking_lost"] + 1 >= rule.max_attempts
                return "beam" if is_last else None
            case _:
                return None

    def _suspend(self, condition: Condition, error: BaseException | None, now_s: float) -> None:
        self.suspension = Suspension(self.task, condition, str(error))
        self._patience = Patience(self.config.suspend, now_s)
        kind = class_of(error)
        if kind is not None:
            self.n_failures[kind] += 1

    def _count_failure(self, error: BaseException | None) -> Reaction:
        kind = class_of(error)
        if kind is None:
            return End()
        self.n_failures[kind] += 1
        pause_s = pause_before_next_s(self._rule(kind), self.n_failures[kind])
        return GiveUp() if pause_s is None else Again(pause_s)

    def _rule(self, kind: ErrorClass) -> RetryRule:
        if kind == "quality":
            return RetryRule(max_attempts=1 + self.config.gate.max_retakes, pauses_s=(0.0,))
        return getattr(self.config.retry, kind)
