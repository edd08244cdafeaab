"""How a wizard talks with whoever calibrates: a person at a terminal, or nobody."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol


class Progress(Protocol):
    """Is told how far the calibration is."""

    def announce(self, text: str) -> None:
        """Say what happens next, what was found, or what was left out."""
        ...

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        """Say how far a stage is."""
        ...


class Dialogue(Progress, Protocol):
    """Is also asked what to do."""

    def confirm(self, question: str) -> bool:
        """Ask a question that is answered by yes or no; return when it was answered."""
        ...

    def choose(self, question: str, choices: Sequence[str]) -> str:
        """Ask for one of several words; the first is what the wizard proposes."""
        ...


@dataclass(frozen=True, slots=True)
class Unattended:
    """Nobody answers: every question is answered as the wizard proposes."""

    progress: Progress

    def announce(self, text: str) -> None:
        """Pass it on."""
        self.progress.announce(text)

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        """Pass it on."""
        self.progress.advance(stage, n_done=n_done, n_all=n_all)

    def confirm(self, question: str) -> bool:
        """Say yes."""
        return True

    def choose(self, question: str, choices: Sequence[str]) -> str:
        """Take the proposal."""
        return choices[0]
