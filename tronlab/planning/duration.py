"""How long a campaign takes, part by part, from its own numbers and the pace of its devices."""

from collections.abc import Callable
from dataclasses import dataclass

from tronlab.devices.cell import PaceSpec
from tronlab.planning.assessment import ShotDuration

_N_SETTLE_LOOKS = 2
"""A pose that stands still is seen at once: two looks agree. A robot that swings takes longer."""


@dataclass(frozen=True, slots=True)
class Timing:
    """The times a campaign file asks for, seconds."""

    settle_wait_s: float
    """Before each look after the first."""
    settle_window_s: float
    """Of each look at whether the T-MAC stands still, also after the exposure."""
    tracker_window_s: float
    exposure_s: float
    drift_window_s: float = 0.0
    """Of each reflector in a drift check."""
    n_reflectors: int = 0
    """Measured in each drift check."""
    n_drift_checks: Callable[[int], int] = lambda n_shots: 0
    """How many a run of so many shots has."""


def shot_duration(timing: Timing, pace: PaceSpec, *, move_s: float) -> ShotDuration:
    """Estimate the parts of a shot that succeeds at once, after a move of ``move_s``."""
    look_s = timing.settle_window_s + pace.tracker_s
    return ShotDuration(
        move_s=move_s,
        settle_s=_N_SETTLE_LOOKS * look_s + (_N_SETTLE_LOOKS - 1) * timing.settle_wait_s,
        tracker_s=timing.tracker_window_s + pace.tracker_s,
        camera_s=timing.exposure_s + pace.camera_s,
        confirm_s=look_s,
        read_s=pace.read_s,
        write_s=pace.write_s,
    )


def drift_checks_s(timing: Timing, pace: PaceSpec, *, n_shots: int) -> float:
    """Estimate the time of all drift checks of a run."""
    check_s = timing.n_reflectors * (timing.drift_window_s + pace.tracker_s)
    return timing.n_drift_checks(n_shots) * check_s
