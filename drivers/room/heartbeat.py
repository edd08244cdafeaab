"""Heartbeats between this computer and the PLC."""

import threading
import time
from collections.abc import Callable
from typing import Final

from tronlab.errors import DeviceError, DeviceFaultError

PERIOD_S: Final = 0.5
"""Of this computer's heartbeat; the PLC drops all requests when it misses it for 2 s."""
_WRAP: Final = 0x10000


class Heartbeat:
    """A thread that beats, and watches the other side's count.

    Args:
        beat: Sends this side's count, 0 to 65535, and gives the other side's.
        last_count: What this side sent last, maybe long ago: only a change is a heartbeat.
    """

    def __init__(self, beat: Callable[[int], int], *, last_count: int) -> None:
        self._beat = beat
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="room heartbeat", daemon=True)
        self._own_count = last_count
        self._other_count: int | None = None
        self._changed_s = time.monotonic()
        self._stood_s = 0.0

    @property
    def still_s(self) -> float:
        """Get how long the other side's count had stood still when last seen, seconds.

        Judged when seen, not when asked: a computer that was itself too busy to look has seen
        nothing wrong.
        """
        return self._stood_s

    def start(self) -> None:
        """Beat once, then go on in the background.

        Raises:
            DeviceError: The first beat failed.
        """
        self._once()
        self._thread.start()

    def stop(self) -> None:
        """Beat no more; returns when the thread has ended."""
        self._stopped.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while not self._stopped.wait(PERIOD_S):
            try:
                self._once()
            except DeviceFaultError:
                self._judge(time.monotonic())
            except DeviceError:
                return  # the connection is down, and says why at the next call

    def _once(self) -> None:
        self._own_count = (self._own_count + 1) % _WRAP
        count, now_s = self._beat(self._own_count), time.monotonic()
        if count != self._other_count:
            self._other_count, self._changed_s = count, now_s
        self._judge(now_s)

    def _judge(self, now_s: float) -> None:
        self._stood_s = now_s - self._changed_s
