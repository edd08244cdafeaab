"""The time of a laboratory: the computer's, or that of a simulated one."""

import time
from typing import Protocol


class Clock(Protocol):
    """Tells the time, and lets it pass."""

    @property
    def is_simulated(self) -> bool:
        """Get whether time passes only when somebody lets it."""
        ...

    @property
    def now_s(self) -> float:
        """Get the time, seconds since 1970 UTC."""
        ...

    @property
    def monotonic_s(self) -> float:
        """Get a time that never jumps, seconds since anything: for durations."""
        ...

    def advance(self, duration_s: float) -> None:
        """Let time pass: wait, or not if it is simulated."""
        ...


class WallClock:
    """The computer's time: letting it pass means waiting."""

    @property
    def is_simulated(self) -> bool:
        """Get that it is not."""
        return False

    @property
    def now_s(self) -> float:
        """Get the time, seconds since 1970 UTC."""
        return time.time()

    @property
    def monotonic_s(self) -> float:
        """Get a time that never jumps."""
        return time.monotonic()

    def advance(self, duration_s: float) -> None:
        """Wait."""
        time.sleep(duration_s)


class SimulatedClock:
    """Time that passes only when somebody lets it."""

    def __init__(self, start_s: float) -> None:
        self._now_s = start_s

    @property
    def is_simulated(self) -> bool:
        """Get that it is."""
        return True

    @property
    def now_s(self) -> float:
        """Get the simulated time, seconds since 1970 UTC."""
        return self._now_s

    @property
    def monotonic_s(self) -> float:
        """Get the same time: it never jumps."""
        return self._now_s

    def advance(self, duration_s: float) -> None:
        """Let time pass at once."""
        self._now_s += duration_s
