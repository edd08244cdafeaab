"""What a person sees of a study: the step in hand, what it says, and the time that is left."""

import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import timedelta
from typing import Protocol, TextIO

from tronlab.campaign.live import Live, PlainLive
from tronlab.dataset.records import ShotRecord
from tronlab.study.steps import Step


class View(Live, Protocol):
    """Shows a study, and each step of it as a run is shown."""

    def begin(self, todo: Sequence[Step], expected_s: Mapping[str, float], *, n_done: int) -> None:
        """Show how much there is to do.

        Args:
            todo: The steps that are not done.
            expected_s: How long those took that were done once, by name.
            n_done: Number of steps that are done already.
        """
        ...

    def begin_step(self, step: Step) -> None:
        """Show that a step begins."""
        ...

    def end_step(self, step: Step, *, seconds: float, peak_memory_mb: float | None) -> None:
        """Show that it is done."""
        ...


class TimeLeft:
    """Estimates when a study is done: what a step took last time, else what it is thought to take.

    Thoughts are corrected by how long the steps took that were done meanwhile.
    """

    def __init__(
        self,
        todo: Sequence[Step],
        expected_s: Mapping[str, float],
        *,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._costs = {step.name: step.cost for step in todo}
        self._expected_s = expected_s
        self._monotonic_s = monotonic_s
        self._took_s = self._thought_s = 0.0
        self._begun: tuple[str, float] | None = None

    def begin(self, step: Step) -> None:
        """Note that a step begins."""
        self._begun = (step.name, self._monotonic_s())

    def end(self, step: Step, *, seconds: float) -> None:
        """Learn from a step that is done."""
        cost = self._costs.pop(step.name, 0.0)
        if step.name not in self._expected_s:
            self._took_s, self._thought_s = self._took_s + seconds, self._thought_s + cost
        self._begun = None

    @property
    def left_s(self) -> float:
        """Get how long the rest takes."""
        left_s = sum(map(self._expected_of, self._costs))
        if self._begun is None:
            return left_s
        name, since_s = self._begun
        return left_s - min(self._monotonic_s() - since_s, self._expected_of(name))

    def _expected_of(self, name: str) -> float:
        # As if one more average step had been as thought: a first quick one says little.
        pace = (self._took_s + _TRUST_S) / (self._thought_s + _TRUST_S)
        return self._expected_s.get(name, self._costs.get(name, 0.0) * pace)


_TRUST_S = 30.0


class PlainView:
    """Prints lines, for logs and pipes."""

    def __init__(
        self, stream: TextIO, *, monotonic_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._stream = stream
        self._monotonic_s = monotonic_s
        self._live = PlainLive(stream, monotonic_s=monotonic_s)
        self._left = TimeLeft((), {})
        self._numbers: Iterator[int] = iter(())
        self._n_steps = 0

    def begin(self, todo: Sequence[Step], expected_s: Mapping[str, float], *, n_done: int) -> None:
        """Print how much there is to do."""
        self._left = TimeLeft(todo, expected_s, monotonic_s=self._monotonic_s)
        self._n_steps = n_done + len(todo)
        self._numbers = iter(range(n_done + 1, self._n_steps + 1))
        self._live.announce(overview(len(todo), n_done=n_done, left_s=self._left.left_s))

    def begin_step(self, step: Step) -> None:
        """Print its name and the time that is left."""
        self._live = PlainLive(self._stream, monotonic_s=self._monotonic_s)  # stages begin anew
        number = f"step {next(self._numbers)} of {self._n_steps}"
        self._live.announce(f"{number}: {step.name}; {clock_face(self._left.left_s)} left")
        self._left.begin(step)

    def end_step(self, step: Step, *, seconds: float, peak_memory_mb: float | None) -> None:
        """Print what it took."""
        self._left.end(step, seconds=seconds)
        self._live.announce(step_summary(step, seconds=seconds, peak_memory_mb=peak_memory_mb))

    def announce(self, text: str) -> None:
        """Print it."""
        self._live.announce(text)

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        """Print a line at every tenth of the stage."""
        self._live.advance(stage, n_done=n_done, n_all=n_all)

    def expect(self, moves_s: Mapping[int, float]) -> None:
        """Take the estimate for the time that a run has left."""
        self._live.expect(moves_s)

    def show_shot(self, record: ShotRecord, *, write_s: float) -> None:
        """Print a line if something speaks against it."""
        self._live.show_shot(record, write_s=write_s)

    def state(self, text: str) -> None:
        """Say nothing: it was announced."""

    def suspended(self) -> AbstractContextManager[None]:
        """Do nothing: lines come only when something happens."""
        return nullcontext()


def overview(n_todo: int, *, n_done: int, left_s: float) -> str:
    """Say how much of a study there is to do."""
    if not n_todo:
        return f"all {n_done} steps are done, nothing has changed since"
    done = f", {n_done} are done already" if n_done else ""
    return f"{n_todo} steps to do{done}; about {clock_face(left_s)}"


def step_summary(step: Step, *, seconds: float, peak_memory_mb: float | None) -> str:
    """Say what a step took."""
    memory = "" if peak_memory_mb is None else f", {peak_memory_mb / 1e3:.1f} GB"
    return f"{step.name}: done in {clock_face(seconds)}{memory}"


def clock_face(duration_s: float) -> str:
    """Give a duration as people read it: 0:12:34."""
    return str(timedelta(seconds=round(duration_s)))


@contextmanager
def open_view(stream: TextIO) -> Generator[View]:
    """Show a study: two bars on a terminal, plain lines elsewhere."""
    if not stream.isatty():
        yield PlainView(stream)
        return
    from tronlab.study.view_terminal import open_terminal

    with open_terminal(stream) as view:
        yield view
