"""The steps of a shot in the form the engine drives: each blocks, and runs in a worker thread.

bluesky asks its devices for methods such as ``trigger`` and ``read`` and needs no base class, so
that nothing here imports it.
"""

import queue
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, TypeAlias

from tronlab.campaign.brake import Brake
from tronlab.campaign.shot import ShotTaker
from tronlab.campaign.stop import RunStoppedError, StopRequest
from tronlab.dataset.records import ErrorClass
from tronlab.errors import DeviceError
from tronlab.planning.shots import Shot

_PATIENCE_S = 5.0

Numbers: TypeAlias = Mapping[str, float | int]
Step: TypeAlias = Callable[[], Numbers]


class Status:
    """The end of a step in a worker thread, in bluesky's form."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._lock = threading.Lock()
        self._done = threading.Event()
        self._error: BaseException | None = None
        self._callbacks: list[Callable[[Status], None]] = []

    def __repr__(self) -> str:
        """Say which step it is and how it went: bluesky puts this into the stop document."""
        if not self.done:
            return f"{self._what}: pending"
        return f"{self._what}: {self._error!r}" if self._error else f"{self._what}: done"

    def finish(self, error: BaseException | None = None) -> None:
        """Mark the step as done; only the first call counts."""
        with self._lock:
            if self._done.is_set():
                return
            self._error = error
            self._done.set()
        for callback in self._callbacks:
            callback(self)

    def add_callback(self, callback: Callable[["Status"], None]) -> None:
        """Have the callback called when the step is done, at once if it is."""
        with self._lock:
            if not self._done.is_set():
                self._callbacks.append(callback)
                return
        callback(self)

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Give the error of the step; None if there is none, or not yet."""
        return self._error if self._done.wait(timeout) else None

    @property
    def done(self) -> bool:
        """Get whether the step has ended."""
        return self._done.is_set()

    @property
    def success(self) -> bool:
        """Get whether the step has ended well."""
        return self.done and self._error is None


class Worker:
    """Runs one step at a time in a thread of its own, so that a stop need not wait for it."""

    def __init__(self, stop: StopRequest) -> None:
        self._stop = stop
        self._pending: Status | None = None
        self._steps: queue.SimpleQueue[tuple[Status, Callable[[], object]] | None] = (
            queue.SimpleQueue()
        )
        self._thread = threading.Thread(target=self._work, name="tronlab worker", daemon=True)
        stop.on_at_once(self._fail_pending)

    def __enter__(self) -> "Worker":
        """Begin to work."""
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Let a step that was not waited for come to its end, before its device is closed."""
        self._steps.put(None)
        self._thread.join(timeout=_PATIENCE_S)

    def start(self, what: str, work: Callable[[], object]) -> Status:
        """Start a step; its Status is done when the step is, or when the run must stop at once."""
        status = Status(what)
        self._pending = status
        self._steps.put((status, work))
        if self._stop.is_at_once:  # asked for while the step was being started
            self._fail_pending()
        return status

    def _work(self) -> None:
        while (step := self._steps.get()) is not None:
            status, work = step
            try:
                if self._stop.is_at_once:  # the robot was stopped: nothing may move it again
                    raise RunStoppedError
                work()
            except BaseException as error:  # the Status carries it to the engine
                status.finish(error)
            else:
                status.finish()

    def _fail_pending(self) -> None:
        """Wait no longer for the step in hand."""
        if self._pending is not None:
            self._pending.finish(RunStoppedError())


@dataclass(frozen=True, slots=True)
class Attempt:
    """One attempt at a shot."""

    shot: Shot
    number: int
    """From 1."""
    n_failures: Mapping[ErrorClass, int]
    """Attempts before it that came to nothing."""

    def __repr__(self) -> str:
        """Say which: bluesky writes its messages down, and a shot has long matrices."""
        return f"shot {self.shot.shot_id}, attempt {self.number}"


# bluesky keeps its devices in sets, and writes down what they are at every message.
@dataclass(eq=False, repr=False)
class Mover:
    """The robot: ``set`` begins a shot and drives to its target."""

    worker: Worker
    taker: ShotTaker
    brake: Brake
    check: Callable[[], None]
    """Raises if nothing may move."""
    name: str = "robot"
    parent: None = None
    _is_moving: bool = False

    def set(self, attempt: Attempt) -> Status:
        """Begin the shot and move; begun here so that a replay of messages begins it again."""
        shot = attempt.shot
        self.taker.begin(shot, attempt.number, n_failures=attempt.n_failures)
        return self.worker.start(f"move to shot {shot.shot_id}", self._move)

    def stop(self, *, success: bool = True) -> None:
        """Stop the robot, if it moves: bluesky calls this at the end of every run."""
        if self._is_moving:
            self.brake.pull()

    def _move(self) -> None:
        self.check()
        self._is_moving = True
        try:
            self.taker.move()
        except Exception:
            # Before anything else: also after an emergency stop, whose release must not let a
            # motion go on that the run no longer waits for.
            with suppress(DeviceError):
                self.taker.devices.robot.stop()
                self._is_moving = False
            raise
        self._is_moving = False


@dataclass(eq=False, repr=False)
class Measurement:
    """A step that may leave numbers."""

    name: str
    worker: Worker
    step: Step
    parent: None = None
    _numbers: Numbers = field(default_factory=dict[str, float | int])
    _time_s: float = 0.0

    def trigger(self) -> Status:
        """Do the step."""
        return self.worker.start(self.name, self._measure)

    def read(self) -> dict[str, Any]:
        """Give the numbers it left."""
        return {
            key: {"value": value, "timestamp": self._time_s} for key, value in self._numbers.items()
        }

    def describe(self) -> dict[str, Any]:
        """Give what the numbers are."""
        return {
            key: {
                "source": f"tronlab:{self.name}",
                "dtype": "integer" if isinstance(value, int) else "number",
                "shape": [],
            }
            for key, value in self._numbers.items()
        }

    def read_configuration(self) -> dict[str, Any]:
        """Give nothing: the dataset's provenance has the configuration."""
        return {}

    def describe_configuration(self) -> dict[str, Any]:
        """Give nothing, likewise."""
        return {}

    def _measure(self) -> None:
        self._numbers = self.step()
        self._time_s = time.time()


def deed(name: str, worker: Worker, action: Callable[[], object]) -> Measurement:
    """Make a step that leaves no numbers."""

    def step() -> Numbers:
        action()
        return {}

    return Measurement(name, worker, step)
