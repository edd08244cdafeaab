"""The Bluesky engine behind its seam: nothing else of tronlab imports bluesky.

Each step of a shot blocks; here it runs in a worker thread and its end is a Status. Images never
travel in documents: an event holds the shot's id, its attempt and small numbers, and the record
waits in a mailbox under that id until the writer, an ordinary blocking subscriber, takes it. Drift
checks go the same way, between shots.
"""

import logging
import threading
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, TypeAlias

import bluesky.plan_stubs as bps
import bluesky.preprocessors as bpp
from bluesky import RunEngine
from bluesky.utils import DuringTask, FailedStatus, Msg

from tronlab.campaign.drift import DriftChecks
from tronlab.campaign.policy import MAX_ATTEMPTS, PAUSES_S, Remedy, Setbacks, remedy_for
from tronlab.campaign.shot import ShotTaker
from tronlab.campaign.steps import Measurement, Mover, Numbers, Worker, deed
from tronlab.campaign.stop import RunStoppedError, StopRequest
from tronlab.dataset.records import DriftRecord, ShotRecord
from tronlab.errors import DeviceError
from tronlab.planning.shots import Plan, Shot

_SAFETY_LOOK_S = 0.5
_LOOK_UP_S = 0.1

Messages: TypeAlias = Generator[Msg, Any, None]

# The engine logs a traceback for every plan that ends early; whoever called run_shots gets the
# error itself. Without any handler, Python would print the log to stderr.
logging.getLogger("bluesky").addHandler(logging.NullHandler())


@dataclass(frozen=True)
class RunListener:
    """Who is told what happens; the calls come from the engine's thread.

    A task is a shot or a drift check, by the name it has in messages.
    """

    on_shot: Callable[[ShotRecord], None] = lambda record: None
    """A shot was committed."""
    on_retry: Callable[[str, int, Exception], None] = lambda task, attempt, error: None
    """An attempt failed and another follows: task, the attempt that failed, its error."""
    on_wait: Callable[[str, Exception], None] = lambda task, error: None
    """The cell is not safe: the run waits before this task."""
    on_resume: Callable[[str], None] = lambda task: None
    """It is safe again, and this task was done."""


def run_shots(
    plan: Plan,
    taker: ShotTaker,
    *,
    commit: Callable[[ShotRecord], None],
    drift: DriftChecks | None = None,
    stop: StopRequest | None = None,
    listener: RunListener | None = None,
) -> None:
    """Take every shot of a plan and commit it; works in any thread.

    Args:
        plan: What to take.
        taker: Does the steps of a shot, and of a drift check.
        commit: Stores a record; whatever it raises ends the run.
        drift: When to check for drift; by default never.
        stop: Where to look for a request to stop.
        listener: Who is told.

    Raises:
        RunStoppedError: ``stop`` was asked for.
        DeviceError: A device failed, and ``policy`` knows no remedy or none has helped.
    """
    stop = stop or StopRequest()
    run = _Run(taker, commit=commit, drift=drift, stop=stop, listener=listener or RunListener())
    with _engine() as engine:
        engine.subscribe(run.take_document)
        try:
            engine(_campaign(plan, run))
        except FailedStatus as error:
            raise (error.__cause__ or error) from None
        finally:
            run.worker.join()


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


class _Run:
    """What the tasks of one run share."""

    def __init__(
        self,
        taker: ShotTaker,
        *,
        commit: Callable[[ShotRecord], None],
        drift: DriftChecks | None,
        stop: StopRequest,
        listener: RunListener,
    ) -> None:
        self.taker = taker
        self.drift = drift
        self.stop = stop
        self.listener = listener
        self.worker = Worker(stop)
        self.shots: dict[tuple[int, int], ShotRecord] = {}
        """The mailbox: by id and attempt."""
        self.checks: dict[int, DriftRecord] = {}
        """The mailbox of drift checks: by the number of shots before."""
        self.n_at_last_check = 0
        """A check before the first shot is made before the engine starts."""
        self._commit = commit
        self._committed: set[int] = set()

    @property
    def n_committed(self) -> int:
        """Get the number of shots that are stored."""
        return len(self._committed)

    def take_document(self, name: str, document: Mapping[str, Any]) -> None:
        """Commit what an event speaks of."""
        if name != "event":
            return
        data = document["data"]
        if "shot_id" in data:
            self._take_shot(self.shots.pop((data["shot_id"], data["attempt"])))
        else:
            self._take_check(self.checks.pop(data["n_shots_before"]))

    def _take_shot(self, record: ShotRecord) -> None:
        """Commit a shot; a replayed event finds it committed."""
        if record.shot_id in self._committed:
            return
        self._commit(record)
        self._committed.add(record.shot_id)
        self.listener.on_shot(record)

    def _take_check(self, check: DriftRecord) -> None:
        """Commit a drift check; a replayed event finds it committed."""
        if self.drift is None or check.n_shots_before == self.n_at_last_check:
            return
        self.n_at_last_check = check.n_shots_before
        self.drift.commit(check)


@dataclass(frozen=True)
class _Task:
    """What is tried until it is done."""

    name: str
    begin: Callable[[int], None]
    """Forgets what was before; is given the number of the attempt."""
    attempt: Callable[[int], Messages]


@dataclass(frozen=True)
class _Crew:
    """Who does the tasks of a run."""

    run: _Run
    mover: Mover
    guard: Measurement
    """Looks whether the room is safe."""
    steps: tuple[Measurement, ...]
    """Of a shot after the move, in this order."""
    watch: Measurement
    """Checks for drift."""


def _campaign(plan: Plan, run: _Run) -> Messages:
    taker, worker = run.taker, run.worker
    crew = _Crew(
        run=run,
        mover=Mover(worker, taker),
        guard=deed("room", worker, taker.check_room),
        steps=(
            Measurement("settle", worker, taker.settle),
            Measurement("tracker", worker, taker.measure),
            Measurement("camera", worker, taker.grab),
            Measurement("confirm", worker, taker.confirm),
            Measurement("encoders", worker, taker.read),
            Measurement("record", worker, lambda: _post_shot(run)),
        ),
        watch=Measurement("reflectors", worker, lambda: _post_check(run)),
    )

    @bpp.run_decorator(md={"plan_sha256": plan.sha256, "n_shots": len(plan.shots)})
    def tasks() -> Messages:
        try:
            for shot in plan.shots:
                yield from _until_done(_shot_task(shot, crew), crew)
                if _is_check_due(run, n_planned=len(plan.shots)):
                    yield from _until_done(_check_task(crew), crew)
        except RunStoppedError:
            yield from _last_check(crew)
            raise

    yield from tasks()


def _post_shot(run: _Run) -> Numbers:
    record = run.taker.assemble()
    run.shots[record.shot_id, record.attempt] = record
    return {
        "shot_id": record.shot_id,
        "attempt": record.attempt,
        "range_los_m": record.truth.range_los_m,
        "usable_fraction": record.truth.usable_fraction,
    }


def _post_check(run: _Run) -> Numbers:
    check = run.taker.check_drift(run.n_committed)
    run.checks[check.n_shots_before] = check
    return {"n_shots_before": check.n_shots_before, "max_shift_m": check.max_shift_m}


def _is_check_due(run: _Run, *, n_planned: int) -> bool:
    if run.drift is None:
        return False
    every = run.drift.every_n_shots
    return run.n_committed == n_planned or (every is not None and run.n_committed % every == 0)


def _last_check(crew: _Crew) -> Messages:
    """Check once more before a run that was stopped ends: else its last shots stay unchecked.

    Nobody waits for a second try, and whoever asks for a stop at once not even for the first.
    """
    run = crew.run
    if run.drift is None or run.stop.is_at_once or run.n_committed == run.n_at_last_check:
        return
    run.taker.begin_check(run.n_committed, 1)
    with suppress(FailedStatus):
        yield from _check(crew)


def _shot_task(shot: Shot, crew: _Crew) -> _Task:
    return _Task(
        name=f"shot {shot.shot_id}",
        begin=lambda attempt: crew.run.taker.begin(shot, attempt),
        attempt=lambda attempt: _shot(shot, attempt, crew),
    )


def _check_task(crew: _Crew) -> _Task:
    n_before = crew.run.n_committed
    return _Task(
        name=f"drift check after {n_before} shots",
        begin=lambda attempt: crew.run.taker.begin_check(n_before, attempt),
        attempt=lambda _attempt: _check(crew),
    )


def _until_done(task: _Task, crew: _Crew) -> Messages:
    """Do a task, and do about its errors what the policy says."""
    setbacks = Setbacks()
    while True:
        if crew.run.stop.is_asked:
            raise RunStoppedError
        task.begin(setbacks.attempt)
        try:
            if setbacks.lost is not None:
                yield from _reconnect(setbacks.lost, crew)
                setbacks.lost = None
            yield from task.attempt(setbacks.attempt)
        except FailedStatus as failure:
            pause_s = _pause_after(failure.__cause__, task, setbacks, crew.run)
            if pause_s is None:
                raise
            yield from _nap(pause_s, crew)
        else:
            if setbacks.suspensions:
                crew.run.listener.on_resume(task.name)
            return


def _pause_after(
    error: BaseException | None, task: _Task, setbacks: Setbacks, run: _Run
) -> float | None:
    """Note a setback, and say how long to pause before the next attempt; None: there is none."""
    remedy = remedy_for(error)
    if not isinstance(error, DeviceError) or remedy is Remedy.STOP:
        return None
    if run.taker.is_in_place:  # the robot moved, so the cell was safe since it last was not
        setbacks.unsafe_since_s = None
    if remedy is Remedy.WAIT:
        return _pause_until_safe(error, task, setbacks, run)
    return _pause_after_failure(error, task, setbacks, run)


def _pause_until_safe(
    error: DeviceError, task: _Task, setbacks: Setbacks, run: _Run
) -> float | None:
    now_s = run.taker.monotonic_s()
    if setbacks.unsafe_since_s is None:
        setbacks.unsafe_since_s = now_s
        setbacks.suspensions += 1
        run.listener.on_wait(task.name, error)
    elif now_s - setbacks.unsafe_since_s > run.taker.config.suspend.timeout_s:
        return None
    return _SAFETY_LOOK_S


def _pause_after_failure(
    error: DeviceError, task: _Task, setbacks: Setbacks, run: _Run
) -> float | None:
    attempt = setbacks.attempt
    setbacks.failures += 1
    if setbacks.failures == MAX_ATTEMPTS:
        return None
    run.listener.on_retry(task.name, attempt, error)
    if remedy_for(error) is Remedy.RECONNECT:
        setbacks.lost = error.device
    return PAUSES_S[setbacks.failures - 1]


def _reconnect(device: str, crew: _Crew) -> Messages:
    taker = crew.run.taker
    yield from _trigger(deed(f"connect {device}", crew.run.worker, lambda: taker.reconnect(device)))


def _nap(duration_s: float, crew: _Crew) -> Messages:
    yield from _trigger(deed("wait", crew.run.worker, lambda: crew.run.taker.sleep(duration_s)))


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


def _check(crew: _Crew) -> Messages:
    yield from bps.checkpoint()
    yield from _trigger(crew.guard)
    yield from _trigger(crew.watch)
    yield from bps.create(name="drift")
    yield from bps.read(crew.watch)
    yield from bps.save()


def _trigger(step: Measurement) -> Messages:
    # A group of its own: a step that fails before it is waited for stays in its group, and would
    # fail the wait for another step.
    group = object()
    yield from bps.trigger(step, group=group)
    yield from bps.wait(group=group)
