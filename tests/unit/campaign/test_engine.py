# pyright: reportPrivateUsage=false
import threading
from typing import Any

import pytest

from tronlab.campaign import engine
from tronlab.campaign.config import DriftConfig
from tronlab.campaign.drift import DriftChecks, n_checks
from tronlab.campaign.engine import RunListener, run_shots
from tronlab.campaign.policy import MAX_ATTEMPTS
from tronlab.campaign.shot import ShotTaker
from tronlab.campaign.steps import Status
from tronlab.campaign.stop import RunStoppedError, StopRequest
from tronlab.dataset.records import DriftRecord, ShotRecord
from tronlab.devices.readings import AirReading
from tronlab.errors import (
    CalibrationError,
    DatasetError,
    DeviceFaultError,
    DeviceTimeoutError,
    LimitError,
    NotConnectedError,
    NotSettledError,
    SafetyError,
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
    "read_room",
]
LOOKS_AT_THE_ROOM = ONE_SHOT.count("read_room")


def lost() -> TrackingLostError:
    return TrackingLostError("measure_pose: beam broken", device="tracker")


def test_steps_run_in_order(taker: ShotTaker, plan: Plan, laboratory: Any) -> None:
    records: list[ShotRecord] = []
    run_shots(plan, taker, commit=records.append)
    assert laboratory.log == ONE_SHOT * 4
    assert [record.shot_id for record in records] == [1, 2, 3, 4]


def test_every_image_belongs_to_its_shot_also_after_retries(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    laboratory.failures = {("grab", 1): lost(), ("measure", 3): lost(), ("read_room", 30): lost()}
    records: list[ShotRecord] = []
    run_shots(plan, taker, commit=records.append)
    assert [record.attempt for record in records] == [2, 2, 2, 1]
    for record in records:
        assert (record.frame.image == 10 * record.shot_id).all()
        assert record.tracker.trk_from_tmac.translation[2] == 10.0 * record.shot_id
        assert record.robot.rail_m == 10.0 * record.shot_id


@pytest.mark.parametrize("error", [lost(), NotSettledError("still moves", device="tracker")])
def test_retryable_errors_are_told_and_tried_again(
    taker: ShotTaker, plan: Plan, laboratory: Any, error: Exception
) -> None:
    laboratory.failures = {("measure", 1): error, ("measure", 2): error}
    records: list[ShotRecord] = []
    told: list[tuple[str, int, Exception]] = []

    def on_retry(task: str, attempt: int, reason: Exception) -> None:
        told.append((task, attempt, reason))

    run_shots(plan, taker, commit=records.append, listener=RunListener(on_retry=on_retry))
    assert told == [("shot 1", 1, error), ("shot 1", 2, error)]
    assert [record.attempt for record in records] == [3, 1, 1, 1]


def test_a_door_opened_during_a_shot_suspends_the_run_and_the_shot_is_taken_again(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    laboratory.doors = [True] * (1 + LOOKS_AT_THE_ROOM) + [False] * 3
    records: list[ShotRecord] = []
    told: list[str] = []
    listener = RunListener(
        on_wait=lambda task, error: told.append(f"wait {task}: {error}"),
        on_resume=lambda task: told.append(f"resume {task}"),
    )
    run_shots(plan, taker, commit=records.append, listener=listener)
    assert told == ["wait shot 2: room: the door is open; close it", "resume shot 2"]
    assert [record.shot_id for record in records] == [1, 2, 3, 4]
    assert [record.attempt for record in records] == [1, 2, 1, 1]
    assert laboratory.log.count("move") == 5


def test_a_door_opened_again_is_another_wait_and_another_attempt(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    laboratory.doors = [True, True, False, False, True, True, True, False]
    records: list[ShotRecord] = []
    told: list[str] = []
    listener = RunListener(
        on_wait=lambda task, _error: told.append(f"wait {task}: {taker.in_hand}"),
        on_resume=lambda task: told.append(f"resume {task}"),
    )
    run_shots(plan, taker, commit=records.append, listener=listener)
    assert told == [
        "wait shot 1: shot 1, attempt 1",
        "wait shot 1: shot 1, attempt 2",
        "resume shot 1",
    ]
    assert [record.attempt for record in records] == [3, 1, 1, 1]


def test_the_time_to_wait_begins_anew_with_every_wait(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    room = taker.config.room.model_copy(update={"timeout_s": 1.0})
    taker.config = taker.config.model_copy(update={"room": room})
    laboratory.doors = 5 * [True, True, False, False]
    records: list[ShotRecord] = []
    run_shots(plan, taker, commit=records.append)
    assert [record.attempt for record in records] == [6, 1, 1, 1]
    assert taker.monotonic_s() > 5 * room.timeout_s / 2


def test_nothing_moves_while_the_door_is_open(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    laboratory.doors = [False] * 10**6
    room = taker.config.room.model_copy(update={"timeout_s": 20.0})
    taker.config = taker.config.model_copy(update={"room": room})
    with pytest.raises(SafetyError, match="room: the door is open"):
        run_shots(plan, taker, commit=lambda record: None)
    assert set(laboratory.log) == {"read_room"}
    assert taker.monotonic_s() > taker.config.room.timeout_s


def test_a_waiting_run_can_be_stopped(taker: ShotTaker, plan: Plan, laboratory: Any) -> None:
    laboratory.doors = [False] * 10**6
    stop = StopRequest()
    laboratory.on_call = lambda call: stop.ask() if len(laboratory.log) == 5 else None
    with pytest.raises(RunStoppedError):
        run_shots(plan, taker, commit=lambda record: None, stop=stop)


def test_a_campaign_may_allow_an_open_door(taker: ShotTaker, plan: Plan, laboratory: Any) -> None:
    laboratory.doors = [False] * 10**6
    room = taker.config.room.model_copy(update={"needs_closed_door": False})
    taker.config = taker.config.model_copy(update={"room": room})
    run_shots(plan, taker, commit=lambda record: None)
    assert laboratory.log == ONE_SHOT * 4


@pytest.mark.parametrize(
    ("call", "device", "extra"),
    [("grab", "camera", ["configure"]), ("measure", "tracker", []), ("read_room", "room", [])],
)
@pytest.mark.parametrize("kind", [NotConnectedError, DeviceTimeoutError])
def test_a_lost_device_is_connected_again_and_its_shot_taken_again(
    taker: ShotTaker,
    plan: Plan,
    laboratory: Any,
    call: str,
    device: str,
    extra: list[str],
    kind: type[Exception],
) -> None:
    laboratory.failures = {(call, 1): kind("gone", device=device)}
    records: list[ShotRecord] = []
    run_shots(plan, taker, commit=records.append)
    assert [record.attempt for record in records] == [2, 1, 1, 1]
    at = laboratory.log.index(f"close {device}")
    assert laboratory.log[at : at + 2 + len(extra)] == [
        f"close {device}",
        f"connect {device}",
        *extra,
    ]


def test_the_state_of_simulated_devices_connects_by_itself(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    laboratory.failures = {("look", 1): NotConnectedError("gone", device="simulated world")}
    records: list[ShotRecord] = []
    run_shots(plan, taker, commit=records.append)
    assert [record.attempt for record in records] == [2, 1, 1, 1]
    assert not any(call.startswith("connect") for call in laboratory.log)


def test_a_device_that_stays_away_ends_the_run(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    gone = NotConnectedError("gone", device="camera")
    laboratory.failures = {("grab", i): gone for i in range(1, 9)}
    laboratory.failures |= {("connect camera", i): gone for i in range(1, 9)}
    with pytest.raises(NotConnectedError, match="camera: gone"):
        run_shots(plan, taker, commit=lambda record: None)
    assert laboratory.log.count("connect camera") == MAX_ATTEMPTS - 1


@pytest.mark.parametrize("kind", [NotConnectedError, DeviceTimeoutError])
def test_a_lost_robot_stops_the_run(
    taker: ShotTaker, plan: Plan, laboratory: Any, kind: type[Exception]
) -> None:
    laboratory.failures = {("move", 2): kind("gone", device="robot")}
    with pytest.raises(kind, match="robot: gone"):
        run_shots(plan, taker, commit=lambda record: None)
    assert "connect robot" not in laboratory.log


def test_air_that_tracker_and_room_disagree_about_is_told_once(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    laboratory.air = AirReading(temperature_k=294.5, pressure_pa=1e5, relative_humidity=0.4)
    told: list[str] = []
    taker.warn = told.append
    run_shots(plan, taker, commit=lambda record: None)
    assert len(told) == 1
    assert "shot 1, attempt 1: the tracker's air and the room's differ by 1.50 K" in told[0]


def test_gives_up_after_the_last_attempt(taker: ShotTaker, plan: Plan, laboratory: Any) -> None:
    laboratory.failures = {("measure", i): lost() for i in range(2, 2 + MAX_ATTEMPTS)}
    records: list[ShotRecord] = []
    with pytest.raises(TrackingLostError, match="beam broken"):
        run_shots(plan, taker, commit=records.append)
    assert [record.shot_id for record in records] == [1]
    assert laboratory.log.count("move") == 1 + MAX_ATTEMPTS


@pytest.mark.parametrize("call", ["move", "look", "measure", "grab", "read_robot", "read_room"])
@pytest.mark.parametrize(
    "error",
    [
        DeviceFaultError("drive off", device="robot", code=7),
        LimitError("too far", device="robot"),
        ZeroDivisionError("a mistake of ours"),
    ],
    ids=["fault", "limit", "bug"],
)
def test_other_errors_end_the_run_as_they_are(
    taker: ShotTaker,
    plan: Plan,
    laboratory: Any,
    call: str,
    error: Exception,
    capfd: pytest.CaptureFixture[str],
) -> None:
    n_of_shot_2 = {"look": 4, "read_room": 1 + LOOKS_AT_THE_ROOM}.get(call, 2)
    laboratory.failures = {(call, n_of_shot_2): error}
    records: list[ShotRecord] = []
    with pytest.raises(type(error)) as caught:
        run_shots(plan, taker, commit=records.append)
    assert caught.value is error
    assert [record.shot_id for record in records] == [1]
    assert capfd.readouterr().err == ""


def test_robot_is_stopped_only_if_its_move_failed(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    laboratory.failures = {("grab", 2): lost(), ("move", 4): LimitError("no", device="robot")}
    with pytest.raises(LimitError):
        run_shots(plan, taker, commit=lambda record: None)
    assert laboratory.log.count("stop") == 1
    assert laboratory.log[-1] == "stop"


def test_write_error_ends_the_run(taker: ShotTaker, plan: Plan, laboratory: Any) -> None:
    def commit(record: ShotRecord) -> None:
        if record.shot_id == 2:
            raise DatasetError("disk full")

    with pytest.raises(DatasetError, match="disk full"):
        run_shots(plan, taker, commit=commit)
    assert laboratory.log == ONE_SHOT * 2


def test_listener_hears_of_a_shot_after_it_was_committed(taker: ShotTaker, plan: Plan) -> None:
    events: list[tuple[str, int]] = []
    run_shots(
        plan,
        taker,
        commit=lambda record: events.append(("commit", record.shot_id)),
        listener=RunListener(on_shot=lambda record: events.append(("told", record.shot_id))),
    )
    assert events[:4] == [("commit", 1), ("told", 1), ("commit", 2), ("told", 2)]


def test_stop_finishes_the_shot_in_hand(taker: ShotTaker, plan: Plan, laboratory: Any) -> None:
    stop = StopRequest()

    def ask_once(call: str) -> None:
        if call == "grab" and laboratory.log.count("grab") == 2:
            stop.ask()

    laboratory.on_call = ask_once
    records: list[ShotRecord] = []
    with pytest.raises(RunStoppedError):
        run_shots(plan, taker, commit=records.append, stop=stop)
    assert [record.shot_id for record in records] == [1, 2]
    assert laboratory.log == ONE_SHOT * 2


def test_stop_at_once_waits_for_nothing_and_stops_the_robot(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    stop = StopRequest()
    is_stopped = threading.Event()

    def hang_in_second_move(call: str) -> None:
        if call == "stop":
            is_stopped.set()
        if call == "move" and laboratory.log.count("move") == 2:
            stop.ask()
            stop.ask()
            assert is_stopped.wait(timeout=10)  # a robot moves until it is told to stop

    laboratory.on_call = hang_in_second_move
    records: list[ShotRecord] = []
    with pytest.raises(RunStoppedError):
        run_shots(plan, taker, commit=records.append, stop=stop)
    assert [record.shot_id for record in records] == [1]
    assert is_stopped.is_set()


def test_stop_asked_before_the_start_takes_nothing(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    stop = StopRequest()
    stop.ask()
    with pytest.raises(RunStoppedError):
        run_shots(plan, taker, commit=lambda record: None, stop=stop)
    assert laboratory.log == []


def test_runs_leave_no_thread_behind(taker: ShotTaker, plan: Plan) -> None:
    before = set(threading.enumerate())
    run_shots(plan, taker, commit=lambda record: None)
    assert {t for t in set(threading.enumerate()) - before if t.is_alive()} == set()


CHECK = ["read_room", *["point"] * 3]


def checks_every(n: int | None, into: list[DriftRecord]) -> DriftChecks:
    return DriftChecks(every_n_shots=n, commit=into.append)


@pytest.mark.parametrize(
    ("every", "expected"), [(2, [2, 4]), (3, [3, 4]), (1, [1, 2, 3, 4]), (9, [4]), (None, [4])]
)
def test_drift_is_checked_between_shots_and_at_the_end(
    taker: ShotTaker, plan: Plan, laboratory: Any, every: int | None, expected: list[int]
) -> None:
    checks: list[DriftRecord] = []
    run_shots(plan, taker, commit=lambda record: None, drift=checks_every(every, checks))
    assert [check.n_shots_before for check in checks] == expected
    after = [CHECK if n in expected else [] for n in (1, 2, 3, 4)]
    assert laboratory.log == [call for check in after for call in (*ONE_SHOT, *check)]
    assert n_checks(4, DriftConfig(every_n_shots=every)) == 1 + len(expected)


def test_a_check_has_the_same_retries_as_a_shot(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    laboratory.failures = {("point", 2): lost()}
    checks: list[DriftRecord] = []
    told: list[tuple[str, int]] = []
    run_shots(
        plan,
        taker,
        commit=lambda record: None,
        drift=checks_every(2, checks),
        listener=RunListener(on_retry=lambda task, attempt, error: told.append((task, attempt))),
    )
    assert told == [("drift check after 2 shots", 1)]
    assert [check.n_shots_before for check in checks] == [2, 4]
    assert laboratory.log.count("move") == 4


def test_a_check_that_never_succeeds_ends_the_run(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    laboratory.failures = {("point", k): lost() for k in range(1, 1 + MAX_ATTEMPTS)}
    with pytest.raises(TrackingLostError):
        run_shots(plan, taker, commit=lambda record: None, drift=checks_every(2, []))
    assert taker.in_hand == f"drift check after 2 shots, attempt {MAX_ATTEMPTS}"


def test_whoever_stores_a_check_may_end_the_run(taker: ShotTaker, plan: Plan) -> None:
    def refuse(check: DriftRecord) -> None:
        raise CalibrationError(f"moved after {check.n_shots_before}")

    records: list[ShotRecord] = []
    with pytest.raises(CalibrationError, match="moved after 2"):
        run_shots(plan, taker, commit=records.append, drift=DriftChecks(2, refuse))
    assert [record.shot_id for record in records] == [1, 2]


@pytest.mark.parametrize(
    ("n_points_before", "n_moves", "n_asked", "expected"),
    [(3, 2, 1, [1, 2]), (3, 2, 2, [1]), (1, 1, 1, [1])],
    ids=["in a shot", "in a shot, at once", "in a check"],
)
def test_a_stopped_run_checks_its_last_shots_unless_stopped_at_once(
    taker: ShotTaker,
    plan: Plan,
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
        run_shots(plan, taker, commit=lambda record: None, drift=checks_every(1, checks), stop=stop)
    assert [check.n_shots_before for check in checks] == expected


def test_a_last_check_that_fails_does_not_hide_the_stop(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    stop = StopRequest()
    laboratory.failures = {("point", 1): lost()}
    laboratory.on_call = lambda call: stop.ask() if call == "grab" else None
    with pytest.raises(RunStoppedError):
        run_shots(plan, taker, commit=lambda record: None, drift=checks_every(None, []), stop=stop)
    assert laboratory.log == [*ONE_SHOT, "read_room", "point"]


def test_replayed_event_commits_its_shot_once(taker: ShotTaker, plan: Plan) -> None:
    """An immediate pause may replay the messages of a shot whose event was already emitted."""
    records: list[ShotRecord] = []
    run = engine._Run(
        taker, commit=records.append, drift=None, stop=StopRequest(), listener=RunListener()
    )
    for _ in range(2):
        taker.begin(plan.shots[0], 1)
        for step in (taker.move, taker.measure, taker.grab, taker.read):
            step()
        engine._post_shot(run)
        run.take_document("event", {"data": {"shot_id": 1, "attempt": 1}})
    assert [record.shot_id for record in records] == [1]
    assert run.shots == {}


def test_documents_hold_numbers_only(taker: ShotTaker, plan: Plan) -> None:
    documents: list[tuple[str, dict[str, Any]]] = []
    run = engine._Run(
        taker, commit=lambda record: None, drift=None, stop=StopRequest(), listener=RunListener()
    )
    with engine._engine() as run_engine:
        run_engine.subscribe(lambda name, document: documents.append((name, document)))
        run_engine(engine._campaign(plan, run))
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
