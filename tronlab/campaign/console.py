"""Where a person who paused a run says how it goes on."""

import os
import select
import threading
from collections.abc import Callable, Collection, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from io import UnsupportedOperation
from typing import Protocol, TextIO, TypeAlias

from tronlab.campaign.suspension import Suspension

_LOOK_UP_S = 0.1
_CHUNK_BYTES = 4096

MENU = "r)esume, t)ake again SHOTS, n)ote TEXT, a)bort"


@dataclass(frozen=True, slots=True)
class Resume:
    """The run goes on; if it waited because the lamp has drifted, with the light there is now."""


@dataclass(frozen=True, slots=True)
class Retake:
    """These shots are taken again before all others, and the run goes on."""

    shot_ids: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Note:
    """A remark to keep with the data; the run stays paused."""

    text: str


@dataclass(frozen=True, slots=True)
class Abort:
    """The run ends in good order; what was recorded stays."""


Decision: TypeAlias = Resume | Retake | Note | Abort


@dataclass(frozen=True, slots=True)
class Pause:
    """How a run stands while it is paused."""

    committed: Collection[int]
    """Ids of the shots this session has stored."""
    skipped: Mapping[int, str]
    """Ids of the shots it has left out, and why."""
    n_left: int
    """How many shots are to come, the one in hand included."""
    n_retakes_left: int | None = None
    """How many of those stored can be taken again; None: all, and more than once."""
    suspension: Suspension | None = None
    """What the run was waiting for when it was paused."""

    def refusal_to_retake(self, shot_ids: Collection[int]) -> str | None:
        """Say why these shots cannot be taken again; None: they can."""
        early = [i for i in shot_ids if i not in self.committed and i not in self.skipped]
        if early:
            return (
                f"shots not taken yet in this session: {', '.join(map(str, early))};"
                " only those stored or skipped can be taken again"
            )
        n_rows = len({i for i in shot_ids if i in self.committed})
        if self.n_retakes_left is not None and n_rows > self.n_retakes_left:
            return (
                f"the dataset has room for {self.n_retakes_left} shots to be taken again, not"
                f" {n_rows}; after the run: tronlab run --retake DIR --shots LIST"
            )
        return None

    def __str__(self) -> str:
        """Say it in one line."""
        parts = [f"{len(self.committed)} shots are stored, {self.n_left} to come"]
        if self.skipped:
            parts.append(f"skipped: {', '.join(map(str, self.skipped))}")
        if self.suspension is not None:
            parts.append(str(self.suspension))
        return "; ".join(parts)


class Console(Protocol):
    """Asks a person."""

    def ask(self, pause: Pause) -> Decision:
        """Ask how the run goes on; blocks until there is an answer."""
        ...

    def dismiss(self) -> None:
        """Have ``ask``, in another thread, give up at once: the run has been stopped meanwhile."""
        ...


class TerminalConsole:
    """Asks at a terminal. The end of its input means abort."""

    def __init__(
        self,
        stdin: TextIO,
        stdout: TextIO,
        *,
        undisturbed: Callable[[], AbstractContextManager[object]] = nullcontext,
    ) -> None:
        """Take the streams to ask on.

        Args:
            stdin: Where answers come from.
            stdout: Where questions go.
            undisturbed: While one is open, nobody else writes to the terminal.
        """
        self._stdin = _Lines(stdin)
        self._stdout = stdout
        self._undisturbed = undisturbed

    def ask(self, pause: Pause) -> Decision:
        """Ask until there is an answer that makes sense."""
        with self._undisturbed():
            self._say(f"paused: {pause}\n")
            while True:
                self._say(f"{MENU} > ")
                line = self._stdin.read_line()
                if line is None:
                    self._say("\n")
                    return Abort()
                try:
                    return _decision(line, pause)
                except ValueError as error:
                    self._say(f"{error}\n")

    def dismiss(self) -> None:
        """Have ``ask`` give up at once."""
        self._stdin.close()

    def _say(self, text: str) -> None:
        self._stdout.write(text)
        self._stdout.flush()


class _Lines:
    """Lines of a stream that one can stop waiting for.

    A thread that is left in ``stdin.readline`` holds a lock that the interpreter needs at its end.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._is_closed = threading.Event()
        self._rest = b""
        try:
            self._fd: int | None = stream.fileno()
        except UnsupportedOperation:
            self._fd = None

    def close(self) -> None:
        """Read no more; a reader in another thread finds the end."""
        self._is_closed.set()

    def read_line(self) -> str | None:
        """Give the next line without its end; None at the end of the stream."""
        if self._fd is None:
            line = self._stream.readline()
            return line.rstrip("\n") if line else None
        while b"\n" not in self._rest:
            chunk = self._read(self._fd)
            if not chunk:
                return None
            self._rest += chunk
        line, _, self._rest = self._rest.partition(b"\n")
        return line.decode(errors="replace")

    def _read(self, fd: int) -> bytes:
        while not self._is_closed.is_set():
            if select.select([fd], [], [], _LOOK_UP_S)[0]:
                return os.read(fd, _CHUNK_BYTES)
        return b""


def _decision(line: str, pause: Pause) -> Decision:
    """Read an answer.

    Raises:
        ValueError: It makes no sense; the message says what would.
    """
    word, _, rest = line.strip().partition(" ")
    rest = rest.strip()
    match word.lower():
        case "r" | "resume":
            return Resume()
        case "t" | "take":
            return _retake(rest, pause)
        case "n" | "note":
            if not rest:
                raise ValueError("n: the text is missing, such as: n lamp housing touched")
            return Note(rest)
        case "a" | "abort":
            return Abort()
        case _:
            raise ValueError(f"'{word}' is none of: {MENU}")


def _retake(rest: str, pause: Pause) -> Retake:
    words = rest.replace(",", " ").split()
    wrong = [word for word in words if not word.isdecimal()]
    if wrong or not words:
        raise ValueError(f"t: '{rest}' are no shots; expected their numbers, such as: t 12 13")
    shot_ids = tuple(dict.fromkeys(int(word) for word in words))
    refusal = pause.refusal_to_retake(shot_ids)
    if refusal is not None:
        raise ValueError(f"t: {refusal}")
    return Retake(shot_ids)
