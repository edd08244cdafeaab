"""A live view that remembers, and may act when a stage advances."""

from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager

from tronlab.dataset.records import ShotRecord


class Recorder:
    """Keeps everything it is told."""

    def __init__(self, on_advance: Callable[[str, int], None] | None = None) -> None:
        self.texts: list[str] = []
        self.progress: list[tuple[str, int, int]] = []
        self.states: list[str] = []
        self.shots: list[ShotRecord] = []
        self._on_advance = on_advance or (lambda stage, n_done: None)

    def announce(self, text: str) -> None:
        self.texts.append(text)

    def said(self, text: str) -> bool:
        """Tell whether an announcement has this text in it."""
        return any(text in line for line in self.texts)

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        self.progress.append((stage, n_done, n_all))
        self._on_advance(stage, n_done)

    def expect(self, moves_s: Mapping[int, float]) -> None: ...

    def show_shot(self, record: ShotRecord, *, write_s: float) -> None:
        self.shots.append(record)

    def state(self, text: str) -> None:
        self.states.append(text)

    @contextmanager
    def suspended(self) -> Generator[None]:
        yield
