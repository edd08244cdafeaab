"""The camera's own clock, which counts ticks since it was started or reset."""

import time

from drivers.gige.simulator.bootstrap import TICK_HZ


class DeviceClock:
    """Counts at ``TICK_HZ``."""

    def __init__(self) -> None:
        self._zero_s = time.perf_counter()

    def ticks(self) -> int:
        """Read the clock."""
        return self.ticks_at(time.perf_counter())

    def ticks_at(self, time_s: float) -> int:
        """Give what the clock shows at a time of ``time.perf_counter``."""
        return max(0, round((time_s - self._zero_s) * TICK_HZ))

    def reset(self) -> None:
        """Count from 0 again."""
        self._zero_s = time.perf_counter()
