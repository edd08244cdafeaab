"""The live view on a terminal: the last shots, the state of the run, where time goes, and a bar."""

import time
from collections import deque
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from typing import TextIO

from rich.console import Console, Group, RenderableType
from rich.live import Live as RichLive
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table
from rich.text import Text

from tronlab.campaign.live import RUNNING, SHOTS, learn_from, summary
from tronlab.campaign.pace import Pace, describe_split, shot_duration_s
from tronlab.dataset.records import ShotRecord

N_SHOWN = 8
"""So many shots are in the table."""
_COLUMNS = ("shot", "attempt", "range m", "usable %", "sigma mm", "time s", "flags")


class TerminalLive:
    """Draws the run, several times a second and in a thread of its own."""

    def __init__(
        self, console: Console, *, monotonic_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._console = console
        self._monotonic_s = monotonic_s
        self._pace = Pace(start_s=monotonic_s())
        self._state = ""
        self._state_since_s = monotonic_s()
        self._rows: deque[tuple[str, ...]] = deque(maxlen=N_SHOWN)
        self._tasks: dict[str, TaskID] = {}
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}"),
            console=console,
        )
        self._drawing = RichLive(get_renderable=self.picture, console=console)

    def __enter__(self) -> "TerminalLive":
        """Begin to draw."""
        self._drawing.start(refresh=True)
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the last picture, and say where the time went."""
        self._drawing.stop()
        if self._pace.n_shots:
            self.announce(summary(self._pace))

    def announce(self, text: str) -> None:
        """Print it above the picture."""
        self._console.print(text, markup=False, highlight=False)

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        """Move the bar of the stage."""
        if stage not in self._tasks:
            self._tasks[stage] = self._progress.add_task(stage, total=n_all, left="")
            self._pace.start(self._monotonic_s())
        left_s = (
            self._pace.left_s(n_all - n_done)
            if stage == SHOTS
            else self._progress.tasks[self._tasks[stage]].time_remaining
        )
        left = f"left {_clock_face(left_s)}" if left_s is not None and n_done < n_all else ""
        self._progress.update(self._tasks[stage], completed=n_done, total=n_all, left=left)

    def expect(self, moves_s: Mapping[int, float]) -> None:
        """Take the estimate for the time that is left."""
        self._pace.expect(moves_s)

    def show_shot(self, record: ShotRecord, *, write_s: float) -> None:
        """Put it below the shots before."""
        learn_from(record, self._pace, write_s=write_s, now_s=self._monotonic_s())
        self._rows.append(_row(record, write_s=write_s))

    def state(self, text: str) -> None:
        """Show it, and since when, until something else holds."""
        if text != self._state:
            self._state, self._state_since_s = text, self._monotonic_s()

    @contextmanager
    def suspended(self) -> Generator[None]:
        """Leave the picture as it is, and draw a new one below when the terminal is free again."""
        self._drawing.stop()
        try:
            yield
        finally:
            self._drawing.start(refresh=True)

    def picture(self) -> RenderableType:
        """Give what is drawn now."""
        parts: list[RenderableType] = []
        if self._rows:
            parts += [_table(list(self._rows)), Text(f"time: {describe_split(self._pace)}")]
        if self._state:
            since = _clock_face(self._monotonic_s() - self._state_since_s)
            style = "" if self._state == RUNNING else "bold yellow"
            parts.append(Text(f"{self._state}, for {since}", style=style))
        return Group(*parts, self._progress)


@contextmanager
def open_terminal(stream: TextIO) -> Generator[TerminalLive]:
    """Draw on a terminal while this is open."""
    with TerminalLive(Console(file=stream)) as live:
        yield live


def _row(record: ShotRecord, *, write_s: float) -> tuple[str, ...]:
    quality, timing = record.quality, record.timing
    return (
        str(record.shot_id),
        str(record.attempt),
        f"{record.truth.range_los_m:.3f}",
        f"{100 * record.truth.usable_fraction:.1f}",
        f"{1e3 * quality.tracker_sigma_m:.3f}" if quality else "",
        f"{shot_duration_s(timing, write_s=write_s):.1f}" if timing else "",
        ", ".join(quality.flags) if quality else "",
    )


def _table(rows: list[tuple[str, ...]]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in _COLUMNS:
        table.add_column(column, justify="left" if column == "flags" else "right")
    for row in rows:
        table.add_row(*row, style="yellow" if row[-1] else "")
    return table


def _clock_face(duration_s: float) -> str:
    return str(timedelta(seconds=round(duration_s)))
