"""What a person sees of a run: stages, and a progress bar whose ETA is learned from the run."""

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Protocol, TextIO

PLAIN_STEP = 0.1
"""Without a terminal there is one line each time so much of the work is done."""


class Live(Protocol):
    """Shows a run."""

    def announce(self, text: str) -> None:
        """Say what happens next, or what went wrong."""
        ...

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        """Say how far a stage is; the first call of a stage begins it."""
        ...


class SilentLive:
    """Shows nothing."""

    def announce(self, text: str) -> None:
        """Say nothing."""

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        """Show nothing."""


class PlainLive:
    """Prints lines, for logs and pipes."""

    def __init__(
        self, stream: TextIO, *, monotonic_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._stream = stream
        self._monotonic_s = monotonic_s
        self._stage = ""
        self._started_s = 0.0
        self._next_share = 0.0

    def announce(self, text: str) -> None:
        """Print it."""
        print(text, file=self._stream, flush=True)

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        """Print a line at every tenth of the stage, with the time that is left."""
        if stage != self._stage:
            self._stage, self._started_s, self._next_share = stage, self._monotonic_s(), PLAIN_STEP
        if n_done == 0 or n_done < self._next_share * n_all:
            return
        while self._next_share * n_all <= n_done:
            self._next_share += PLAIN_STEP
        elapsed_s = self._monotonic_s() - self._started_s
        left_s = elapsed_s / n_done * (n_all - n_done)
        tail = f"{left_s:.0f} s left" if n_done < n_all else f"took {elapsed_s:.0f} s"
        self.announce(f"{stage}: {n_done} of {n_all}, {tail}")


@contextmanager
def open_live(stream: TextIO) -> Generator[Live]:
    """Show a run on stderr: a progress bar on a terminal, plain lines elsewhere."""
    if not stream.isatty():
        yield PlainLive(stream)
        return
    with _rich_live(stream) as live:
        yield live


@contextmanager
def _rich_live(stream: TextIO) -> Generator[Live]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TaskID,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    class RichLive:
        def __init__(self, progress: Progress) -> None:
            self._progress = progress
            self._tasks: dict[str, TaskID] = {}

        def announce(self, text: str) -> None:
            self._progress.console.print(text, markup=False, highlight=False)

        def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
            if stage not in self._tasks:
                self._tasks[stage] = self._progress.add_task(stage, total=n_all)
            self._progress.update(self._tasks[stage], completed=n_done)

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(file=stream)) as progress:
        yield RichLive(progress)
