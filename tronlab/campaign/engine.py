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

import bluesky.preprocessors as bpp
from bluesky import RunEngine
from bluesky.utils import DuringTask, FailedStatus, Msg

from tronlab.campaign.brake import Brake
from tronlab.campaign.console import Abort, Console, Decision, Note, Resume, Retake
from tronlab.campaign.course import Course
from tronlab.campaign.drift import DriftChecks
from tronlab.campaign.listener import RunListener
from tronlab.campaign.policy import Again, GiveUp, Setbacks, Wait
from tronlab.campaign.shot import ShotTaker
from tronlab.campaign.steps import Attempt, Measurement, Mover, Numbers, Worker, deed
from tronlab.campaign.stop import RunStoppedError, StopRequest
from tronlab.dataset.records import ShotRecord
from tronlab.planning.shots import Plan, Shot

_LOOK_UP_S = 0.1

Messages: TypeAlias = Generator[Msg, Any, None]

# The engine logs a traceback for every plan that ends early; whoever called run_shots gets the
# error itself. Without any handler, Python would print the log to stderr.
logging.getLogger("bluesky").addHandler(logging.NullHandler())


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """How a run went that came to its end."""

    skipped: Mapping[int, str]
    """Shots of which nothing is stored: why, by id."""


def run_shots(
    plan: Plan,
    taker: ShotTaker,
    *,
    commit: Callable[[ShotRecord, bool], None],
    drift: DriftChecks | None = None,
    stop: StopRequest | None = None,
    listener: RunListener | None = None,
    console: Console | None = None,
    free_bytes: Callable[[], int] | None = None,
    n_spare_rows: int | None = None,
) -> RunOutcome:
    """Take every shot of a plan and commit it; works in any thread.

    Args:
        plan: What to take.
        taker: Does the steps of a shot, and of a drift check; its configuration says what is done
            about errors.
        commit: Stores a record, given whether it replaces one of this run; whatever it raises ends
            the run.
        drift: When to check for drift; by default never.
        stop: Where to look for a request to pause or stop.
        listener: Who is told.
        console: Who is asked how to go on after the first request; without one the run stops.
        free_bytes: Gives the room left on the disk; by default it is not watched.
        n_spare_rows: Room in the dataset for shots that are taken again; by default no limit.

    Returns:
        Which shots were skipped; all others are committed.

    Raises:
        RunStoppedError: ``stop`` was asked for, and a person did not let the run go on.
        DeviceError: A device failed, and ``policy`` knows no remedy or none has helped.
        DatasetError: The disk stayed full for too long.
    """
    stop = stop or StopRequest()
    course = Course(
        plan,
        taker,
        commit=commit,
        drift=drift,
        stop=stop,
        listener=listener or RunListener(),
        free_bytes=free_bytes,
        n_spare_rows=n_spare_rows,
    )
    with _hired(course, console) as crew, _engine() as engine:
        engine.subscribe(course.take_document)
        try:
            engine(_campaign(plan, crew))
        except FailedStatus as error:
            raise (error.__cause__ or error) from None
    return RunOutcome(skipped=dict(course.schedule.skipped))


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


@dataclass(frozen=True)
class _Task:
    """What is tried until it is done."""

    name: str
    begin: Callable[[Setbacks], None]
    """Forgets what was before."""
    attempt: Callable[[Setbacks], Messages]
    can_be_skipped: bool


@dataclass(frozen=True)
class _Crew:
    """Who does the tasks of a run."""

    course: Course
    worker: Worker
    console: Console | None
    mover: Mover
    measurements: tuple[Measurement, ...]
    """Of a shot after the move, in this order."""
    watch: Measurement
    """Checks for drift."""


@contextmanager
def _hired(course: Course, console: Console | None) -> Generator[_Crew]:
    """Give a crew; afterwards nothing of it is at work any more, and the robot stands still."""
    taker, stop = course.taker, course.stop
    with Brake(taker.devices.robot, warn=taker.warn) as brake:
        stop.on_at_once(brake.pull)  # before all others
        worker = Worker(stop)
        if console is not None:
            stop.on_at_once(console.dismiss)
        crew = _crew(course, worker, brake, console)
        try:
            with worker:
                yield crew
        finally:
            crew.mover.stop()  # if it still moves: nobody waits for it any more


def _crew(course: Course, worker: Worker, brake: Brake, console: Console | None) -> _Crew:
    taker = course.taker

    def in_safe_room(name: str, step: Callable[[], Numbers]) -> Measurement:
        return Measurement(name, worker, lambda: (taker.check_room(), step())[1])

    return _Crew(
        course=course,
        worker=worker,
        console=console,
        mover=Mover(worker, taker, brake, check=course.check_before_shot),
        measurements=(
            in_safe_room("settle", taker.settle),
            in_safe_room("tracker", taker.measure),
            in_safe_room("camera", taker.grab),
            in_safe_room("confirm", taker.confirm),
            in_safe_room("encoders", taker.read),
            Measurement("gate", worker, course.judge),
            Measurement("record", worker, course.post_shot),
        ),
        watch=in_safe_room("reflectors", course.post_check),
    )


def _campaign(plan: Plan, crew: _Crew) -> Messages:
    @bpp.run_decorator(md={"plan_sha256": plan.sha256, "n_shots": len(plan.shots)})
    def tasks() -> Messages:
        try:
            yield from _tasks(crew)
        except RunStoppedError:
            yield from _last_check(crew)
            raise

    yield from tasks()


def _tasks(crew: _Crew) -> Messages:
    """Take all shots, those too that a person adds, and check for drift between them."""
    course, stop = crew.course, crew.course.stop
    while True:
        can_ask = crew.console is not None and not stop.is_final
        if stop.is_asked and (can_ask or course.schedule.has_next):
            yield from _pause(crew)
        if course.is_check_due:
            yield from _until_done(_check_task(crew), crew)
        elif course.schedule.has_next:
            yield from _until_done(_shot_task(course.schedule.begin_next(), crew), crew)
        else:
            return


def _last_check(crew: _Crew) -> Messages:
    """Check once more before a run that was stopped ends: else its last shots stay unchecked.

    Nobody waits for a second try, and whoever asks for a stop at once not even for the first.
    """
    course = crew.course
    course.is_ending = True
    if not course.has_unchecked_shots or course.stop.is_at_once:
        return
    course.taker.begin_check(course.schedule.n_commits, 1)
    with suppress(FailedStatus):
        yield from _check(crew)


def _shot_task(shot: Shot, crew: _Crew) -> _Task:
    def attempt_after(setbacks: Setbacks) -> Attempt:
        return Attempt(shot, setbacks.attempt, dict(setbacks.n_failures))

    return _Task(
        name=f"shot {shot.shot_id}",
        begin=lambda setbacks: crew.course.begin(attempt_after(setbacks)),
        attempt=lambda setbacks: _shot(attempt_after(setbacks), crew),
        can_be_skipped=True,
    )


def _check_task(crew: _Crew) -> _Task:
    n_before = crew.course.schedule.n_commits
    return _Task(
        name=f"drift check after {n_before} shots",
        begin=lambda setbacks: crew.course.taker.begin_check(n_before, setbacks.attempt),
        attempt=lambda _setbacks: _check(crew),
        can_be_skipped=False,
    )


def _until_done(task: _Task, crew: _Crew) -> Messages:
    """Do a task, and do about its errors what the policy says."""
    course = crew.course
    setbacks = Setbacks(task.name, course.taker.config)
    while True:
        if course.stop.is_asked:
            yield from _pause(crew, setbacks)
        task.begin(setbacks)
        try:
            yield from _reconnect_lost(crew)
            yield from task.attempt(setbacks)
        except FailedStatus as failure:
            match course.react(setbacks, failure.__cause__):
                case Again(pause_s) | Wait(pause_s):
                    yield from _nap(pause_s, crew)
                case GiveUp() if task.can_be_skipped and course.can_skip(failure.__cause__):
                    course.skip(setbacks, failure.__cause__)
                    return
                case _:
                    raise
        else:
            course.tell_resumed(setbacks)
            return


def _pause(crew: _Crew, setbacks: Setbacks | None = None) -> Messages:
    """Ask a person how to go on.

    Raises:
        RunStoppedError: Nobody can be asked, or the person ends the run.
    """
    course, console = crew.course, crew.console
    if console is None or course.stop.is_final or course.stop.is_at_once:
        raise RunStoppedError
    pause = course.pause(setbacks)
    course.listener.on_pause(pause)
    decisions: list[Decision] = []
    ask = deed("question", crew.worker, lambda: decisions.append(console.ask(pause)))
    while True:
        yield from _trigger(ask)
        decision = decisions.pop()
        course.listener.on_decision(decision)
        match decision:
            case Note():
                continue
            case Abort():
                raise RunStoppedError
            case Retake(shot_ids):
                course.retake(shot_ids)
            case Resume():
                course.accept_light(setbacks)
        break
    course.stop.withdraw()
    course.renew_patience(setbacks)


def _reconnect_lost(crew: _Crew) -> Messages:
    """Connect a device again that was lost in the attempt before."""
    device, taker = crew.course.lost_device, crew.course.taker
    if device is not None:
        yield from _trigger(deed(f"connect {device}", crew.worker, lambda: taker.reconnect(device)))
        crew.course.lost_device = None


def _nap(duration_s: float, crew: _Crew) -> Messages:
    yield from _trigger(deed("wait", crew.worker, lambda: crew.course.nap(duration_s)))


# Messages are yielded as they are: the stubs of bluesky keep a stack trace of each.


def _shot(attempt: Attempt, crew: _Crew) -> Messages:
    yield Msg("checkpoint")
    group = object()
    yield Msg("set", crew.mover, attempt, group=group)
    yield Msg("wait", None, group=group)
    for measurement in crew.measurements:
        yield from _trigger(measurement)
    yield from _save("shots", crew.measurements)


def _check(crew: _Crew) -> Messages:
    yield Msg("checkpoint")
    yield from _trigger(crew.watch)
    yield from _save("drift", (crew.watch,))


def _save(stream: str, measurements: tuple[Measurement, ...]) -> Messages:
    yield Msg("create", None, name=stream)
    for measurement in measurements:
        yield Msg("read", measurement)
    yield Msg("save")


def _trigger(step: Measurement) -> Messages:
    # A group of its own: a step that fails before it is waited for stays in its group, and would
    # fail the wait for another step.
    group = object()
    yield Msg("trigger", step, group=group)
    yield Msg("wait", None, group=group)
