"""A dataset of any readable layout written anew, as one file of the present layout."""

import json
import math
import os
from collections.abc import Callable, Generator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeAlias
from uuid import uuid4

import h5py
import numpy as np
from numpy.typing import NDArray

from tronlab.dataset import columns, schema, skeleton
from tronlab.dataset.admission import drift_values_of
from tronlab.dataset.compression import chunk_options, fill_stack
from tronlab.dataset.hdf5 import Hdf5Reader
from tronlab.dataset.journal import read_journal
from tronlab.dataset.lock import lock_holder
from tronlab.dataset.opening import open_dataset
from tronlab.dataset.places import probe_room
from tronlab.dataset.reader import Dataset
from tronlab.dataset.sessions import write_session
from tronlab.dataset.skeleton import dataset_at
from tronlab.errors import DatasetError, IntegrityError

OnStage: TypeAlias = Callable[[str, int, int], None]
"""Told the name of a stage, how much of it is done, and of how much."""

_BYTES_PER_PIXEL_OF_VIEW: Final = 6
"""Of a reference view: image, depth and mask."""


@dataclass(frozen=True, slots=True)
class _Original:
    """A dataset that is written anew."""

    dataset: Dataset
    file: Hdf5Reader
    """The same, for what a dataset does not give."""
    rows: NDArray[np.int64]
    """Those that are taken over, shape (n,)."""


def transcribe(
    source: Path,
    target: Path,
    *,
    level: int | None = None,
    keeps_all_rows: bool = False,
    uuid: str | None = None,
    on_stage: OnStage,
) -> None:
    """Write a dataset anew: the same values and images, in one file of the present layout.

    Args:
        source: The dataset; it stays as it is.
        target: The new file; ``tronlab.dataset.whole_file`` sees that nothing is left of half one.
        level: How much images are compressed, 1 to 9; None: not at all.
        keeps_all_rows: Whether superseded rows are taken over too.
        uuid: Of a dataset that becomes another one; None: it stays the same dataset.
        on_stage: Told how far it is.

    Raises:
        DatasetError: The dataset cannot be read, is being recorded, or a newer version wrote it.
        IntegrityError: Something in it is damaged: a new file would hide that for ever.
        OSError, RuntimeError: The disk does not take it.
    """
    with _opened(source, keeps_all_rows=keeps_all_rows) as original:
        # On a full disk HDF5 cannot even close a file: it must not come to that.
        probe_room(target, _n_bytes(original, level))
        with h5py.File(target, "w") as file:
            _write(file, original, level, uuid)
            _write_images(file, original, level, target, on_stage)
            dataset_at(file, schema.N_COMMITTED)[()] = len(original.rows)


def _write(file: h5py.File, original: _Original, level: int | None, uuid: str | None) -> None:
    """Write everything but the images of the shots."""
    skeleton.create_skeleton(
        file,
        original.dataset.provenance,
        uuid=uuid or original.dataset.uuid or str(uuid4()),
        n_rows=len(original.rows),
    )
    _write_story(file, original)
    _write_journal(file, original)
    _write_columns(file, original)
    _write_drift(file, original)
    _write_references(file, original, level)


@contextmanager
def _opened(source: Path, *, keeps_all_rows: bool) -> Generator[_Original]:
    if (holder := lock_holder(source)) is not None:
        raise DatasetError(f"{source}: is being recorded by {holder}; wait until that has ended")
    with Dataset(source) as dataset, closing(Hdf5Reader(source, open_dataset(source))) as file:
        _refuse_newer(dataset)
        superseded = dataset.superseded_rows if keeps_all_rows else ()
        _refuse_damaged(dataset, superseded)
        rows = np.array(sorted((*dataset.row_numbers, *superseded)), np.int64)
        yield _Original(dataset, file, rows)


def _refuse_newer(dataset: Dataset) -> None:
    version = tuple(map(int, dataset.schema_version.split(".")))
    if version > schema.SCHEMA_VERSION:
        raise DatasetError(
            f"{dataset.path}: is of layout {dataset.schema_version}, this tronlab knows"
            f" {schema.VERSION_TEXT} and would lose what is new in it; use a newer tronlab"
        )


def _refuse_damaged(dataset: Dataset, superseded: tuple[int, ...]) -> None:
    damaged = list(dataset.shots_with_damaged_values())
    damaged += [
        int(dataset.stored.shot_ids[row])
        for row in superseded
        if not dataset.stored.has_good_values(row)
    ]
    if damaged:
        raise IntegrityError(
            f"{dataset.path}: the values of shots {', '.join(map(str, damaged))} are damaged:"
            " their checksums do not match; fetch the file again from its source"
        )


def _write_story(file: h5py.File, original: _Original) -> None:
    """Write when the dataset was recorded, by whom, and how that ended."""
    texts = ("entry/start_time", "entry/recording/version")
    for path in texts:
        dataset_at(file, path)[()] = original.file.text(path)
    for path in (schema.END_TIME, schema.REASON, schema.STATUS):
        stored = dataset_at(file, path)
        stored[()] = skeleton.shortened(original.file.text(path), stored.dtype.itemsize)
    for session in original.dataset.sessions:
        write_session(file, session)
    if (recomputation := original.dataset.provenance.recomputation) is not None:
        group = file.create_group(schema.RECOMPUTED)
        group.attrs["NX_class"] = schema.OPTIONAL_GROUPS[schema.RECOMPUTED]
        for name, text in asdict(recomputation).items():
            group[name] = text


def _write_journal(file: h5py.File, original: _Original) -> None:
    """Write the journal into the file; lines that were cut short are left out."""
    entries = read_journal(original.dataset.path)
    if not entries:
        return
    lines = [
        {"time_utc": entry.time_utc, "kind": entry.kind, "text": entry.text, **entry.fields}
        for entry in entries
    ]
    path, _, name = schema.JOURNAL.rpartition("/")
    group = file.create_group(path)
    group.attrs["NX_class"] = schema.OPTIONAL_GROUPS[path]
    group["type"] = "application/jsonl"
    group[name] = "".join(f"{json.dumps(line)}\n" for line in lines)


def _write_columns(file: h5py.File, original: _Original) -> None:
    for column in columns.ROW_COLUMNS:
        dataset_at(file, column.path)[...] = _rows_of(column, original)
    values = [dataset_at(file, path)[()] for path in columns.VALUES_ORDER]
    # A slice keeps the stored type, an index would make a Python value of a text.
    dataset_at(file, schema.VALUES_CRC32)[...] = [
        columns.checksum(rows[i : i + 1] for rows in values) for i in range(len(original.rows))
    ]


def _rows_of(column: columns.Column, original: _Original) -> NDArray[Any]:
    """Give the rows of a column that are taken over; what an older file lacks is filled in."""
    if column.path == schema.SESSION:
        return original.dataset.stored.sessions()[original.rows]
    if column.path not in original.file:
        return np.full((len(original.rows), *column.shape), column.fill, column.dtype)
    values = original.dataset.stored.column(column.path)
    if column.path == schema.SUPERSEDES:
        return _renumbered(values, original.rows)
    return values[original.rows]


def _renumbered(supersedes: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Say of the rows that are taken over which of them they supersede."""
    new_row = {int(row): i for i, row in enumerate(rows)}
    return np.array(
        [new_row.get(int(earlier), schema.NO_ROW) for earlier in supersedes[rows]], np.int64
    )


def _write_drift(file: h5py.File, original: _Original) -> None:
    checks, reflectors = original.dataset.drift_checks, original.dataset.drift_reflectors
    if not checks:
        return
    skeleton.create_drift(file, reflectors, len(checks))
    for k, check in enumerate(checks):
        n_before = int(np.count_nonzero(original.rows < check.n_shots_before))
        renumbered = replace(check, n_shots_before=n_before)
        values = drift_values_of(original.dataset.path, renumbered, reflectors)
        for path, value in values.items():
            dataset_at(file, path)[k] = value
        dataset_at(file, schema.DRIFT_CRC32)[k] = columns.checksum(values.values())
    dataset_at(file, schema.N_DRIFT_CHECKS)[()] = len(checks)


def _write_references(file: h5py.File, original: _Original, level: int | None) -> None:
    for i in range(original.dataset.n_references):
        original.dataset.reference(i)  # whatever is damaged is refused
    if not original.dataset.n_references:
        return
    group = file.create_group(schema.REFERENCES)
    group.attrs["NX_class"] = schema.OPTIONAL_GROUPS[schema.REFERENCES]
    for path in (
        *(f"{schema.REFERENCES}/{name}" for name in schema.REFERENCE_VALUES),
        schema.REFERENCES_CRC32,
    ):
        stored = original.file.at(path)
        storage = chunk_options(stored.shape, level) if stored.ndim == 3 else {}
        written = file.create_dataset(path, stored.shape, stored.dtype, **storage)
        written.attrs.update(stored.attrs)
        for i in range(len(stored)):
            written[i] = stored[i]


def _write_images(
    file: h5py.File, original: _Original, level: int | None, target: Path, on_stage: OnStage
) -> None:
    """Write images and masks; each is verified when it is read."""
    dtype = original.dataset.image_dtype
    if dtype is None:
        return
    shape = (len(original.rows), *original.dataset.camera.shape)
    if level is None:
        skeleton.create_images(file, n_rows=shape[0], shape=shape[1:], dtype=dtype)
    else:
        for path, kind in ((schema.IMAGE, dtype), (schema.MASK, np.dtype(np.uint8))):
            file.create_dataset(path, shape, kind, **chunk_options(shape, level))
        skeleton.describe_images(file)
    sources = {
        "images": (schema.IMAGE, original.dataset.stored.image),
        "masks": (schema.MASK, original.dataset.stored.mask),
    }
    room = (os.cpu_count() or 1) * math.prod(shape[1:]) * dtype.itemsize
    for stage, (path, read) in sources.items():
        images = (read(int(row)) for row in original.rows)
        on_stage(stage, 0, shape[0])
        probe_room(target, room)
        for n_done in fill_stack(dataset_at(file, path), images):
            on_stage(stage, n_done, shape[0])
            probe_room(target, room)


def _n_bytes(original: _Original, level: int | None) -> int:
    """Give how much room there must be at the start; what images are compressed to is not known."""
    dataset = original.dataset
    n_pixels = math.prod(dataset.camera.shape)
    of_images = n_pixels * (dataset.image_dtype.itemsize + 1) if dataset.image_dtype else 0
    of_view = n_pixels * _BYTES_PER_PIXEL_OF_VIEW
    of_row = columns.ROW_BYTES + (of_images if level is None else 0)
    return len(original.rows) * of_row + dataset.n_references * of_view


def verify(path: Path, *, on_stage: OnStage) -> None:
    """Read back everything that was written.

    Raises:
        IntegrityError: The disk gave back something else.
    """
    with Dataset(path) as dataset:
        if damaged := dataset.shots_with_damaged_values():
            raise IntegrityError(f"{path}: the values of shots {damaged} were not written well")
        try:
            _ = dataset.drift_checks
            for i in range(dataset.n_references):
                dataset.reference(i)
            for row in range(dataset.n_rows):
                dataset.stored.image(row)
                dataset.stored.mask(row)
                on_stage("verified", row + 1, dataset.n_rows)
        except IntegrityError as error:
            raise IntegrityError(
                f"{error.args[0]}\nthat is the new file: the disk did not keep what was written"
            ) from error


def silent(stage: str, n_done: int, n_all: int) -> None:
    """Tell nobody."""
    del stage, n_done, n_all
