"""The heartbeat: what counts as standing still, and that its thread ends."""

import threading
import time

import pytest

from drivers.room import heartbeat as module
from drivers.room.heartbeat import Heartbeat
from tronlab.errors import DeviceFaultError, NotConnectedError


@pytest.fixture(autouse=True)
def _beats_are_quick(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "PERIOD_S", 0.005)


class OtherSide:
    """What answers: a count that goes on, or stands; or an error."""

    def __init__(self) -> None:
        self.heard: list[int] = []
        self.step = 1
        self.error: Exception | None = None
        self._count = 7
        self.n_beats = threading.Semaphore(0)

    def beat(self, count: int) -> int:
        self.heard.append(count)
        self.n_beats.release()
        if self.error is not None:
            raise self.error
        self._count += self.step
        return self._count

    def wait(self, n: int) -> None:
        for _ in range(n):
            assert self.n_beats.acquire(timeout=10.0)


@pytest.fixture
def other():
    return OtherSide()


@pytest.fixture
def heartbeat(other: OtherSide):
    beating = Heartbeat(other.beat, last_count=65534)
    yield beating
    beating.stop()
    beating.stop()


def test_counts_on_from_the_first_moment_and_begins_again_at_zero(
    heartbeat: Heartbeat, other: OtherSide
):
    heartbeat.start()
    assert other.heard[0] == 65535
    other.wait(4)
    assert other.heard[:4] == [65535, 0, 1, 2]


def test_a_count_that_goes_on_never_stands_still(heartbeat: Heartbeat, other: OtherSide):
    heartbeat.start()
    for _ in range(20):
        other.wait(1)
        assert heartbeat.still_s == 0.0


def test_a_count_that_stands_is_seen(heartbeat: Heartbeat, other: OtherSide):
    other.step = 0
    heartbeat.start()
    other.wait(10)
    begun = heartbeat.still_s
    other.wait(10)
    assert heartbeat.still_s > begun > 0.0


def test_who_refuses_to_answer_stands_still_too(heartbeat: Heartbeat, other: OtherSide):
    heartbeat.start()
    other.error = DeviceFaultError("busy", device="x", code=6)
    other.wait(10)
    assert heartbeat.still_s > 0.0


def test_ends_by_itself_when_the_connection_is_lost(other: OtherSide):
    heartbeat = Heartbeat(other.beat, last_count=65534)
    heartbeat.start()
    other.error = NotConnectedError("lost", device="x")
    for _ in range(1000):
        if not any(thread.name == "room heartbeat" for thread in threading.enumerate()):
            break
        time.sleep(0.005)
    else:
        pytest.fail("the thread still runs")
    heartbeat.stop()


def test_a_first_beat_that_fails_starts_nothing(heartbeat: Heartbeat, other: OtherSide):
    other.error = NotConnectedError("lost", device="x")
    with pytest.raises(NotConnectedError):
        heartbeat.start()
