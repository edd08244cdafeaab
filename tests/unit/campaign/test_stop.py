import os
import signal
import threading

import pytest

from tronlab.campaign.stop import StopRequest, stopped_by_ctrl_c


def test_asked_once_and_twice() -> None:
    stop = StopRequest()
    heard: list[str] = []
    stop.on_at_once(lambda: heard.append("first"))
    stop.on_at_once(lambda: heard.append("second"))
    assert not stop.is_asked
    stop.ask()
    assert (stop.is_asked, stop.is_at_once, heard) == (True, False, [])
    for _ in range(3):
        stop.ask()
    assert (stop.is_at_once, heard) == (True, ["first", "second"])


def test_a_person_may_withdraw_what_was_asked_once_only() -> None:
    stop = StopRequest()
    stop.ask()
    stop.withdraw()
    assert not stop.is_asked
    stop.ask()
    assert not stop.is_at_once
    stop.ask()
    stop.withdraw()
    assert stop.is_at_once


@pytest.mark.parametrize(("can_pause", "word"), [(True, "pausing"), (False, "stopping")])
def test_ctrl_c_asks_and_the_handler_before_comes_back(can_pause: bool, word: str) -> None:
    before = signal.getsignal(signal.SIGINT)
    stop = StopRequest()
    announced: list[str] = []
    with stopped_by_ctrl_c(stop, announce=announced.append, can_pause=can_pause):
        os.kill(os.getpid(), signal.SIGINT)
        assert (stop.is_asked, stop.is_final) == (True, False)
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.is_at_once
    assert announced == [
        f"{word} after this shot; Ctrl-C again stops at once",
        "stopping at once, the robot first",
    ]
    assert signal.getsignal(signal.SIGINT) is before


def test_a_batch_system_does_not_wait_for_a_person() -> None:
    stop = StopRequest()
    announced: list[str] = []
    with stopped_by_ctrl_c(stop, announce=announced.append, can_pause=True):
        os.kill(os.getpid(), signal.SIGTERM)
    assert (stop.is_final, stop.is_at_once) == (True, False)
    assert announced == ["stopping after this shot; Ctrl-C again stops at once"]


def test_outside_the_main_thread_signals_stay_as_they_are() -> None:
    handlers: list[object] = []

    def run() -> None:
        with stopped_by_ctrl_c(StopRequest(), announce=print):
            handlers.append(signal.getsignal(signal.SIGINT))

    before = signal.getsignal(signal.SIGINT)
    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert handlers == [before]
