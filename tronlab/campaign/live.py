"""What a person sees of a run: stages, shots, the state it is in, and the time that is left."""

import time
from collections.abc import Callable, Generator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Protocol, TextIO

from tronlab.campaign.pace import Pace, describe_split
from tronlab.dataset.records import ShotRecord

PLAIN_STEP = 0.1
"""Without a terminal there is one line each time so much of the work is done."""

RUNNING = "running"
"""The state that is nothing to worry about."""
SHOTS = "shots"
"""The stage whose time is learned from its shots."""


class Live(Protocol):
    """Shows a run. May be called from any thread."""

    def announce(self, text: str) -> None:
        """Say what happens next, or what went wrong."""
        ...

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        """Say how far a stage is; the first call of a stage begins it."""
        ...

    def expect(self, moves_s: Mapping[int, float]) -> None:
        """Tell how long the plan thinks that the move to each shot takes, by shot id."""
        ...

    def show_shot(self, record: ShotRecord, *, write_s: float) -> None:
        """Show a shot that was stored, which took so long; ``advance`` comes after it."""
        ...

    def state(self, text: str) -> None:
        """Say what the run does: it is running, paused, or suspended and why; also announce it."""
        ...

    def suspended(self) -> AbstractContextManager[None]:
        """Draw nothing while this is open: somebody else uses the terminal."""
        ...


class SilentLive:
    """Shows nothing."""

    def announce(self, text: str) -> None:
        """Say nothing."""

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        """Show nothing."""

    def expect(self, moves_s: Mapping[int, float]) -> None:
        """Need no estimate."""

    def show_shot(self, record: ShotRecord, *, write_s: float) -> None:
        """Show nothing."""

    def state(self, text: str) -> None:
        """Say nothing."""

    def suspended(self) -> AbstractContextManager[None]:
        """Disturb nobody."""
        return nullcontext()


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
        self._pace = Pace(start_s=monotonic_s())

    def announce(self, text: str) -> None:
        """Print it."""
        print(text, file=self._stream, flush=True)

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        """Print a line at every tenth of the stage, with the time that is left."""
        if stage != self._stage:
            self._stage, self._started_s, self._next_share = stage, self._monotonic_s(), PLAIN_STEP
            self._pace.start(self._started_s)
        if n_done == 0 or n_done < self._next_share * n_all:
            return
        while self._next_share * n_all <= n_done:
            self._next_share += PLAIN_STEP
        elapsed_s = self._monotonic_s() - self._started_s
        left_s = self._pace.left_s(n_all - n_done) if stage == SHOTS else None
        if left_s is None:
            left_s = elapsed_s / n_done * (n_all - n_done)
        tail = f"{left_s:.0f} s left" if n_done < n_all else f"took {elapsed_s:.0f} s"
        self.announce(f"{stage}: {n_done} of {n_all}, {tail}")

    def expect(self, moves_s: Mapping[int, float]) -> None:
        """Take the estimate for the time that is left."""
        self._pace.expect(moves_s)

    def show_shot(self, record: ShotRecord, *, write_s: float) -> None:
        """Print a line if something speaks against it."""
        learn_from(record, self._pace, write_s=write_s, now_s=self._monotonic_s())
        if record.quality is not None and record.quality.flags:
            self.announce(f"shot {record.shot_id}: flagged: {', '.join(record.quality.flags)}")

    def state(self, text: str) -> None:
        """Say nothing: it was announced."""

    def suspended(self) -> AbstractContextManager[None]:
        """Do nothing: lines come only when something happens."""
        return nullcontext()

    def summarise(self) -> None:
        """Print where the time of the shots went."""
        if self._pace.n_shots:
            self.announce(summary(self._pace))


def learn_from(record: ShotRecord, pace: Pace, *, write_s: float, now_s: float) -> None:
    """Have the pace learn from a shot, if it says how long it took."""
    if record.timing is not None:
        pace.learn(record.shot_id, record.timing, write_s=write_s, now_s=now_s)


def summary(pace: Pace) -> str:
    """Say where the time of the shots went."""
    return f"shots taken: {pace.n_shots}; their time: {describe_split(pace)}"


@contextmanager
def open_live(stream: TextIO) -> Generator[Live]:
    """Show a run on stderr: a table and a bar on a terminal, plain lines elsewhere.

    At the end, however it comes, there is a line that says where the time of the shots went.
    """
    if stream.isatty():
        from tronlab.campaign.live_terminal import open_terminal

        with open_terminal(stream) as live:
            yield live
        return
    plain = PlainLive(stream)
    try:
        yield plain
    finally:
        plain.summarise()
