"""A study on a terminal: one bar for all of it, one for what its step in hand does."""

from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from typing import TextIO

from rich.console import Console, Group, RenderableType
from rich.live import Live as RichLive
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn
from rich.text import Text

from tronlab.dataset.records import ShotRecord
from tronlab.study.steps import Step
from tronlab.study.view import TimeLeft, clock_face, overview, step_summary

_STUDY = "study"


class TerminalView:
    """Draws a study, several times a second and in a thread of its own."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._left = TimeLeft((), {})
        self._n_steps = 0
        self._step = ""
        self._state = ""
        self._stages: dict[str, TaskID] = {}
        self._progress = Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), console=console
        )
        self._drawing = RichLive(get_renderable=self.picture, console=console, transient=True)

    def __enter__(self) -> "TerminalView":
        """Begin to draw."""
        self._drawing.start(refresh=True)
        return self

    def __exit__(self, *_: object) -> None:
        """Leave only the lines that were printed."""
        self._drawing.stop()

    def begin(self, todo: Sequence[Step], expected_s: Mapping[str, float], *, n_done: int) -> None:
        """Draw the bar of the study."""
        self._left = TimeLeft(todo, expected_s)
        self._stages[_STUDY] = self._progress.add_task(
            _STUDY, total=n_done + len(todo), completed=n_done
        )
        self.announce(overview(len(todo), n_done=n_done, left_s=self._left.left_s))

    def begin_step(self, step: Step) -> None:
        """Show its name, without the bars of the step before."""
        for stage in [name for name in self._stages if name != _STUDY]:
            self._progress.remove_task(self._stages.pop(stage))
        self._step, self._state = step.name, ""
        self._left.begin(step)

    def end_step(self, step: Step, *, seconds: float, peak_memory_mb: float | None) -> None:
        """Move the bar of the study."""
        self._left.end(step, seconds=seconds)
        self._progress.advance(self._stages[_STUDY])
        self.announce(step_summary(step, seconds=seconds, peak_memory_mb=peak_memory_mb))

    def announce(self, text: str) -> None:
        """Print it above the bars."""
        self._console.print(text, markup=False, highlight=False)

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        """Move the bar of a stage of the step."""
        if stage not in self._stages:
            self._stages[stage] = self._progress.add_task(f"  {stage}", total=n_all)
        self._progress.update(self._stages[stage], completed=n_done, total=n_all)

    def expect(self, moves_s: Mapping[int, float]) -> None:
        """Need no estimate: the study has its own."""

    def show_shot(self, record: ShotRecord, *, write_s: float) -> None:
        """Print a line if something speaks against it."""
        if record.quality is not None and record.quality.flags:
            self.announce(f"shot {record.shot_id}: flagged: {', '.join(record.quality.flags)}")

    def state(self, text: str) -> None:
        """Show it until something else holds."""
        self._state = text

    @contextmanager
    def suspended(self) -> Generator[None]:
        """Leave the terminal to somebody else for a while."""
        self._drawing.stop()
        try:
            yield
        finally:
            self._drawing.start(refresh=True)

    def picture(self) -> RenderableType:
        """Give what is drawn now."""
        parts = [self._step, self._state, f"{clock_face(self._left.left_s)} left"]
        return Group(Text(", ".join(part for part in parts if part)), self._progress)


@contextmanager
def open_terminal(stream: TextIO) -> Generator[TerminalView]:
    """Draw on a terminal while this is open."""
    with TerminalView(Console(file=stream)) as view:
        yield view
