"""What is in a dataset, in numbers: for people, and as JSON for programs."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tronlab.dataset import schema
from tronlab.dataset.journal import JournalEntry, read_journal
from tronlab.dataset.lock import LockHolder, lock_holder
from tronlab.dataset.places import journal_path
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import ErrorClass, QualityFlag, Session, ShotTiming

_BLOCK_BYTES: Final = 512
"""What the operating system counts the room of a file in."""


@dataclass(frozen=True, slots=True)
class Course:
    """How the recording went, as the shots and the journal tell."""

    sessions: tuple[Session, ...]
    skipped: Mapping[int, str]
    """Why a shot is not there, by its id; those taken later are left out."""
    flagged: Mapping[QualityFlag, tuple[int, ...]]
    """Ids of the shots that a quality gate held something against, by what."""
    n_superseded: int
    """Rows of shots that were taken again."""
    n_failures: Mapping[ErrorClass, int]
    """Attempts at the shots in the file that came to nothing, by class of error."""
    timing_s: Mapping[str, float]
    """Time that the parts of the shots took together; empty if it was not recorded."""
    notes: tuple[JournalEntry, ...]
    writer: LockHolder | None
    """Who records into it now."""
    n_files: int
    """Of the dataset: its own, its segments and its journal."""
    n_bytes: int
    """On the disk, holes not counted."""


def course_of(dataset: Dataset) -> Course:
    """Read how the recording of a dataset went."""
    entries = read_journal(dataset.path)
    files = files_of(dataset)
    return Course(
        sessions=dataset.sessions,
        skipped=skipped_shots(dataset, entries),
        flagged=flagged_shots(dataset),
        n_superseded=len(dataset.superseded_rows),
        n_failures=_failures(dataset),
        timing_s=_timing(dataset),
        notes=tuple(entry for entry in entries if entry.kind == "note"),
        writer=lock_holder(dataset.path),
        n_files=len(files),
        n_bytes=bytes_on_disk(files),
    )


def skipped_shots(dataset: Dataset, entries: Iterable[JournalEntry]) -> dict[int, str]:
    """Give the shots that were given up and are still missing: why, by id."""
    taken = set(dataset.shot_ids.tolist())
    skipped = {
        shot_id: entry.text.removeprefix(f"shot {shot_id}: ")
        for entry in entries
        # anyone may write into the journal, and anything
        if entry.kind == "skipped" and isinstance(shot_id := entry.fields.get("shot_id"), int)
    }
    return {shot_id: why for shot_id, why in sorted(skipped.items()) if shot_id not in taken}


def flagged_shots(dataset: Dataset) -> dict[QualityFlag, tuple[int, ...]]:
    """Give the ids of the shots with a flag, by flag; flags that no shot has are left out."""
    bits = known_rows(dataset, schema.QUALITY_FLAGS)
    if bits is None:
        return {}
    flagged: dict[QualityFlag, tuple[int, ...]] = {}
    for k, flag in enumerate(schema.QUALITY_FLAG_NAMES):
        if shot_ids := dataset.shot_ids[(bits >> k & 1).astype(np.bool_)].tolist():
            flagged[flag] = tuple(shot_ids)
    return flagged


def known_rows(dataset: Dataset, path: str) -> NDArray[Any] | None:
    """Read one column of all shots; None if the file, of an older layout, lacks it."""
    is_there = any(column.path == path for column in dataset.columns())
    return dataset.rows(path) if is_there else None


def calibrated_utc(calibration_json: str) -> str:
    """Give when a calibration record was made, as far as it says; else an empty text."""
    try:
        record: Any = json.loads(calibration_json)
    except json.JSONDecodeError:
        return ""
    return str(record.get("created_utc", "")) if isinstance(record, dict) else ""


def files_of(dataset: Dataset) -> list[Path]:
    """Give the files that a dataset consists of."""
    segments = (dataset.path.parent / segment.name for segment in dataset.segments)
    files = (dataset.path, *segments, journal_path(dataset.path))
    return [file for file in files if file.is_file()]


def bytes_on_disk(files: Iterable[Path]) -> int:
    """Give how much room files take on the disk; holes take none."""
    return sum(file.stat().st_blocks * _BLOCK_BYTES for file in files)


def _failures(dataset: Dataset) -> dict[ErrorClass, int]:
    rows = known_rows(dataset, schema.N_FAILURES)
    if rows is None:
        return {}
    counts = rows.sum(axis=0, dtype=np.int64).tolist()
    return {kind: n for kind, n in zip(schema.ERROR_CLASSES, counts, strict=True) if n}


def _timing(dataset: Dataset) -> dict[str, float]:
    names = [field.name for field in fields(ShotTiming)]
    parts = {name: known_rows(dataset, f"{schema.TIMING}/{name}") for name in names}
    return {
        name: float(np.nansum(part_s))
        for name, part_s in parts.items()
        if part_s is not None and np.isfinite(part_s).any()
    }
