"""How a person, or another thread, asks a run to pause or to stop."""

import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager


class RunStoppedError(Exception):
    """The run was asked to stop, and did so in good order."""


class StopRequest:
    """Asked once: stop, or pause, after the shot in hand. Asked again: stop at once."""

    def __init__(self) -> None:
        self._n_asked = 0
        self._is_final = False
        self._callbacks: list[Callable[[], None]] = []
        # A signal may come while another one is handled, in the same thread.
        self._lock = threading.RLock()

    @property
    def is_asked(self) -> bool:
        """Get whether the run shall pause or stop."""
        return self._n_asked > 0

    @property
    def is_final(self) -> bool:
        """Get whether nobody is there to be asked how to go on: the run shall stop."""
        return self._is_final

    @property
    def is_at_once(self) -> bool:
        """Get whether the run shall stop without finishing its shot."""
        return self._n_asked > 1

    def ask(self, *, is_final: bool = False) -> None:
        """Ask the run to pause or stop; may be called from a signal handler."""
        with self._lock:
            self._n_asked += 1
            self._is_final |= is_final
            is_second = self._n_asked == 2
        if is_second:
            for callback in self._callbacks:
                callback()

    def withdraw(self) -> None:
        """Forget that it was asked once: a person says that the run goes on.

        A second request in the meantime stands.
        """
        with self._lock:
            if not self.is_at_once:
                self._n_asked = 0

    def on_at_once(self, callback: Callable[[], None]) -> None:
        """Have ``callback`` called when the run must stop at once, in the order they came."""
        self._callbacks.append(callback)


@contextmanager
def stopped_by_ctrl_c(
    stop: StopRequest, *, announce: Callable[[str], None], can_pause: bool = False
) -> Generator[None]:
    """Let Ctrl-C, and SIGTERM of a batch system, ask a run to stop.

    Outside the main thread, which gets no signals, it does nothing.

    Args:
        stop: Is asked; by SIGTERM for good.
        announce: Told what happens now.
        can_pause: Whether a person is asked how to go on after the first Ctrl-C.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def ask(kind: int, _frame: object) -> None:
        stop.ask(is_final=kind == signal.SIGTERM)
        if stop.is_at_once:
            announce("stopping at once, the robot first")
            return
        word = "pausing" if can_pause and not stop.is_final else "stopping"
        announce(f"{word} after this shot; Ctrl-C again stops at once")

    before = {kind: signal.signal(kind, ask) for kind in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
