"""What a campaign does about an error."""

import pytest

from tronlab.campaign.config import CampaignConfig, RetryRule
from tronlab.campaign.policy import (
    Again,
    DiskNearlyFullError,
    End,
    GiveUp,
    LampDriftError,
    Setbacks,
    Wait,
    class_of,
    pause_before_next_s,
)
from tronlab.dataset.records import ErrorClass
from tronlab.errors import (
    AccessDeniedError,
    DatasetError,
    DeviceError,
    DeviceFaultError,
    DeviceTimeoutError,
    IncompleteFrameError,
    LimitError,
    NotConnectedError,
    NotReadyError,
    NotSettledError,
    ProtocolError,
    QualityError,
    SafetyError,
    TrackingLostError,
)

BEAM = TrackingLostError("beam", device="tracker")
DOOR = SafetyError("door", device="room")
MOVES = NotSettledError("moves", device="tracker")
DIM = LampDriftError("dim", device="room")
FULL = DiskNearlyFullError("full")


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (DOOR, "unsafe"),
        (SafetyError("emergency stop", device="robot"), "unsafe"),
        (BEAM, "tracking_lost"),
        (MOVES, "not_settled"),
        (IncompleteFrameError("packets", device="camera"), "incomplete_frame"),
        (NotReadyError("warming up", device="tracker", code=1), "not_ready"),
        (NotReadyError("busy", device="robot", code=1), "not_ready"),
        (QualityError("blur", device="camera"), "quality"),
        (DIM, "quality"),
        (NotConnectedError("lost", device="camera"), "lost_connection"),
        (DeviceTimeoutError("silent", device="room"), "lost_connection"),
        (NotConnectedError("lost", device="robot"), None),
        (DeviceTimeoutError("silent", device="robot"), None),
        (AccessDeniedError("held", device="camera"), None),
        (DeviceFaultError("broken", device="tracker", code=7), None),
        (LimitError("too far", device="robot"), None),
        (ProtocolError("nonsense", device="room", sent=b"", received=b"?"), None),
        (DeviceError("odd", device="camera"), None),
        (DatasetError("broken"), None),
        (FULL, None),
        (ZeroDivisionError(), None),
        (None, None),
    ],
)
def test_every_error_has_its_class(error: BaseException | None, expected: ErrorClass | None):
    assert class_of(error) == expected


def test_pauses_are_used_in_turn_and_the_last_one_again():
    rule = RetryRule(max_attempts=5, pauses_s=(1.0, 7.0))
    assert [pause_before_next_s(rule, n) for n in range(1, 6)] == [1.0, 7.0, 7.0, 7.0, None]
    assert pause_before_next_s(RetryRule(max_attempts=1), 1) is None


@pytest.fixture
def setbacks(config: CampaignConfig) -> Setbacks:
    return Setbacks("shot 7", config)


def test_each_class_has_attempts_of_its_own(setbacks: Setbacks):
    setbacks.config = setbacks.config.model_copy(
        update={"suspend": setbacks.config.suspend.model_copy(update={"on_beam_lost": False})}
    )
    errors = [BEAM, MOVES, BEAM, MOVES, BEAM]
    reactions = [setbacks.react(error, now_s=0.0, is_in_place=True) for error in errors]
    assert reactions == [Again(1.0), Again(1.0), Again(5.0), Again(5.0), GiveUp()]
    assert setbacks.n_failures == {"tracking_lost": 3, "not_settled": 2}
    assert setbacks.attempt == 6


def test_quality_is_limited_even_if_whoever_judges_never_has_enough(setbacks: Setbacks):
    error = QualityError("blur", device="camera")
    reactions = [setbacks.react(error, now_s=0.0, is_in_place=True) for _ in range(2)]
    assert reactions == [Again(0.0), GiveUp()]


def test_what_nobody_knows_a_remedy_for_ends_the_run(setbacks: Setbacks):
    assert setbacks.react(ZeroDivisionError(), now_s=0.0, is_in_place=True) == End()
    assert setbacks.attempt == 1


@pytest.mark.parametrize(
    ("error", "is_counted", "at_the_end"),
    [(DOOR, True, End()), (DIM, True, End()), (FULL, False, End())],
)
def test_a_suspension_counts_once_and_has_an_end(
    setbacks: Setbacks, error: Exception, is_counted: bool, at_the_end: End
):
    now_s, looks = 100.0, 0
    while isinstance(reaction := setbacks.react(error, now_s=now_s, is_in_place=False), Wait):
        assert 0 < reaction.pause_s <= 5.0
        now_s += reaction.pause_s
        looks += 1
        assert setbacks.attempt == 1 + is_counted
    assert reaction == at_the_end
    assert now_s == pytest.approx(100.0 + setbacks.config.suspend.timeout_s)
    assert looks > 700


def test_the_beam_is_waited_for_when_its_attempts_are_used_up(setbacks: Setbacks):
    def lose_beam(now_s: float) -> object:
        return setbacks.react(BEAM, now_s=now_s, is_in_place=True)

    assert [lose_beam(0.0), lose_beam(1.0)] == [Again(1.0), Again(5.0)]
    assert isinstance(lose_beam(10.0), Wait)
    assert setbacks.waits_for("beam")
    assert isinstance(lose_beam(3600.0), Wait)
    assert lose_beam(3611.0) == GiveUp()
    assert setbacks.n_failures == {"tracking_lost": 3}


def test_another_error_ends_a_suspension(setbacks: Setbacks):
    setbacks.react(DOOR, now_s=0.0, is_in_place=False)
    first = setbacks.suspension
    setbacks.react(DOOR, now_s=1.0, is_in_place=False)
    assert setbacks.suspension is first
    setbacks.react(MOVES, now_s=2.0, is_in_place=True)
    assert setbacks.suspension is None
    setbacks.react(DOOR, now_s=3.0, is_in_place=True)
    assert setbacks.n_failures == {"unsafe": 2, "not_settled": 1}


def test_a_door_opened_again_after_the_move_is_another_suspension(setbacks: Setbacks):
    for now_s, is_in_place in ((0.0, False), (3500.0, False), (3601.0, True), (7200.0, False)):
        reaction = setbacks.react(DOOR, now_s=now_s, is_in_place=is_in_place)
        assert isinstance(reaction, Wait)
    assert setbacks.n_failures == {"unsafe": 2}


def test_patience_is_renewed_by_a_person(setbacks: Setbacks):
    setbacks.renew_patience(0.0)
    setbacks.react(DOOR, now_s=0.0, is_in_place=False)
    setbacks.renew_patience(5000.0)
    assert isinstance(setbacks.react(DOOR, now_s=8000.0, is_in_place=False), Wait)
    assert setbacks.react(DOOR, now_s=8601.0, is_in_place=False) == End()
