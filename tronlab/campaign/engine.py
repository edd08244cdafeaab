"""The Bluesky engine behind its seam: nothing else of tronlab imports bluesky.

Each step of a shot blocks; here it runs in a worker thread and its end is a Status. Images never
travel in documents: an event holds the shot's id, its attempt and small numbers, and the record
waits in a mailbox under that id until the writer, an ordinary blocking subscriber, takes it.
"""

import logging
import threading
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import bluesky.plan_stubs as bps
import bluesky.preprocessors as bpp
from bluesky import RunEngine
from bluesky.utils import DuringTask, FailedStatus, Msg

from tronlab.campaign.plan import Plan, Shot
from tronlab.campaign.policy import MAX_ATTEMPTS, PAUSES_S, Remedy, Setbacks, remedy_for
from tronlab.campaign.shot import ShotTaker
from tronlab.campaign.stop import RunStoppedError, StopRequest
from tronlab.dataset.records import ShotRecord
from tronlab.errors import DeviceError

_WORKER_PATIENCE_S = 5.0
_SAFETY_LOOK_S = 0.5
_LOOK_UP_S = 0.1

Numbers: TypeAlias = Mapping[str, float | int]
Step: TypeAlias = Callable[[], Numbers]
Messages: TypeAlias = Generator[Msg, Any, None]

# The engine logs a traceback for every plan that ends early; whoever called run_shots gets the
# error itself. Without any handler, Python would print the log to stderr.
logging.getLogger("bluesky").addHandler(logging.NullHandler())


@dataclass(frozen=True)
class RunListener:
    """Who is told what happens; the calls come from the engine's thread."""

    on_shot: Callable[[ShotRecord], None] = lambda record: None
    """A shot was committed."""
    on_retry: Callable[[Shot, int, Exception], None] = lambda shot, attempt, error: None
    """An attempt failed and another follows: shot, the attempt that failed, its error."""
    on_wait: Callable[[Shot, Exception], None] = lambda shot, error: None
    """The cell is not safe: the run waits before this shot."""
    on_resume: Callable[[Shot], None] = lambda shot: None
    """It is safe again, and this shot was taken."""


def run_shots(
    plan: Plan,
    taker: ShotTaker,
    *,
    commit: Callable[[ShotRecord], None],
    stop: StopRequest | None = None,
    listener: RunListener | None = None,
) -> None:
    """Take every shot of a plan and commit it; works in any thread.

    Args:
        plan: What to take.
        taker: Does the steps of a shot.
        commit: Stores a record; whatever it raises ends the run.
        stop: Where to look for a request to stop.
        listener: Who is told.

    Raises:
        RunStoppedError: ``stop`` was asked for.
        DeviceError: A device failed, and ``policy`` knows no remedy or none has helped.
    """
    stop = stop or StopRequest()
    run = _Run(taker, commit=commit, stop=stop, listener=listener or RunListener())
    stop.on_at_once(run.fail_pending)
    with _engine() as engine:
        engine.subscribe(run.take_document)
        try:
            engine(_campaign(plan, run))
        except FailedStatus as error:
            raise (error.__cause__ or error) from None
        finally:
            run.join_worker()


@contextmanager
def _engine() -> Generator[RunEngine]:
    """Give an engine without signal handlers, and end its thread afterwards."""
    engine = RunEngine({}, context_managers=[], during_task=_WakefulWait())
    thread: threading.Thread = engine._th  # noqa: SLF001  # pyright: ignore[reportPrivateUsage]
    try:
        yield engine
    finally:
        engine.loop.call_soon_threadsafe(engine.loop.stop)
        thread.join()
        engine.loop.close()


class _WakefulWait(DuringTask):
    """Lets the calling thread look up while the engine works.

    Python handles signals in that thread only, and a wait without end can sleep through a Ctrl-C.
    """

    def block(self, blocking_event: threading.Event) -> None:
        while not blocking_event.wait(_LOOK_UP_S):
            pass


class _Status:
    """The end of a step in a worker thread, in bluesky's form."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._lock = threading.Lock()
        self._done = threading.Event()
        self._error: BaseException | None = None
        self._callbacks: list[Callable[[_Status], None]] = []

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

    def add_callback(self, callback: Callable[["_Status"], None]) -> None:
        with self._lock:
            if not self._done.is_set():
                self._callbacks.append(callback)
                return
        callback(self)

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        return self._error if self._done.wait(timeout) else None

    @property
    def done(self) -> bool:
        return self._done.is_set()

    @property
    def success(self) -> bool:
        return self.done and self._error is None


class _Run:
    """What the steps of one run share."""

    def __init__(
        self,
        taker: ShotTaker,
        *,
        commit: Callable[[ShotRecord], None],
        stop: StopRequest,
        listener: RunListener,
    ) -> None:
        self.taker = taker
        self.stop = stop
        self.listener = listener
        self.mailbox: dict[tuple[int, int], ShotRecord] = {}
        self._commit = commit
        self._committed: set[int] = set()
        self._pending: _Status | None = None
        self._worker: threading.Thread | None = None

    def in_thread(self, what: str, work: Callable[[], object]) -> _Status:
        """Start a step; its Status is done when the step is, or when the run must stop at once."""
        status = _Status(what)

        def run() -> None:
            try:
                work()
            except BaseException as error:  # the Status carries it to the engine
                status.finish(error)
            else:
                status.finish()

        self._pending = status
        self._worker = threading.Thread(target=run, name=f"tronlab {what}", daemon=True)
        self._worker.start()
        if self.stop.is_at_once:  # asked for while the step was being started
            self.fail_pending()
        return status

    def fail_pending(self) -> None:
        """Wait no longer for the step in hand."""
        if self._pending is not None:
            self._pending.finish(RunStoppedError())

    def join_worker(self) -> None:
        """Let a step that was not waited for come to its end, before its device is closed."""
        if self._worker is not None:
            self._worker.join(timeout=_WORKER_PATIENCE_S)

    def take_document(self, name: str, document: Mapping[str, Any]) -> None:
        """Commit the record an event speaks of; a replayed event finds its shot committed."""
        if name != "event":
            return
        shot_id, attempt = document["data"]["shot_id"], document["data"]["attempt"]
        record = self.mailbox.pop((shot_id, attempt))
        if shot_id in self._committed:
            return
        self._commit(record)
        self._committed.add(shot_id)
        self.listener.on_shot(record)


@dataclass(eq=False)  # bluesky keeps its devices in sets
class _Mover:
    """The robot as bluesky moves it: ``set`` begins a shot and drives to its target."""

    run: _Run
    name: str = "robot"
    parent: None = None
    _is_moving: bool = False

    def set(self, shot_and_attempt: tuple[Shot, int]) -> _Status:
        """Begin the shot and move; begun here so that a replay of messages begins it again."""
        shot, attempt = shot_and_attempt
        self.run.taker.begin(shot, attempt)
        self._is_moving = True
        return self.run.in_thread(f"move to shot {shot.shot_id}", self._move)

    def stop(self, *, success: bool = True) -> None:
        """Stop the robot, if it moves: bluesky calls this at the end of every run."""
        if self._is_moving:
            self.run.taker.devices.robot.stop()

    def _move(self) -> None:
        self.run.taker.move()
        self._is_moving = False


@dataclass(eq=False)  # bluesky keeps its devices in sets
class _Measurement:
    """A step of a shot as bluesky triggers it; ``read`` gives the numbers it left."""

    name: str
    run: _Run
    step: Step
    parent: None = None
    _numbers: Numbers = field(default_factory=dict[str, float | int])
    _time_s: float = 0.0

    def trigger(self) -> _Status:
        return self.run.in_thread(self.name, self._measure)

    def read(self) -> dict[str, Any]:
        return {
            key: {"value": value, "timestamp": self._time_s} for key, value in self._numbers.items()
        }

    def describe(self) -> dict[str, Any]:
        return {
            key: {
                "source": f"tronlab:{self.name}",
                "dtype": "integer" if isinstance(value, int) else "number",
                "shape": [],
            }
            for key, value in self._numbers.items()
        }

    def read_configuration(self) -> dict[str, Any]:
        return {}

    def describe_configuration(self) -> dict[str, Any]:
        return {}

    def _measure(self) -> None:
        self._numbers = self.step()
        self._time_s = time.time()


def _campaign(plan: Plan, run: _Run) -> Messages:
    taker = run.taker
    crew = _Crew(
        run=run,
        mover=_Mover(run),
        guard=_deed("room", run, taker.check_room),
        steps=(
            _Measurement("settle", run, taker.settle),
            _Measurement("tracker", run, taker.measure),
            _Measurement("camera", run, taker.grab),
            _Measurement("confirm", run, taker.confirm),
            _Measurement("encoders", run, taker.read),
            _Measurement("record", run, lambda: _put_into_mailbox(run)),
        ),
    )

    @bpp.run_decorator(md={"plan_sha256": plan.sha256, "n_shots": len(plan.shots)})
    def shots() -> Messages:
        for shot in plan.shots:
            yield from _shot_until_taken(shot, crew)

    yield from shots()


@dataclass(frozen=True)
class _Crew:
    """Who takes the shots of a run."""

    run: _Run
    mover: _Mover
    guard: _Measurement
    """Looks whether the room is safe."""
    steps: tuple[_Measurement, ...]
    """After the move, in this order."""


def _deed(name: str, run: _Run, action: Callable[[], None]) -> _Measurement:
    """Make a step that leaves no numbers."""

    def step() -> Numbers:
        action()
        return {}

    return _Measurement(name, run, step)


def _put_into_mailbox(run: _Run) -> Numbers:
    record = run.taker.assemble()
    run.mailbox[record.shot_id, record.attempt] = record
    return {
        "shot_id": record.shot_id,
        "attempt": record.attempt,
        "range_los_m": record.truth.range_los_m,
        "usable_fraction": record.truth.usable_fraction,
    }


def _shot_until_taken(shot: Shot, crew: _Crew) -> Messages:
    """Take a shot, and do about its errors what the policy says."""
    setbacks = Setbacks()
    while True:
        if crew.run.stop.is_asked:
            raise RunStoppedError
        crew.run.taker.begin(shot, setbacks.attempt)
        try:
            if setbacks.lost is not None:
                yield from _reconnect(setbacks.lost, crew)
                setbacks.lost = None
            yield from _shot(shot, setbacks.attempt, crew)
        except FailedStatus as failure:
            pause_s = _pause_after(failure.__cause__, shot, setbacks, crew.run)
            if pause_s is None:
                raise
            yield from _nap(pause_s, crew)
        else:
            if setbacks.suspensions:
                crew.run.listener.on_resume(shot)
            return


def _pause_after(
    error: BaseException | None, shot: Shot, setbacks: Setbacks, run: _Run
) -> float | None:
    """Note a setback, and say how long to pause before the next attempt; None: there is none."""
    remedy = remedy_for(error)
    if not isinstance(error, DeviceError) or remedy is Remedy.STOP:
        return None
    if run.taker.is_in_place:  # the robot moved, so the cell was safe since it last was not
        setbacks.unsafe_since_s = None
    if remedy is Remedy.WAIT:
        return _pause_until_safe(error, shot, setbacks, run)
    return _pause_after_failure(error, shot, setbacks, run)


def _pause_until_safe(
    error: DeviceError, shot: Shot, setbacks: Setbacks, run: _Run
) -> float | None:
    now_s = run.taker.monotonic_s()
    if setbacks.unsafe_since_s is None:
        setbacks.unsafe_since_s = now_s
        setbacks.suspensions += 1
        run.listener.on_wait(shot, error)
    elif now_s - setbacks.unsafe_since_s > run.taker.config.room.timeout_s:
        return None
    return _SAFETY_LOOK_S


def _pause_after_failure(
    error: DeviceError, shot: Shot, setbacks: Setbacks, run: _Run
) -> float | None:
    attempt = setbacks.attempt
    setbacks.failures += 1
    if setbacks.failures == MAX_ATTEMPTS:
        return None
    run.listener.on_retry(shot, attempt, error)
    if remedy_for(error) is Remedy.RECONNECT:
        setbacks.lost = error.device
    return PAUSES_S[setbacks.failures - 1]


def _reconnect(device: str, crew: _Crew) -> Messages:
    taker = crew.run.taker
    yield from _trigger(_deed(f"connect {device}", crew.run, lambda: taker.reconnect(device)))


def _nap(duration_s: float, crew: _Crew) -> Messages:
    yield from _trigger(_deed("wait", crew.run, lambda: crew.run.taker.sleep(duration_s)))


def _shot(shot: Shot, attempt: int, crew: _Crew) -> Messages:
    yield from bps.checkpoint()
    yield from _trigger(crew.guard)
    yield from bps.abs_set(crew.mover, (shot, attempt), wait=True)
    for step in crew.steps:
        yield from _trigger(crew.guard)
        yield from _trigger(step)
    yield from bps.create(name="shots")
    for step in crew.steps:
        yield from bps.read(step)
    yield from bps.save()


def _trigger(step: _Measurement) -> Messages:
    # A group of its own: a step that fails before it is waited for stays in its group, and would
    # fail the wait for another step.
    group = object()
    yield from bps.trigger(step, group=group)
    yield from bps.wait(group=group)
