"""How a recording begins: with an empty dataset, or where an earlier session ended."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final
from uuid import uuid4

import h5py
import numpy as np

from tronlab.dataset import columns, places, schema, skeleton
from tronlab.dataset.admission import check_provenance
from tronlab.dataset.journal import Journal
from tronlab.dataset.master import Master
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Provenance, Session
from tronlab.dataset.segments import Segment, check_no_segments, plan_segments, segment_of
from tronlab.dataset.sessions import has_session, write_session
from tronlab.dataset.stored_shots import StoredShots
from tronlab.errors import DatasetError, IntegrityError

N_VERIFIED_ROWS: Final = 100
"""The last rows that are verified before a recording goes on: more than a power cut can damage."""


@dataclass(frozen=True, slots=True)
class Beginning:
    """What a recording begins with."""

    uuid: str
    shape: tuple[int, int]
    """Of the images."""
    room: int
    """Rows that there is room for."""
    n_shots_planned: int
    dtype: np.dtype[Any] | None = None
    """Of the images; None before the first one."""
    segments: tuple[Segment, ...] = ()
    n_rows: int = 0
    """Committed before; likewise below."""
    row_of: Mapping[int, int] = field(default_factory=dict[int, int])
    """The row of each shot."""
    has_references: bool = False
    reflectors: tuple[str, ...] = ()
    n_checks: int = 0


def begin(
    path: Path,
    provenance: Provenance,
    session: Session | None,
    *,
    n_spare_rows: int,
    has_segments: bool,
) -> tuple[Master, Beginning]:
    """Set up an empty dataset.

    Raises:
        DatasetError: The file exists, images of another dataset are where its own would be, it
            cannot be created, or the provenance makes no sense.
    """
    check_provenance(path, provenance)
    places.check_is_new(path)
    beginning = Beginning(
        uuid=str(uuid4()),
        shape=provenance.camera.shape,
        room=provenance.n_shots_planned + n_spare_rows,
        n_shots_planned=provenance.n_shots_planned,
    )

    master = Master(path)

    def build(file: h5py.File) -> None:
        if has_segments:
            check_no_segments(path)
        skeleton.create_skeleton(file, provenance, uuid=beginning.uuid, n_rows=beginning.room)
        if session is not None:
            write_session(file, session)

    try:
        master.create(build, beginning.room * columns.ROW_BYTES)
    except (OSError, RuntimeError, ValueError, TypeError) as error:
        raise DatasetError(f"{path}: cannot be set up: {error}") from error
    return master, beginning


def begin_again(
    path: Path,
    session: Session,
    *,
    n_rows: int,
    segment_shots: int,
    n_shots_planned: int | None,
) -> tuple[Master, Beginning]:
    """Set up a copy of a dataset for another session.

    Rows that a power cut damaged are dropped, and the journal says so.

    Raises:
        DatasetError: It cannot be read, has no segments, is of another version, or the session
            does not follow; or the disk does not take it.
    """
    found, sessions, damaged = _found(path, session)
    beginning = _with_room(path, found, n_rows=n_rows, segment_shots=segment_shots)
    if n_shots_planned is not None:
        beginning = replace(beginning, n_shots_planned=n_shots_planned)
    master = Master(path)
    try:
        master.copy()
        with master.structure(beginning.room * columns.ROW_BYTES) as file:
            _prepare(file, beginning, sessions)
        for row in damaged:
            _drop(master, row)
        master.write(schema.STATUS, b"running")
        master.write(schema.END_TIME, b"")
        master.write(schema.REASON, b"")
        master.write(schema.N_SHOTS_PLANNED, beginning.n_shots_planned)
    except (OSError, RuntimeError, ValueError, TypeError) as error:
        master.close()
        raise DatasetError(f"{path}: cannot be reopened: {error}") from error
    for row, shot_id in damaged.items():
        Journal(path).write(
            "dropped",
            f"row {row} (shot {shot_id}) was damaged, as by a power cut: it counts as not taken",
            shot_id=shot_id,
            row=row,
        )
    return master, beginning


def _found(
    path: Path, session: Session
) -> tuple[Beginning, tuple[Session, ...], Mapping[int, int]]:
    """Read what is in a dataset: where it stands, with which sessions, and what is damaged."""
    with Dataset(path) as dataset:
        if not dataset.can_go_on:
            raise DatasetError(
                f"{path}: nothing can be added: it is of layout {dataset.schema_version} and has"
                f" {len(dataset.segments)} segments; only a dataset as it was recorded, of layout"
                f" {schema.VERSION_TEXT}, can go on"
            )
        sessions, stored = dataset.sessions, dataset.stored
        if session.number != len(sessions) + 1:
            raise DatasetError(
                f"{path}: session {session.number} cannot follow session {len(sessions)}"
            )
        ids = stored.shot_ids.tolist()
        last = range(max(0, stored.n_rows - N_VERIFIED_ROWS), stored.n_rows)
        damaged = {row: ids[row] for row in last if not _is_whole(stored, row)}
        found = Beginning(
            uuid=dataset.uuid or "",
            shape=dataset.camera.shape,
            room=stored.room,
            n_shots_planned=dataset.provenance.n_shots_planned,
            dtype=dataset.image_dtype,
            segments=dataset.segments,
            n_rows=stored.n_rows,
            row_of={
                shot_id: row
                for row, shot_id in enumerate(ids)  # the last row of a shot counts
                if shot_id != schema.VOID_SHOT_ID and row not in damaged
            },
            has_references=dataset.n_references > 0,
            reflectors=dataset.drift_reflectors,
            n_checks=len(dataset.drift_checks),
        )
    return found, (*sessions, session), damaged


def _is_whole(stored: StoredShots, row: int) -> bool:
    """Tell whether a row fits its checksums.

    Raises:
        IntegrityError: The segment that comes next to be written cannot be read.
    """
    try:
        return stored.is_whole(row)
    except IntegrityError:
        # A full segment was forced to the disk: if it is lost, no power cut is to blame, the row
        # stays for the day it is put back, and its shot can be taken again.
        if segment_of(stored.segments, row).end_row > stored.n_rows:
            raise
        return stored.has_good_values(row)


def _with_room(
    path: Path,
    found: Beginning,
    *,
    n_rows: int,
    segment_shots: int,
) -> Beginning:
    """Add room; segments that hold rows already stay as they are."""
    room = max(found.room, found.n_rows + n_rows)
    kept = [segment for segment in found.segments if segment.first_row < found.n_rows]
    return replace(
        found,
        room=room,
        segments=plan_segments(path, kept, n_rows=room, segment_shots=segment_shots),
    )


def _prepare(file: h5py.File, beginning: Beginning, sessions: Sequence[Session]) -> None:
    skeleton.resize_rows(file, beginning.room)
    dtype = skeleton.dataset_at(file, schema.IMAGE).dtype
    skeleton.show_segments(file, beginning.segments, shape=beginning.shape, dtype=dtype)
    for session in sessions:
        if not has_session(file, session.number):
            write_session(file, session)


def _drop(master: Master, row: int) -> None:
    """Make a row void: it keeps its place, so that no other row moves."""
    for path, value in columns.void_row().items():
        master.write_row(path, row, value)
