"""A person pauses a run, and says how it goes on."""

import os
import signal
import threading
from collections.abc import Callable
from typing import Any

import pytest
from recorded_session import RecordedSession, ScriptedPerson

from tronlab.campaign.console import Abort, Note, Resume, Retake
from tronlab.campaign.drift import DriftChecks
from tronlab.campaign.listener import RunListener
from tronlab.campaign.stop import RunStoppedError, StopRequest, stopped_by_ctrl_c
from tronlab.dataset.records import DriftRecord
from tronlab.devices.registry import connected
from tronlab.errors import NotSettledError, TrackingLostError


def ask_at(stop: StopRequest, laboratory: Any, call: str, *numbers: int) -> None:
    """Press Ctrl-C during these calls of a device."""

    def press(name: str) -> None:
        if name == call and laboratory.log.count(call) in numbers:
            stop.ask()

    laboratory.on_call = press


def during(answer: Callable[[], None]) -> ScriptedPerson:
    """Give a person who does something while being asked."""
    return ScriptedPerson([Resume()], before_answer=answer)


def test_a_paused_run_finishes_its_shot_asks_and_goes_on(
    session: RecordedSession, laboratory: Any
) -> None:
    stop, person = StopRequest(), ScriptedPerson([Note("dust on the lens"), Resume(), Resume()])
    ask_at(stop, laboratory, "grab", 2, 4)
    outcome = session.run(stop=stop, console=person)
    assert session.ids == [1, 2, 3, 4]
    assert outcome.skipped == {}
    assert session.told == [
        "pause: 2 shots are stored, 2 to come",
        repr(Note("dust on the lens")),
        repr(Resume()),
        "pause: 4 shots are stored, 0 to come",
        repr(Resume()),
    ]
    assert not stop.is_asked
    assert not person.is_dismissed


def test_shots_are_taken_again_before_those_to_come(
    session: RecordedSession, laboratory: Any
) -> None:
    stop, person = StopRequest(), ScriptedPerson([Retake((2, 1)), Retake((4,))])
    ask_at(stop, laboratory, "grab", 3, 6)
    session.run(stop=stop, console=person)
    assert session.ids == [1, 2, 3, 2, 1, 4, 4]
    assert session.replaced == [2, 1, 4]
    assert session.attempts == [1] * 7
    assert [(pause.n_left, len(pause.committed)) for pause in person.asked] == [(1, 3), (0, 4)]


def test_a_skipped_shot_can_be_taken_again(session: RecordedSession, laboratory: Any) -> None:
    stop, person = StopRequest(), ScriptedPerson([Retake((1,))])
    session.configure(retry={"not_settled": {"max_attempts": 1, "pauses_s": (1.0,)}})
    laboratory.failures = {("look", 1): NotSettledError("moves", device="tracker")}
    ask_at(stop, laboratory, "grab", 1)
    outcome = session.run(stop=stop, console=person)
    assert session.ids == [2, 1, 3, 4]
    assert (session.replaced, outcome.skipped) == ([], {})
    assert list(person.asked[0].skipped) == [1]


@pytest.mark.parametrize("shot_ids", [(4,), (99,), (1, 2, 3)])
def test_what_cannot_be_taken_again_is_told_and_the_run_goes_on(
    session: RecordedSession, laboratory: Any, shot_ids: tuple[int, ...]
) -> None:
    warnings: list[str] = []
    session.taker.warn = warnings.append
    stop = StopRequest()
    ask_at(stop, laboratory, "grab", 3)
    session.run(stop=stop, console=ScriptedPerson([Retake(shot_ids)]), n_spare_rows=2)
    assert session.ids == [1, 2, 3, 4]
    assert len(warnings) == 1
    assert warnings[0].startswith("nothing is taken again: ")


def test_no_more_shots_are_taken_again_than_the_dataset_has_room_for(
    session: RecordedSession, laboratory: Any
) -> None:
    stop, person = StopRequest(), ScriptedPerson([Retake((1,)), Retake((2,)), Retake((1,))])
    ask_at(stop, laboratory, "grab", 2, 3, 4)
    session.run(stop=stop, console=person, n_spare_rows=2)
    assert [pause.n_retakes_left for pause in person.asked] == [2, 1, 0]
    assert session.ids == [1, 2, 1, 2, 3, 4]


def test_an_aborted_run_ends_in_good_order(session: RecordedSession, laboratory: Any) -> None:
    stop, checks = StopRequest(), list[DriftRecord]()
    ask_at(stop, laboratory, "grab", 2)
    with pytest.raises(RunStoppedError):
        session.run(
            stop=stop,
            console=ScriptedPerson([Abort()]),
            drift=DriftChecks(None, lambda check, _is_last: checks.append(check)),
        )
    assert session.ids == [1, 2]
    assert [check.n_shots_before for check in checks] == [2]


def test_ctrl_c_while_paused_ends_the_run_and_dismisses_the_question(
    session: RecordedSession, laboratory: Any
) -> None:
    stop, is_over = StopRequest(), threading.Event()

    def press_and_say_nothing() -> None:
        stop.ask()
        is_over.wait(timeout=60)

    person = during(press_and_say_nothing)
    dismiss = person.dismiss
    person.dismiss = lambda: (dismiss(), is_over.set())  # type: ignore[method-assign]
    ask_at(stop, laboratory, "grab", 1)
    with connected(session.taker.devices), pytest.raises(RunStoppedError):
        session.run(stop=stop, console=person)
    assert session.ids == [1]
    assert person.is_dismissed
    assert laboratory.log.index("stop") < laboratory.log.index("close robot")


def test_ctrl_c_just_after_the_answer_ends_the_run(
    session: RecordedSession, laboratory: Any
) -> None:
    stop = StopRequest()
    ask_at(stop, laboratory, "grab", 1)
    with pytest.raises(RunStoppedError):
        session.run(
            stop=stop,
            console=ScriptedPerson([Resume()]),
            listener=RunListener(on_decision=lambda decision: stop.ask()),
        )
    assert laboratory.log.count("move") == 1


def test_ctrl_c_twice_in_a_shot_asks_nobody(session: RecordedSession, laboratory: Any) -> None:
    stop, person = StopRequest(), ScriptedPerson([Resume()])
    laboratory.on_call = lambda call: (stop.ask(), stop.ask()) if call == "grab" else None
    with pytest.raises(RunStoppedError):
        session.run(stop=stop, console=person)
    assert (session.ids, person.asked) == ([], [])
    assert "stop" in laboratory.log


def test_a_batch_system_ends_a_run_that_could_be_paused(
    session: RecordedSession, laboratory: Any
) -> None:
    stop, person = StopRequest(), ScriptedPerson([Resume()])
    laboratory.on_call = lambda call: (
        os.kill(os.getpid(), signal.SIGTERM) if call == "grab" else None
    )
    with (
        stopped_by_ctrl_c(stop, announce=lambda text: None, can_pause=True),
        pytest.raises(RunStoppedError),
    ):
        session.run(stop=stop, console=person)
    assert (session.ids, person.asked) == ([1], [])


def test_signals_reach_a_run_that_hangs(session: RecordedSession, laboratory: Any) -> None:
    """Both Ctrl-C come while a device does not answer; the thread that waits handles them."""
    is_announced, is_stopped = threading.Event(), threading.Event()

    def press_twice_and_hang(call: str) -> None:
        if call == "stop":
            is_stopped.set()
        if call == "grab":
            os.kill(os.getpid(), signal.SIGINT)
            assert is_announced.wait(timeout=10)
            os.kill(os.getpid(), signal.SIGINT)
            assert is_stopped.wait(timeout=10)

    laboratory.on_call = press_twice_and_hang
    stop = StopRequest()
    with (
        stopped_by_ctrl_c(stop, announce=lambda text: is_announced.set()),
        pytest.raises(RunStoppedError),
    ):
        session.run(stop=stop)
    assert is_stopped.is_set()
    assert session.ids == []


def test_a_run_that_waits_can_be_paused_and_waits_on(
    session: RecordedSession, laboratory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    lamp = DimLamp(session, monkeypatch)
    session.configure(suspend={"timeout_s": 60.0})
    laboratory.doors = [False] * 100
    stop, clock = StopRequest(), session.taker.clock

    def be_away_for_an_hour_and_close_the_door() -> None:
        clock.advance(3600.0)
        laboratory.doors = [False] * 3

    person = during(be_away_for_an_hour_and_close_the_door)
    ask_at(stop, laboratory, "read_room", 5)
    session.run(stop=stop, console=person)
    assert session.ids == [1, 2, 3, 4]
    assert session.attempts == [2, 1, 1, 1]
    assert [line.split()[0] for line in session.told] == [
        "suspend:",
        "pause:",
        "Resume()",
        "suspend:",
        "resume",
    ]
    assert "waiting before shot 1: room: the door is open" in str(person.asked[0])
    assert person.asked[0].n_left == 4
    assert not lamp.is_renewed


def test_a_run_that_waits_can_be_aborted(session: RecordedSession, laboratory: Any) -> None:
    laboratory.failures = {
        ("measure", n): TrackingLostError("no beam", device="tracker") for n in range(2, 1000)
    }
    stop = StopRequest()
    ask_at(stop, laboratory, "measure", 20)
    with pytest.raises(RunStoppedError):
        session.run(stop=stop, console=ScriptedPerson([Abort()]))
    assert session.ids == [1]


def test_checks_for_drift_vouch_for_shots_taken_again_too(
    session: RecordedSession, laboratory: Any
) -> None:
    stop, checks = StopRequest(), list[DriftRecord]()
    ask_at(stop, laboratory, "grab", 4, 5)
    session.run(
        stop=stop,
        console=ScriptedPerson([Retake((1,)), Resume()]),
        drift=DriftChecks(2, lambda check, _is_last: checks.append(check)),
    )
    assert session.ids == [1, 2, 3, 4, 1]
    assert [check.n_shots_before for check in checks] == [2, 4, 5]


class DimLamp:
    """A gate that finds the light wrong from some shot on, until someone says it is right."""

    def __init__(self, session: RecordedSession, monkeypatch: pytest.MonkeyPatch) -> None:
        self.is_dim = False
        taker = session.taker
        monkeypatch.setattr(
            type(taker),
            "objections",
            property(lambda _taker: {"brightness": "30 % darker"} if self.is_dim else {}),
        )
        monkeypatch.setattr(taker.gate, "renew_light", self.renew)
        self.is_renewed = False

    def renew(self) -> None:
        self.is_dim, self.is_renewed = False, True


def test_a_lamp_that_has_drifted_is_waited_for(
    session: RecordedSession, laboratory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    session.configure(suspend={"on_lamp_drift": True})
    lamp = DimLamp(session, monkeypatch)

    def dim_for_a_while(call: str) -> None:
        if call == "grab":
            lamp.is_dim = 2 <= laboratory.log.count("grab") <= 5

    laboratory.on_call = dim_for_a_while
    session.run()
    assert session.attempts == [1, 2, 1, 1]
    assert session.records[1].n_failures == {"quality": 1}
    assert laboratory.log.count("grab") == 4 + 4
    assert session.told == [
        "suspend: waiting before shot 2: room: the light has changed: 30 % darker; look after the"
        " lamp, or press Ctrl-C and resume to go on with the light there is; the run goes on by"
        " itself",
        "resume lamp",
    ]
    assert not lamp.is_renewed


def test_a_person_may_accept_the_light_there_is(
    session: RecordedSession, laboratory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    session.configure(suspend={"on_lamp_drift": True})
    lamp, stop = DimLamp(session, monkeypatch), StopRequest()
    lamp.is_dim = True
    ask_at(stop, laboratory, "grab", 3)
    session.run(stop=stop, console=ScriptedPerson([Resume()]))
    assert lamp.is_renewed
    assert session.ids == [1, 2, 3, 4]


def test_by_default_a_dim_shot_is_stored(
    session: RecordedSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    DimLamp(session, monkeypatch).is_dim = True
    session.run()
    assert session.attempts == [1, 1, 1, 1]
