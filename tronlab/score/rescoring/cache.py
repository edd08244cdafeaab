"""Answers of cores kept from one scoring to the next, in one SQLite file.

Only the process that leads a scoring reads and writes it; several may at once. What is in it was
written whole: a process that is killed loses nothing that it had kept. Every entry has a checksum;
what is damaged is forgotten, and so is the whole file if SQLite cannot make sense of it.
"""

import sqlite3
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import platformdirs

from tronlab.score.rescoring.packing import PackingError, unpack

LAYOUT = 1
"""Part of the file's name; raised with every change of the layout or of what a packed answer is."""
MOST_BYTES = 2 << 30
"""So much is kept; then those go that were not used for longest."""

_SHARE_KEPT = 0.8
"""Of ``MOST_BYTES``, when some have to go."""
_WAIT_S = 10.0
"""For another process to finish its writing."""
_AT_ONCE = 500
"""Keys in one question; SQLite's limit was 999 once."""
_TABLE = """
create table if not exists answers (
    key text primary key, used_s real not null, n_bytes integer not null, packed blob not null
) without rowid
"""
_BY_AGE = "create index if not exists by_age on answers (used_s, n_bytes)"
_SUM = "select coalesce(sum(n_bytes), 0) from answers"


def usual_cache_folder() -> Path:
    """Give where answers and the results of stages are kept unless told otherwise."""
    return platformdirs.user_cache_path("tronlab") / "score"


class AnswerCache:
    """Packed answers by key. One that cannot be used keeps nothing, and says so once."""

    def __init__(
        self, folder: Path, *, say: Callable[[str], None], most_bytes: int = MOST_BYTES
    ) -> None:
        self.path = folder / f"answers-{LAYOUT}.sqlite"
        self._say = say
        self._most_bytes = most_bytes
        self._database = self._opened()
        self._n_bytes = self._sum_of_bytes()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; may be called twice."""
        if self._database is not None:
            with suppress(sqlite3.Error):
                self._database.close()
            self._database = None

    def count(self) -> int:
        """Give how many answers are kept."""
        if self._database is None:
            return 0
        return int(self._database.execute("select count(*) from answers").fetchone()[0])

    def find(self, keys: Sequence[str]) -> dict[str, bytes]:
        """Give the answers that are kept, by key."""
        found: dict[str, bytes] = {}
        try:
            for start in range(0, len(keys), _AT_ONCE):
                found |= self._sound(self._select(keys[start : start + _AT_ONCE]))
            self._touch(found)
        except sqlite3.Error as error:
            self._give_up(error)
        return found

    def keep(self, answers: Mapping[str, bytes]) -> None:
        """Keep packed answers."""
        if self._database is None or not answers:
            return
        now_s = time.time()
        rows = [(key, now_s, len(packed), packed) for key, packed in answers.items()]
        try:
            with self._database as database:
                database.executemany("insert or replace into answers values (?, ?, ?, ?)", rows)
            self._n_bytes += sum(map(len, answers.values()))
            if self._n_bytes > self._most_bytes:
                self._drop_oldest()
        except sqlite3.Error as error:
            self._give_up(error)

    def _select(self, keys: Sequence[str]) -> dict[str, bytes]:
        if self._database is None:
            return {}
        marks = ", ".join("?" * len(keys))
        question = f"select key, packed from answers where key in ({marks})"  # noqa: S608
        return dict(self._database.execute(question, list(keys)))

    def _sound(self, answers: Mapping[str, bytes]) -> dict[str, bytes]:
        sound: dict[str, bytes] = {}
        for key, packed in answers.items():
            with suppress(PackingError):
                unpack(packed)
                sound[key] = packed
        if len(sound) < len(answers):
            n = len(answers) - len(sound)
            self._say(f"{self.path}: {n} kept answers are damaged and are computed anew")
        return sound

    def _touch(self, answers: Mapping[str, bytes]) -> None:
        if self._database is None or not answers:
            return
        now_s = time.time()
        with self._database as database:
            database.executemany(
                "update answers set used_s = ? where key = ?", [(now_s, key) for key in answers]
            )

    def _drop_oldest(self) -> None:
        if self._database is None:
            return
        spare = self._sum_of_bytes() - _SHARE_KEPT * self._most_bytes
        with self._database as database:
            gone: list[tuple[str]] = []
            for key, n_bytes in database.execute(
                "select key, n_bytes from answers order by used_s"
            ):
                if spare <= 0:
                    break
                spare -= n_bytes
                gone.append((key,))
            database.executemany("delete from answers where key = ?", gone)
        self._n_bytes = self._sum_of_bytes()

    def _sum_of_bytes(self) -> int:
        if self._database is None:
            return 0
        ((n_bytes,),) = self._database.execute(_SUM)
        return int(n_bytes)

    def _opened(self) -> sqlite3.Connection | None:
        """Open the file; begin it anew if it is damaged; None if it cannot be had."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            try:
                return _open(self.path)
            except sqlite3.OperationalError:
                raise
            except sqlite3.DatabaseError as error:
                self._say(f"{self.path}: kept answers are damaged and are forgotten: {error}")
                _remove(self.path)
                return _open(self.path)
        except (OSError, sqlite3.Error) as error:
            self._say(f"{self.path}: no answers are kept: {error}")
            return None

    def _give_up(self, error: sqlite3.Error) -> None:
        """Go on without; a damaged file goes, so that the next scoring begins a new one."""
        self._say(f"{self.path}: no answers are kept from here on: {error}")
        self.close()
        if not isinstance(error, sqlite3.OperationalError):
            with suppress(OSError):
                _remove(self.path)


def _open(path: Path) -> sqlite3.Connection:
    database = sqlite3.connect(path, timeout=_WAIT_S)
    try:
        # With a log a commit need not wait for the disk, and readers need not wait for writers.
        database.execute("pragma journal_mode = wal")
        database.execute("pragma synchronous = normal")
        with database:
            database.execute(_TABLE)
            database.execute(_BY_AGE)
        database.execute(_SUM).fetchone()
    except BaseException:
        database.close()
        raise
    return database


def _remove(path: Path) -> None:
    for name in (path.name, f"{path.name}-wal", f"{path.name}-shm"):
        path.with_name(name).unlink(missing_ok=True)
