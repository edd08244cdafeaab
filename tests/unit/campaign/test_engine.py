"""What the engine does when nothing goes wrong, and how a run ends."""

# pyright: reportPrivateUsage=false
import threading
from typing import Any

import pytest
from recorded_session import RecordedSession

from tronlab.campaign import engine, steps
from tronlab.campaign.config import DriftConfig
from tronlab.campaign.course import Course
from tronlab.campaign.drift import DriftChecks, n_checks
from tronlab.campaign.listener import RunListener
from tronlab.campaign.shot import ShotTaker
from tronlab.campaign.steps import Status, Worker
from tronlab.campaign.stop import RunStoppedError, StopRequest
from tronlab.dataset.records import DriftRecord, ShotRecord
from tronlab.devices.registry import connected
from tronlab.errors import (
    CalibrationError,
    DatasetError,
    DeviceFaultError,
    LimitError,
    TrackingLostError,
)
from tronlab.planning.shots import Plan

ONE_SHOT = [
    *["read_room", "move"],
    *["read_room", "look", "look"],
    *["read_room", "measure"],
    *["read_room", "grab"],
    *["read_room", "look"],
    *["read_room", "read_robot", "read_room"],
]
LOOKS_AT_THE_ROOM = ONE_SHOT.count("read_room")


def lost() -> TrackingLostError:
    return TrackingLostError("measure_pose: beam broken", device="tracker")


def course_of(taker: ShotTaker, plan: Plan, session: RecordedSession) -> Course:
    return Course(
        plan,
        taker,
        commit=session.commit,
        drift=None,
        stop=StopRequest(),
        listener=RunListener(),
        free_bytes=None,
        n_spare_rows=None,
    )


def test_steps_run_in_order(session: RecordedSession, laboratory: Any) -> None:
    outcome = session.run()
    assert laboratory.log == ONE_SHOT * 4
    assert session.ids == [1, 2, 3, 4]
    assert (outcome.skipped, session.replaced, session.told) == ({}, [], [])


def test_every_image_belongs_to_its_shot_also_after_retries(
    session: RecordedSession, laboratory: Any
) -> None:
    laboratory.failures = {("grab", 1): lost(), ("measure", 3): lost(), ("read_room", 24): lost()}
    session.run()
    assert session.attempts == [2, 2, 2, 1]
    for record in session.records:
        assert (record.frame.image == 10 * record.shot_id).all()
        assert record.tracker.trk_from_tmac.translation[2] == 10.0 * record.shot_id
        assert record.robot.rail_m == 10.0 * record.shot_id
        assert sum(record.n_failures.values()) == record.attempt - 1


@pytest.mark.parametrize(
    ("call", "error"),
    [
        ("move", LimitError("too far", device="robot")),
        ("look", DeviceFaultError("laser off", device="tracker", code=7)),
        ("measure", ZeroDivisionError("a mistake of ours")),
        ("grab", LimitError("too long", device="camera")),
        ("read_robot", DeviceFaultError("drive off", device="robot", code=7)),
        ("read_room", ZeroDivisionError("a mistake of ours")),
    ],
)
def test_other_errors_end_the_run_as_they_are(
    session: RecordedSession,
    laboratory: Any,
    call: str,
    error: Exception,
    capfd: pytest.CaptureFixture[str],
) -> None:
    n_of_shot_2 = {"look": 4, "read_room": 1 + LOOKS_AT_THE_ROOM}.get(call, 2)
    laboratory.failures = {(call, n_of_shot_2): error}
    with pytest.raises(type(error)) as caught:
        session.run()
    assert caught.value is error
    assert session.ids == [1]
    assert capfd.readouterr().err == ""


def test_robot_is_stopped_only_if_its_move_failed(
    session: RecordedSession, laboratory: Any
) -> None:
    laboratory.failures = {("grab", 2): lost(), ("move", 4): LimitError("no", device="robot")}
    with pytest.raises(LimitError):
        session.run()
    assert laboratory.log.count("stop") == 1
    assert laboratory.log[-1] == "stop"


def test_write_error_ends_the_run(session: RecordedSession, laboratory: Any) -> None:
    def commit(record: ShotRecord, replaces: bool) -> None:
        if record.shot_id == 2:
            raise DatasetError("disk full")

    with pytest.raises(DatasetError, match="disk full"):
        session.run(commit=commit)
    assert laboratory.log == ONE_SHOT * 2


def test_listener_hears_of_a_shot_after_it_was_committed(session: RecordedSession) -> None:
    events: list[tuple[str, int]] = []
    session.run(
        commit=lambda record, replaces: events.append(("commit", record.shot_id)),
        listener=RunListener(on_shot=lambda record: events.append(("told", record.shot_id))),
    )
    assert events[:4] == [("commit", 1), ("told", 1), ("commit", 2), ("told", 2)]


def test_stop_finishes_the_shot_in_hand(session: RecordedSession, laboratory: Any) -> None:
    stop = StopRequest()

    def ask_once(call: str) -> None:
        if call == "grab" and laboratory.log.count("grab") == 2:
            stop.ask()

    laboratory.on_call = ask_once
    with pytest.raises(RunStoppedError):
        session.run(stop=stop)
    assert session.ids == [1, 2]
    assert laboratory.log == ONE_SHOT * 2


def test_a_run_that_is_stopped_in_its_last_shot_is_complete(
    session: RecordedSession, laboratory: Any
) -> None:
    stop = StopRequest()
    laboratory.on_call = lambda call: (
        stop.ask() if call == "grab" and laboratory.log.count("grab") == 4 else None
    )
    session.run(stop=stop)
    assert session.ids == [1, 2, 3, 4]


def test_stop_at_once_stops_the_robot_before_anything_else(
    session: RecordedSession, laboratory: Any
) -> None:
    """A robot moves until it is told to stop, and is told while ``move`` still hangs."""
    stop = StopRequest()
    is_stopped = threading.Event()

    def hang_in_second_move(call: str) -> None:
        if call == "stop":
            is_stopped.set()
        if call == "move" and laboratory.log.count("move") == 2:
            stop.ask()
            stop.ask()
            assert is_stopped.wait(timeout=10)

    laboratory.on_call = hang_in_second_move
    with connected(session.taker.devices), pytest.raises(RunStoppedError):
        session.run(stop=stop)
    assert session.ids == [1]
    after_move = laboratory.log[laboratory.log.index("stop") - 1 :]
    assert after_move[:2] == ["move", "stop"]
    assert all(call == "stop" or call.startswith("close ") for call in after_move[2:])
    assert "close robot" in after_move


def test_a_hung_device_does_not_hold_up_a_stop_at_once(
    session: RecordedSession, laboratory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(steps, "_PATIENCE_S", 0.05)
    stop = StopRequest()
    is_over = threading.Event()

    def hang(call: str) -> None:
        if call == "grab":
            stop.ask()
            stop.ask()
            is_over.wait(timeout=60)

    laboratory.on_call = hang
    with connected(session.taker.devices), pytest.raises(RunStoppedError):
        session.run(stop=stop)
    is_over.set()
    log = laboratory.log
    assert log[log.index("grab") + 1] == "stop"
    assert log.index("stop") < log.index("close robot")


def test_a_robot_that_does_not_end_its_move_is_stopped_again_before_it_is_closed(
    session: RecordedSession, laboratory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(steps, "_PATIENCE_S", 0.05)
    stop, is_stopped_thrice = StopRequest(), threading.Event()

    def begin_late(call: str) -> None:
        if call == "stop" and laboratory.log.count("stop") == 3:
            is_stopped_thrice.set()
        if call == "move":
            stop.ask()
            stop.ask()
            is_stopped_thrice.wait(timeout=10)

    laboratory.on_call = begin_late
    with pytest.raises(RunStoppedError):
        session.run(stop=stop)
    assert is_stopped_thrice.is_set()


def test_no_step_begins_after_a_stop_at_once(session: RecordedSession) -> None:
    stop = StopRequest()
    stop.ask()
    stop.ask()
    done: list[str] = []
    with Worker(stop) as worker:
        status = worker.start("move", lambda: done.append("moved"))
    assert (status.success, done) == (False, [])
    assert isinstance(status.exception(), RunStoppedError)


def test_stop_asked_before_the_start_takes_nothing(
    session: RecordedSession, laboratory: Any
) -> None:
    stop = StopRequest()
    stop.ask()
    with pytest.raises(RunStoppedError):
        session.run(stop=stop)
    assert laboratory.log == []


def test_runs_leave_no_thread_behind(session: RecordedSession) -> None:
    before = set(threading.enumerate())
    session.run()
    assert {t for t in set(threading.enumerate()) - before if t.is_alive()} == set()


CHECK = ["read_room", *["point"] * 3]


def checks_every(n: int | None, into: list[DriftRecord]) -> DriftChecks:
    return DriftChecks(every_n_shots=n, commit=lambda check, _is_last: into.append(check))


@pytest.mark.parametrize(
    ("every", "expected"), [(2, [2, 4]), (3, [3, 4]), (1, [1, 2, 3, 4]), (9, [4]), (None, [4])]
)
def test_drift_is_checked_between_shots_and_at_the_end(
    session: RecordedSession, laboratory: Any, every: int | None, expected: list[int]
) -> None:
    checks: list[DriftRecord] = []
    session.run(drift=checks_every(every, checks))
    assert [check.n_shots_before for check in checks] == expected
    after = [CHECK if n in expected else [] for n in (1, 2, 3, 4)]
    assert laboratory.log == [call for check in after for call in (*ONE_SHOT, *check)]
    assert n_checks(4, DriftConfig(every_n_shots=every)) == 1 + len(expected)


def test_a_check_has_the_same_retries_as_a_shot(session: RecordedSession, laboratory: Any) -> None:
    laboratory.failures = {("point", 2): lost()}
    checks: list[DriftRecord] = []
    session.run(drift=checks_every(2, checks))
    assert session.told == ["retry drift check after 2 shots, attempt 1: TrackingLostError"]
    assert [check.n_shots_before for check in checks] == [2, 4]
    assert laboratory.log.count("move") == 4


def test_a_check_is_never_skipped(session: RecordedSession, laboratory: Any) -> None:
    session.configure(suspend={"timeout_s": 20.0})
    laboratory.failures = {("point", k): lost() for k in range(1, 100)}
    with pytest.raises(TrackingLostError):
        session.run(drift=checks_every(2, []))
    assert session.ids == [1, 2]
    assert session.taker.in_hand.startswith("drift check after 2 shots, attempt ")


def test_whoever_stores_a_check_may_end_the_run(session: RecordedSession) -> None:
    def refuse(check: DriftRecord, _is_last: bool) -> None:
        raise CalibrationError(f"moved after {check.n_shots_before}")

    with pytest.raises(CalibrationError, match="moved after 2"):
        session.run(drift=DriftChecks(2, refuse))
    assert session.ids == [1, 2]


@pytest.mark.parametrize(
    ("n_points_before", "n_moves", "n_asked", "expected"),
    [(3, 2, 1, [1, 2]), (3, 2, 2, [1]), (1, 1, 1, [1])],
    ids=["in a shot", "in a shot, at once", "in a check"],
)
def test_a_stopped_run_checks_its_last_shots_unless_stopped_at_once(
    session: RecordedSession,
    laboratory: Any,
    n_points_before: int,
    n_moves: int,
    n_asked: int,
    expected: list[int],
) -> None:
    stop = StopRequest()

    def ask(call: str) -> None:
        counts = laboratory.log.count("point"), laboratory.log.count("move")
        if counts == (n_points_before, n_moves) and call in {"move", "point"}:
            for _ in range(n_asked):
                stop.ask()

    laboratory.on_call = ask
    checks: list[DriftRecord] = []
    with pytest.raises(RunStoppedError):
        session.run(drift=checks_every(1, checks), stop=stop)
    assert [check.n_shots_before for check in checks] == expected


def test_a_last_check_that_fails_does_not_hide_the_stop(
    session: RecordedSession, laboratory: Any
) -> None:
    stop = StopRequest()
    laboratory.failures = {("point", 1): lost()}
    laboratory.on_call = lambda call: stop.ask() if call == "grab" else None
    with pytest.raises(RunStoppedError):
        session.run(drift=checks_every(None, []), stop=stop)
    assert laboratory.log == [*ONE_SHOT, "read_room", "point"]


def test_replayed_event_commits_its_shot_once(
    taker: ShotTaker, plan: Plan, session: RecordedSession
) -> None:
    """A pause of bluesky's own may replay the messages of a shot whose event was emitted."""
    course = course_of(taker, plan, session)
    shot = course.schedule.begin_next()
    for _ in range(2):
        taker.begin(shot, 1)
        for step in (taker.move, taker.settle, taker.measure, taker.grab, taker.confirm):
            step()
        for step in (taker.read, course.judge, course.post_shot):
            step()
        course.take_document("event", {"data": {"shot_id": 1, "attempt": 1}})
    assert session.ids == [1]


def test_documents_hold_numbers_only(
    taker: ShotTaker, plan: Plan, session: RecordedSession
) -> None:
    documents: list[tuple[str, dict[str, Any]]] = []
    course = course_of(taker, plan, session)
    with engine._hired(course, None) as crew, engine._engine() as run_engine:
        run_engine.subscribe(course.take_document)
        run_engine.subscribe(lambda name, document: documents.append((name, document)))
        run_engine(engine._campaign(plan, crew))
    assert [name for name, _ in documents].count("event") == 4
    start = documents[0][1]
    assert (start["plan_sha256"], start["n_shots"]) == (plan.sha256, 4)
    for name, document in documents:
        if name == "event":
            assert {"shot_id", "attempt", "range_los_m", "mean_grey"} <= set(document["data"])
            assert all(isinstance(value, int | float) for value in document["data"].values())


def test_status_tells_what_it_is() -> None:
    status = Status("camera")
    assert repr(status) == "camera: pending"
    status.finish(TrackingLostError("beam broken", device="tracker"))
    status.finish()
    assert repr(status) == "camera: TrackingLostError('tracker: beam broken')"
    assert not status.success
    heard: list[object] = []
    status.add_callback(heard.append)
    assert heard == [status]
