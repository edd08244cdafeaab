"""Scoring one shot: a core is asked, and whatever it does becomes a result with a reason."""

import ctypes
import signal
import threading
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tronlab.nav.answers import checked
from tronlab.nav.core import Frame, NavigationCore, NavigationResult, SequentialCore

if TYPE_CHECKING:
    from tronlab.score.table import Row  # workers have no need of pandas

LIMIT_S = 60.0
"""How long a core may take for one image."""


@dataclass(frozen=True, slots=True)
class CoreScore:
    """What one core made of one shot."""

    core: str
    shot_id: int
    row: "Row"
    result: NavigationResult
    seed: int = 0


def locate(
    core: NavigationCore,
    frame: Frame,
    *,
    limit_s: float | None = LIMIT_S,
    is_first: bool = False,
) -> NavigationResult:
    """Ask a core for a pose; whatever goes wrong inside it is a result with a reason.

    Args:
        core: The core.
        frame: What it is shown.
        limit_s: How long it may take; None if the core itself sees to that.
        is_first: The frame is the first of a sequence.
    """
    try:
        with _time_limit(limit_s):
            if is_first and isinstance(core, SequentialCore):
                core.reset()
            return checked(core.locate(frame))
    except _TimeUp:
        return NavigationResult("timeout", reason=f"no answer within {limit_s:g} s")
    except (Exception, SystemExit) as error:
        return NavigationResult("error", reason=f"{type(error).__name__}: {error}")


class _TimeUp(BaseException):
    """The time of a core is up; not an Exception, so that the core does not catch it by chance."""


@contextmanager
def _time_limit(limit_s: float | None) -> Generator[None]:
    """Interrupt what runs longer, as far as Python can: between two steps of its code.

    What that does not reach is ended with its process: ``score.rescoring.workers``.
    """
    if limit_s is None:
        yield
    elif threading.current_thread() is threading.main_thread():
        with _alarm(limit_s):
            yield
    else:
        with _raised_from_outside(limit_s):
            yield


@contextmanager
def _alarm(limit_s: float) -> Generator[None]:
    """Interrupt the main thread: a signal wakes it from a sleep as well."""

    def ring(_signal: int, _frame: object) -> None:
        raise _TimeUp

    before = signal.signal(signal.SIGALRM, ring)
    try:
        signal.setitimer(signal.ITIMER_REAL, limit_s)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
    finally:
        signal.signal(signal.SIGALRM, before)


@contextmanager
def _raised_from_outside(limit_s: float) -> Generator[None]:
    """Interrupt another thread, one of a Dask worker: it has no signals."""
    this_thread = ctypes.c_ulong(threading.get_ident())
    is_over, lock = threading.Event(), threading.Lock()

    def ring() -> None:
        with lock:
            if not is_over.is_set():
                _raise_in(this_thread, ctypes.py_object(_TimeUp))

    timer = threading.Timer(limit_s, ring)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        with lock:
            is_over.set()
            _raise_in(this_thread, None)  # what has not been raised yet
        timer.cancel()


_raise_in = ctypes.pythonapi.PyThreadState_SetAsyncExc
