"""The steps of a study: what each depends on, and whether it is done already."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tronlab.campaign.live import Live


@dataclass(frozen=True, slots=True)
class Desk:
    """What a step works with."""

    out: Path
    """Folder of the study; a step writes into its own part of it."""
    n_workers: int
    """Number of processes that may work at a time."""
    live: Live
    is_begun: bool = False
    """Whether this step was begun before with the same key: what is there may go on."""


@dataclass(frozen=True, slots=True)
class Step:
    """One thing to do. Steps are done in their order; each may use the results of those before."""

    name: str
    """What a person reads: ``record dataset_1_nominal``."""
    key: str
    """Digest of everything that the results depend on: settings, contents of files, code, keys of
    the steps before. A step whose key has not changed is not done again."""
    cost: float
    """About how long it takes, in seconds on two processors: for the time that is left."""
    run: Callable[[Desk], None]
    """Does it. What was interrupted goes on where it stopped, as far as it can."""
    results: tuple[Path, ...]
    """Files that are there when it is done, relative to the study's folder."""
