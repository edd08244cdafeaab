"""The journal of a dataset: what happened while it was recorded, and what people noted.

One JSON object a line, only ever appended: several processes may write, and a line cut short by a
power cut harms no other.
"""

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import h5py

from tronlab.dataset import schema
from tronlab.dataset.places import journal_path, sync_folder
from tronlab.dataset.skeleton import utc_now
from tronlab.errors import DatasetError

__all__ = ["Journal", "JournalEntry", "journal_path", "parse_journal", "read_journal"]

_HEAD: Final = ("time_utc", "kind", "text")


@dataclass(frozen=True, slots=True)
class JournalEntry:
    """One line of the journal."""

    time_utc: str
    """ISO 8601."""
    kind: str
    """As ``note``, ``session``, ``retry``, ``skipped``, ``suspended`` or ``dropped``."""
    text: str
    """For people."""
    fields: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """For programs, as ``shot_id``."""


class Journal:
    """Appends to the journal of a dataset."""

    def __init__(self, dataset_path: Path) -> None:
        """Remember whose journal it is; the file is made with the first entry."""
        self.path = journal_path(dataset_path)

    def write(self, kind: str, text: str, **fields: Any) -> None:
        """Append an entry; when this returns, a power cut does not lose it.

        Args:
            kind: What sort of entry.
            text: For people.
            fields: More values that JSON knows, for programs.

        Raises:
            DatasetError: The disk does not take it.
        """
        entry = {"time_utc": utc_now(), "kind": kind, "text": text, **fields}
        line = json.dumps(entry, ensure_ascii=False) + "\n"
        try:
            _append(self.path, line.encode(errors="replace"))
        except OSError as error:
            raise DatasetError(f"{self.path}: cannot be written: {error.strerror}") from error


def read_journal(dataset_path: Path) -> tuple[JournalEntry, ...]:
    """Read the journal of a dataset: what is in its file, as in a packed one, then the one beside.

    Lines that are not whole are left out.

    Raises:
        DatasetError: The journal cannot be read.
    """
    beside = journal_path(dataset_path)
    try:
        text = beside.read_text(encoding="utf-8", errors="replace") if beside.exists() else ""
    except OSError as error:
        raise DatasetError(f"{beside}: cannot be read: {error.strerror}") from error
    return (*parse_journal(_embedded(dataset_path)), *parse_journal(text))


def parse_journal(text: str) -> tuple[JournalEntry, ...]:
    """Give the entries of a journal's text; lines that are not whole are left out."""
    return tuple(_entries(text.split("\n")))


def _entries(lines: Iterable[str]) -> Iterable[JournalEntry]:
    for line in lines:
        try:
            values = json.loads(line)
        except json.JSONDecodeError:
            continue
        if not isinstance(values, dict) or not all(name in values for name in _HEAD):
            continue
        head = {name: str(values.pop(name)) for name in _HEAD}
        yield JournalEntry(**head, fields=values)


def _append(path: Path, line: bytes) -> None:
    is_new = not path.exists()
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
    try:
        # An entry that was cut short must not swallow this one.
        size = os.fstat(descriptor).st_size
        if size and os.pread(descriptor, 1, size - 1) != b"\n":
            line = b"\n" + line
        n_written = os.write(descriptor, line)
        if n_written < len(line):
            os.write(descriptor, line[n_written:])  # says why it does not go on
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    if is_new:
        sync_folder(path.parent)


def _embedded(dataset_path: Path) -> str:
    if not dataset_path.is_file():
        return ""
    try:
        with h5py.File(dataset_path, "r") as file:
            value = file[schema.JOURNAL][()] if schema.JOURNAL in file else b""  # pyright: ignore
    except (OSError, KeyError, RuntimeError) as error:
        raise DatasetError(f"{dataset_path}: its journal cannot be read: {error}") from error
    return bytes(value).decode(errors="replace")  # pyright: ignore[reportArgumentType]
