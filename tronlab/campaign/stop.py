"""How a person, or another thread, asks a run to stop."""

import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager


class RunStoppedError(Exception):
    """The run was asked to stop, and did so in good order."""


class StopRequest:
    """Asked once: stop after the shot in hand. Asked again: stop at once."""

    def __init__(self) -> None:
        self._n_asked = 0
        self._callbacks: list[Callable[[], None]] = []

    @property
    def is_asked(self) -> bool:
        """Get whether the run shall stop."""
        return self._n_asked > 0

    @property
    def is_at_once(self) -> bool:
        """Get whether the run shall stop without finishing its shot."""
        return self._n_asked > 1

    def ask(self) -> None:
        """Ask the run to stop; may be called from a signal handler."""
        self._n_asked += 1
        if self.is_at_once:
            for callback in self._callbacks:
                callback()

    def on_at_once(self, callback: Callable[[], None]) -> None:
        """Have ``callback`` called when the run must stop at once."""
        self._callbacks.append(callback)


@contextmanager
def stopped_by_ctrl_c(stop: StopRequest, *, announce: Callable[[str], None]) -> Generator[None]:
    """Let Ctrl-C, and SIGTERM of a batch system, ask a run to stop.

    Outside the main thread, which gets no signals, it does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def ask(_signal: int, _frame: object) -> None:
        stop.ask()
        announce(
            "stopping at once"
            if stop.is_at_once
            else "stopping after this shot; Ctrl-C again stops at once"
        )

    before = {kind: signal.signal(kind, ask) for kind in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
