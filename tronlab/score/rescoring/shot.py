"""Scoring one shot: a core is asked, and whatever it does becomes a result with a reason."""

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
    """Interrupt what runs longer, as far as a signal can: between two steps of Python code.

    What no signal interrupts is ended with its process: ``score.rescoring.workers``.
    """
    if limit_s is None or threading.current_thread() is not threading.main_thread():
        yield
        return

    def ring(_signal: int, _frame: object) -> None:
        raise _TimeUp

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
