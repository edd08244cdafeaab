"""How fast a run goes, learned from the run itself: the time that is left, and where it went."""

from collections import deque
from collections.abc import Mapping

from tronlab.dataset.records import ShotTiming

PARTS: tuple[str, ...] = (
    "motion",
    "settle",
    "tracker",
    "camera",
    "confirm/read",
    "write",
    "lost",
)
"""Parts of a shot as they are shown."""

_N_LOST = 200
_UNUSUAL_PART = 0.05
"""So many of the longest delays count as unusual: one long suspension will not come every shot."""


class Pace:
    """Learns from every shot.

    Parts of shots are in the laboratory's time. What is left is in that of whoever waits: a
    simulated laboratory lets hours pass in a second, and a real one needs some time besides its
    shots, for drift checks and the computer.
    """

    def __init__(self, *, start_s: float) -> None:
        """Begin.

        Args:
            start_s: The time by the waiting person's clock, which never jumps.
        """
        self._last_s = start_s
        self._n_shots = 0
        self._seconds = dict.fromkeys(PARTS, 0.0)
        self._worked_s = 0.0
        """Time that passed for whoever waits, without what was lost."""
        self._delays_s: deque[float] = deque(maxlen=_N_LOST)
        """Of it, what was lost before each shot."""
        self._estimated_moves_s: dict[int, float] = {}
        """Of shots not yet taken, by id."""
        self._estimated_so_far_s = 0.0
        self._moved_as_estimated_s = 0.0
        """What the moves took for which there was an estimate."""

    def start(self, now_s: float) -> None:
        """Say that the shots begin now: what was before belongs to none of them."""
        self._last_s = now_s

    def expect(self, moves_s: Mapping[int, float]) -> None:
        """Take the plan's estimate of how long the move to each shot takes, by shot id."""
        self._estimated_moves_s.update(moves_s)

    def learn(self, shot_id: int, timing: ShotTiming, *, write_s: float, now_s: float) -> None:
        """Learn from a shot that is done.

        Args:
            shot_id: Which.
            timing: Its parts, by the laboratory's clock.
            write_s: How long it took to store it.
            now_s: The time by the waiting person's clock.
        """
        for part, duration_s in _parts_s(timing, write_s).items():
            self._seconds[part] += duration_s
        passed_s, self._last_s = now_s - self._last_s, now_s
        # what a simulated laboratory lost has not passed for whoever waits
        delay_s = timing.lost_s if timing.lost_s <= passed_s else 0.0
        self._delays_s.append(delay_s)
        self._worked_s += passed_s - delay_s
        self._n_shots += 1
        estimate_s = self._estimated_moves_s.pop(shot_id, None)
        if estimate_s is not None:
            self._estimated_so_far_s += estimate_s
            self._moved_as_estimated_s += timing.move_s

    @property
    def n_shots(self) -> int:
        """Get from how many shots it has learned."""
        return self._n_shots

    @property
    def split_s(self) -> Mapping[str, float]:
        """Get where the time went, seconds by part; ``other`` is what belongs to no shot."""
        return {**self._seconds, "other": max(0.0, self._worked_s - self._shots_s)}

    def left_s(self, n_left: int) -> float | None:
        """Estimate how long so many more shots take; None before the first shot."""
        if self._n_shots == 0 or self._shots_s <= 0:
            return None
        still_s = (self._shots_s - self._seconds["motion"]) / self._n_shots
        seconds_per_second = self._worked_s / self._shots_s
        in_laboratory_s = still_s * n_left + self._moves_left_s(n_left)
        return in_laboratory_s * seconds_per_second + self._usual_delay_s * n_left

    @property
    def _shots_s(self) -> float:
        """Get the time of all shots without what was lost."""
        return sum(self._seconds.values()) - self._seconds["lost"]

    def _moves_left_s(self, n_left: int) -> float:
        """Scale the plan's estimate by how it did so far; where there is none, take the mean."""
        mean_s = self._seconds["motion"] / self._n_shots
        if self._estimated_so_far_s <= 0:
            return mean_s * n_left
        scale = self._moved_as_estimated_s / self._estimated_so_far_s
        n_estimated = min(n_left, len(self._estimated_moves_s))  # shots may have been skipped
        estimate_s = sum(self._estimated_moves_s.values()) / max(1, len(self._estimated_moves_s))
        return scale * estimate_s * n_estimated + mean_s * (n_left - n_estimated)

    @property
    def _usual_delay_s(self) -> float:
        """Get the mean of what was lost before a shot, without the longest few."""
        n_unusual = 1 + int(_UNUSUAL_PART * len(self._delays_s))
        usual = sorted(self._delays_s)[:-n_unusual]
        return sum(usual) / len(usual) if usual else 0.0


def _parts_s(timing: ShotTiming, write_s: float) -> Mapping[str, float]:
    return {
        "motion": timing.move_s,
        "settle": timing.settle_s,
        "tracker": timing.tracker_s,
        "camera": timing.camera_s,
        "confirm/read": timing.confirm_s + timing.read_s,
        "write": write_s,
        "lost": timing.lost_s,
    }


def shot_duration_s(timing: ShotTiming, *, write_s: float) -> float:
    """Give the time of one shot, without what was lost before it."""
    return sum(_parts_s(timing, write_s).values()) - timing.lost_s


def describe_split(pace: Pace) -> str:
    """Say in one line where the time went: seconds and percent, without parts that took none."""
    split_s = pace.split_s
    total_s = sum(split_s.values())
    parts = (
        f"{part} {duration_s:.1f} s ({duration_s / total_s:.0%})"
        for part, duration_s in split_s.items()
        if duration_s > 0
    )
    return ", ".join(parts) or "none"
