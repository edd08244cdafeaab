"""What a run does when something goes wrong: try again, skip, wait and go on by itself."""

from typing import Any

import numpy as np
import pytest
from recorded_session import RecordedSession

from tronlab.campaign.drift import DriftChecks
from tronlab.campaign.policy import DiskNearlyFullError
from tronlab.campaign.stop import RunStoppedError, StopRequest
from tronlab.dataset.records import DriftRecord, ErrorClass
from tronlab.errors import (
    DatasetError,
    DeviceError,
    DeviceTimeoutError,
    IncompleteFrameError,
    NotConnectedError,
    NotReadyError,
    NotSettledError,
    QualityError,
    SafetyError,
    TrackingLostError,
)

LOOKS_AT_THE_ROOM = 7
"""Of one shot."""
EVER = 10**5

BEAM = TrackingLostError("beam broken", device="tracker")
OPEN = "waiting before shot {}: room: the door is open; close it; the run goes on by itself"


def fails(call: str, error: Exception, *, at: int, times: int) -> dict[Any, Exception]:
    return {(call, n): error for n in range(at, at + times)}


def patience(session: RecordedSession, timeout_s: float, **changes: Any) -> None:
    """Let the campaign wait only so long."""
    session.configure(suspend={"timeout_s": timeout_s, **changes})


RETRYABLE: list[tuple[str, DeviceError, ErrorClass]] = [
    ("measure", BEAM, "tracking_lost"),
    ("look", NotSettledError("moves", device="tracker"), "not_settled"),
    ("grab", IncompleteFrameError("packets lost", device="camera"), "incomplete_frame"),
    ("move", NotReadyError("busy", device="robot", code=3), "not_ready"),
    ("grab", NotConnectedError("gone", device="camera"), "lost_connection"),
    ("measure", DeviceTimeoutError("silent", device="tracker"), "lost_connection"),
    ("read_robot", QualityError("blur", device="camera"), "quality"),
]


@pytest.mark.parametrize(("call", "error", "kind"), RETRYABLE)
def test_every_class_is_tried_again_told_and_counted_in_the_data(
    session: RecordedSession, laboratory: Any, call: str, error: DeviceError, kind: ErrorClass
) -> None:
    laboratory.failures = {(call, 1): error}
    session.run()
    assert session.told == [f"retry shot 1, attempt 1: {type(error).__name__}"]
    assert session.attempts == [2, 1, 1, 1]
    assert [dict(record.n_failures) for record in session.records] == [{kind: 1}, {}, {}, {}]


@pytest.mark.parametrize(("call", "error", "kind"), RETRYABLE[3:6])
def test_a_device_that_stays_away_ends_the_run(
    session: RecordedSession, laboratory: Any, call: str, error: DeviceError, kind: ErrorClass
) -> None:
    session.configure(retry={kind: {"max_attempts": 2}})
    laboratory.failures = fails(call, error, at=2, times=2)
    with pytest.raises(type(error)):
        session.run()
    assert not any(line.startswith("skip") for line in session.told)


@pytest.mark.parametrize(("call", "error", "kind"), RETRYABLE[1:3])
def test_when_attempts_are_used_up_the_shot_is_skipped(
    session: RecordedSession, laboratory: Any, call: str, error: DeviceError, kind: ErrorClass
) -> None:
    session.configure(retry={kind: {"max_attempts": 2, "pauses_s": (30.0,)}})
    laboratory.failures = fails(call, error, at=1, times=2)
    outcome = session.run()
    why = f"{error} (2 attempts)"
    assert session.told == [
        f"retry shot 1, attempt 1: {type(error).__name__}",
        f"skip 1: {why}",
    ]
    assert outcome.skipped == {1: why}
    assert session.ids == [2, 3, 4]
    assert session.taker.clock.monotonic_s >= 30.0


def test_a_campaign_may_want_to_stop_instead(session: RecordedSession, laboratory: Any) -> None:
    session.configure(retry={"on_failure": "stop"})
    laboratory.failures = fails(
        "grab", IncompleteFrameError("lost", device="camera"), at=2, times=3
    )
    with pytest.raises(IncompleteFrameError):
        session.run()
    assert session.ids == [1]


@pytest.mark.parametrize(("n_bad", "is_over"), [(2, False), (3, True)])
def test_too_many_skipped_in_a_row_end_the_run(
    session: RecordedSession, laboratory: Any, n_bad: int, is_over: bool
) -> None:
    session.configure(retry={"max_skipped_in_row": 2})
    lost = IncompleteFrameError("packets lost", device="camera")
    laboratory.failures = fails("grab", lost, at=1, times=3 * n_bad)
    if is_over:
        with pytest.raises(IncompleteFrameError, match="packets lost"):
            session.run()
        assert session.ids == []
    else:
        assert set(session.run().skipped) == {1, 2}
        assert session.ids == [3, 4]
    assert [line[:6] for line in session.told if line.startswith("skip")] == ["skip 1", "skip 2"]


@pytest.mark.parametrize(
    ("call", "device", "extra"),
    [("grab", "camera", ["configure"]), ("measure", "tracker", []), ("read_room", "room", [])],
)
def test_a_lost_device_is_connected_again_and_made_ready(
    session: RecordedSession, laboratory: Any, call: str, device: str, extra: list[str]
) -> None:
    laboratory.failures = {(call, 1): NotConnectedError("gone", device=device)}
    session.run()
    at = laboratory.log.index(f"close {device}")
    expected = [f"close {device}", f"connect {device}", *extra, "read_room"]
    assert laboratory.log[at : at + len(expected)] == expected
    assert laboratory.log.count(f"connect {device}") == 1


def test_the_state_of_simulated_devices_connects_by_itself(
    session: RecordedSession, laboratory: Any
) -> None:
    laboratory.failures = {("look", 1): NotConnectedError("gone", device="simulated world")}
    session.run()
    assert session.attempts == [2, 1, 1, 1]
    assert not any(call.startswith("connect") for call in laboratory.log)


@pytest.mark.parametrize("kind", [NotConnectedError, DeviceTimeoutError])
def test_the_robot_is_never_connected_again_by_itself(
    session: RecordedSession, laboratory: Any, kind: type[DeviceError]
) -> None:
    laboratory.failures = {("move", 2): kind("lost", device="robot")}
    with pytest.raises(kind):
        session.run()
    assert "connect robot" not in laboratory.log
    assert session.ids == [1]


def test_a_door_opened_during_a_shot_suspends_the_run_and_the_shot_is_taken_again(
    session: RecordedSession, laboratory: Any
) -> None:
    laboratory.doors = [True] * (1 + LOOKS_AT_THE_ROOM) + [False] * 3
    session.run()
    assert session.told == [f"suspend: {OPEN.format(2)}",
                            "resume unsafe"]  # fmt: skip
    assert session.ids == [1, 2, 3, 4]
    assert session.attempts == [1, 2, 1, 1]
    assert session.records[1].n_failures == {"unsafe": 1}
    assert laboratory.log.count("move") == 5


def test_a_door_opened_again_is_another_suspension_with_all_its_time(
    session: RecordedSession, laboratory: Any
) -> None:
    patience(session, 1.0)
    laboratory.doors = 5 * [True, True, False, False]
    session.run()
    assert session.attempts == [6, 1, 1, 1]
    assert [line.split()[0] for line in session.told] == 5 * ["suspend:", "resume"]
    assert session.taker.clock.monotonic_s > 2.0


def test_nothing_moves_while_the_door_is_open(session: RecordedSession, laboratory: Any) -> None:
    patience(session, 20.0)
    laboratory.doors = [False] * EVER
    with pytest.raises(SafetyError, match="room: the door is open"):
        session.run()
    assert set(laboratory.log) == {"read_room"}
    assert session.taker.clock.monotonic_s == pytest.approx(20.0)
    assert len(session.told) == 1


def test_a_campaign_may_allow_an_open_door(session: RecordedSession, laboratory: Any) -> None:
    laboratory.doors = [False] * EVER
    session.configure(room={"needs_closed_door": False})
    session.run()
    assert session.ids == [1, 2, 3, 4]


def test_an_emergency_stop_stops_the_robot_first_and_the_shot_begins_with_its_move(
    session: RecordedSession, laboratory: Any
) -> None:
    pressed = SafetyError("emergency stop", device="robot")
    laboratory.failures = fails("move", pressed, at=2, times=2)
    session.run()
    at = laboratory.log.index("stop")
    assert laboratory.log[at - 1 : at + 5] == [
        *["move", "stop"],
        *["read_room", "move", "stop"],
        "read_room",
    ]
    assert laboratory.log.count("stop") == 2
    assert session.attempts == [1, 2, 1, 1]
    assert session.told[0].startswith("suspend: waiting before shot 2: robot: emergency stop")


def test_a_robot_that_cannot_even_be_stopped_is_told_of(
    session: RecordedSession, laboratory: Any
) -> None:
    warnings: list[str] = []
    session.taker.warn = warnings.append
    laboratory.failures = {
        ("move", 1): DeviceTimeoutError("silent", device="robot"),
        ("stop", 1): NotConnectedError("stop: gone", device="robot"),
        ("stop", 2): NotConnectedError("stop: gone", device="robot"),
    }
    with pytest.raises(DeviceTimeoutError):
        session.run()
    assert warnings == [
        "robot: stop: gone; see whether the robot stands still, and press the emergency stop if not"
    ]


def test_a_lost_beam_is_waited_for_when_attempts_are_used_up(
    session: RecordedSession, laboratory: Any
) -> None:
    laboratory.failures = fails("measure", BEAM, at=2, times=12)
    outcome = session.run()
    assert outcome.skipped == {}
    assert session.told == [
        "retry shot 2, attempt 1: TrackingLostError",
        "retry shot 2, attempt 2: TrackingLostError",
        "suspend: waiting before shot 2: tracker: beam broken; the run goes on by itself",
        "resume beam",
    ]
    assert session.attempts == [1, 4, 1, 1]
    assert session.records[1].n_failures == {"tracking_lost": 3}


@pytest.mark.parametrize(("on_beam_lost", "duration_s"), [(True, 60.0), (False, 0.0)])
def test_a_beam_that_stays_away_costs_its_shot(
    session: RecordedSession, laboratory: Any, on_beam_lost: bool, duration_s: float
) -> None:
    patience(session, 60.0, on_beam_lost=on_beam_lost)
    session.configure(retry={"tracking_lost": {"max_attempts": 1, "pauses_s": (1.0,)}})
    n_looks = 1 if not on_beam_lost else 18  # 0.5 s, 0.75 s... 5 s, and one at the end
    laboratory.failures = fails("measure", BEAM, at=2, times=n_looks)
    outcome = session.run()
    assert set(outcome.skipped) == {2}
    assert session.ids == [1, 3, 4]
    assert session.taker.clock.monotonic_s >= duration_s


class Disk:
    """So many megabytes are free at each look, the last value ever after."""

    def __init__(self, *free_mb: float) -> None:
        self.free_mb = list(free_mb)

    def __call__(self) -> int:
        return int(1e6 * (self.free_mb.pop(0) if len(self.free_mb) > 1 else self.free_mb[0]))


def test_a_disk_that_is_nearly_full_suspends_the_run(
    session: RecordedSession, laboratory: Any
) -> None:
    session.run(free_bytes=Disk(1000, 199, 150, 100, 200))
    assert session.told == [
        "suspend: waiting before shot 2: only 199 MB are free on the disk of the dataset,"
        " suspend.min_free_mb is 200; make room; the run goes on by itself",
        "resume disk",
    ]
    assert session.attempts == [1, 1, 1, 1]
    assert laboratory.log.count("move") == 4


def test_a_disk_that_stays_full_ends_the_run(session: RecordedSession) -> None:
    patience(session, 30.0)
    with pytest.raises(DiskNearlyFullError, match="only 12 MB are free"):
        session.run(free_bytes=Disk(1000, 12))
    assert session.ids == [1]
    assert session.taker.clock.monotonic_s >= 30.0


def test_a_disk_nobody_can_ask_ends_the_run(session: RecordedSession) -> None:
    def refuse() -> int:
        raise PermissionError(13, "Permission denied")

    with pytest.raises(DatasetError, match=r"room left on the disk cannot be read: .*denied"):
        session.run(free_bytes=refuse)


def test_a_waiting_run_can_be_stopped_at_any_moment(
    session: RecordedSession, laboratory: Any
) -> None:
    """Also in the middle of a pause of ten minutes."""
    session.configure(retry={"not_settled": {"max_attempts": 2, "pauses_s": (600.0,)}})
    laboratory.failures = {("look", 1): NotSettledError("moves", device="tracker")}
    stop, clock = StopRequest(), session.taker.clock
    advance = clock.advance

    def ask_meanwhile(duration_s: float) -> None:
        advance(duration_s)
        if clock.monotonic_s > 100.0:
            stop.ask()

    clock.advance = ask_meanwhile  # type: ignore[method-assign]
    with pytest.raises(RunStoppedError):
        session.run(stop=stop)
    assert clock.monotonic_s == pytest.approx(100.0, abs=1.0)
    assert session.ids == []


def test_no_check_for_drift_is_lost_or_doubled_by_skipped_shots(
    session: RecordedSession, laboratory: Any
) -> None:
    error = IncompleteFrameError("packets lost", device="camera")
    checks: list[DriftRecord] = []
    for bad, expected in ((1, [1, 2, 3]), (2, [1, 2, 3]), (4, [1, 2, 3])):
        checks.clear()
        laboratory.log.clear()
        laboratory.failures = fails("grab", error, at=bad, times=3)
        session.run(drift=DriftChecks(1, lambda check, _is_last: checks.append(check)))
        assert [check.n_shots_before for check in checks] == expected


@pytest.mark.parametrize("seed", range(8))
def test_whatever_goes_wrong_every_shot_is_stored_once_or_skipped(
    session: RecordedSession, laboratory: Any, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    patience(session, 40.0)
    many: dict[str, Any] = {"max_attempts": 20}
    session.configure(retry={"max_skipped_in_row": 4, "not_ready": many, "lost_connection": many})
    calls = [call for call, _, _ in RETRYABLE] + ["read_room", "point"]
    for _ in range(25):
        call = str(rng.choice(calls))
        errors = [error for other, error, _ in RETRYABLE if other == call]
        error = errors[0] if errors else SafetyError("pressed", device="robot")
        laboratory.failures[call, int(rng.integers(1, 12))] = error
    checks: list[DriftRecord] = []
    outcome = session.run(
        drift=DriftChecks(2, lambda check, _is_last: checks.append(check)),
        free_bytes=Disk(*rng.choice([100, 900], 5), 900),
    )
    assert sorted([*session.ids, *outcome.skipped]) == [1, 2, 3, 4]
    assert session.replaced == []
    for record in session.records:
        assert (record.frame.image == 10 * record.shot_id).all()
        assert record.robot.rail_m == 10.0 * record.shot_id
        assert record.attempt == 1 + sum(record.n_failures.values())
    counts = [check.n_shots_before for check in checks]
    assert counts == [n for n in (2, 4) if n <= len(session.ids)] + (
        [len(session.ids)] if len(session.ids) % 2 else []
    )
