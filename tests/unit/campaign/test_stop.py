import os
import signal
import threading

from tronlab.campaign.stop import StopRequest, stopped_by_ctrl_c


def test_asked_once_and_twice() -> None:
    stop = StopRequest()
    heard: list[str] = []
    stop.on_at_once(lambda: heard.append("at once"))
    assert not stop.is_asked
    stop.ask()
    assert (stop.is_asked, stop.is_at_once, heard) == (True, False, [])
    stop.ask()
    assert (stop.is_at_once, heard) == (True, ["at once"])


def test_ctrl_c_asks_and_the_handler_before_comes_back() -> None:
    before = signal.getsignal(signal.SIGINT)
    stop = StopRequest()
    announced: list[str] = []
    with stopped_by_ctrl_c(stop, announce=announced.append):
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.is_asked
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.is_at_once
    assert announced == [
        "stopping after this shot; Ctrl-C again stops at once",
        "stopping at once",
    ]
    assert signal.getsignal(signal.SIGINT) is before


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
