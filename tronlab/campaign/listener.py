"""Who is told what happens in a run."""

from collections.abc import Callable
from dataclasses import dataclass

from tronlab.campaign.console import Decision, Pause
from tronlab.campaign.suspension import Suspension
from tronlab.dataset.records import ShotRecord


@dataclass(frozen=True)
class RunListener:
    """Who is told what happens; the calls come from the engine's thread.

    A task is a shot or a drift check, by the name it has in messages.
    """

    on_shot: Callable[[ShotRecord], None] = lambda record: None
    """A shot was committed."""
    on_retry: Callable[[str, int, Exception], None] = lambda task, attempt, error: None
    """An attempt failed and another follows: task, the attempt that failed, its error."""
    on_skip: Callable[[int, str], None] = lambda shot_id, why: None
    """A shot is left out: its attempts are used up."""
    on_suspend: Callable[[Suspension], None] = lambda suspension: None
    """The run waits, and goes on by itself."""
    on_resume: Callable[[Suspension], None] = lambda suspension: None
    """What it waited for is over."""
    on_pause: Callable[[Pause], None] = lambda pause: None
    """A person has paused the run, and is asked."""
    on_decision: Callable[[Decision], None] = lambda decision: None
    """What the person says; after a note more follows."""
