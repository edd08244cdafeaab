"""Segments: the files that hold images and masks of so many rows each.

A full segment never changes again, so that a dataset can be copied elsewhere while it grows. The
dataset's own file shows all segments as one stack to viewers; that view turns black where a
segment is missing, so tronlab itself opens the segments and says what is wrong with them.
"""

import os
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import h5py
import numpy as np
from numpy.typing import NDArray

from tronlab.dataset import schema
from tronlab.dataset.places import images_folder, part_of, probe_room, put_in_place, remove
from tronlab.errors import DatasetError, IntegrityError

_N_OPEN: Final = 4
"""Segments that are kept open: whoever reads shots in their order needs one."""

STACKS: Final = {schema.IMAGE: schema.SEGMENT_IMAGE, schema.MASK: schema.SEGMENT_MASK}
"""Where the dataset has a stack, and where its segments have their part of it."""


@dataclass(frozen=True, slots=True)
class Segment:
    """The rows whose images are in one file."""

    name: str
    """Of the file, relative to the folder of the dataset."""
    first_row: int
    n_rows: int

    @property
    def end_row(self) -> int:
        """Get the first row behind it."""
        return self.first_row + self.n_rows


def plan_segments(
    dataset_path: Path, kept: Sequence[Segment], *, n_rows: int, segment_shots: int
) -> tuple[Segment, ...]:
    """Divide the rows of a dataset into segments.

    Args:
        dataset_path: The dataset.
        kept: Those that hold rows already; they stay as they are.
        n_rows: Of the dataset.
        segment_shots: How many rows a new segment has; the last one has what is left.
    """
    folder = images_folder(dataset_path).name
    first = kept[-1].end_row if kept else 0
    new = (
        Segment(f"{folder}/{number:04d}.h5", row, min(segment_shots, n_rows - row))
        for number, row in enumerate(range(first, n_rows, segment_shots), start=len(kept) + 1)
    )
    return (*kept, *new)


def segment_of(segments: Sequence[Segment], row: int) -> Segment:
    """Give the segment of a row.

    Raises:
        IntegrityError: There is none.
    """
    k = bisect_right(segments, row, key=lambda segment: segment.first_row) - 1
    if k < 0 or row >= segments[k].end_row:
        raise IntegrityError(f"no segment holds row {row}")
    return segments[k]


def write_segment_table(file: h5py.File, segments: Sequence[Segment]) -> None:
    """Say in a dataset which rows are in which file; what was said before is replaced."""
    if schema.SEGMENTS in file:
        del file[schema.SEGMENTS]
    group = file.create_group(schema.SEGMENTS)
    group.attrs["NX_class"] = schema.OPTIONAL_GROUPS[schema.SEGMENTS]
    group["file"] = [segment.name for segment in segments]
    for name in ("first_row", "n_rows"):
        numbers = np.array([getattr(segment, name) for segment in segments], "<i8")
        group.create_dataset(name, data=numbers).attrs["units"] = "1"


def write_virtual_stacks(
    file: h5py.File, segments: Sequence[Segment], *, shape: tuple[int, int], dtype: np.dtype[Any]
) -> None:
    """Let a dataset show the images of its segments as one stack; an older view is replaced."""
    types = {schema.IMAGE: dtype, schema.MASK: np.dtype(np.uint8)}
    for path, within in STACKS.items():
        layout = h5py.VirtualLayout((segments[-1].end_row, *shape), dtype=types[path])
        for segment in segments:
            rows = slice(segment.first_row, segment.end_row)
            layout[rows] = h5py.VirtualSource(
                segment.name, within, (segment.n_rows, *shape), dtype=types[path]
            )
        if path in file:
            del file[path]
        file.create_virtual_dataset(path, layout)


def create_segment(
    dataset_path: Path,
    segment: Segment,
    *,
    uuid: str,
    shape: tuple[int, int],
    dtype: np.dtype[Any],
) -> Path:
    """Make the file of a segment, with room for all its images.

    Raises:
        DatasetError: The file of another dataset is in its place.
        OSError, RuntimeError: The disk does not take it.
    """
    path = dataset_path.parent / segment.name
    path.parent.mkdir(exist_ok=True)
    _refuse_foreign(path, dataset_path, uuid)
    part = part_of(path)
    remove(part)
    try:
        n_bytes = segment.n_rows * int(np.prod(shape)) * (dtype.itemsize + 1)
        probe_room(part, n_bytes)
        with h5py.File(part, "w") as file:
            _fill_segment(file, segment, uuid=uuid, shape=shape, dtype=dtype)
        with part.open("rb") as made:
            os.fsync(made.fileno())
        put_in_place(part, path)
    except BaseException:
        remove(part)
        raise
    return path


def uuid_of(path: Path) -> str | None:
    """Give the dataset that a file belongs to, or is; None if it does not say."""
    try:
        with h5py.File(path, "r", locking=False) as file:
            value = file[schema.UUID][()]  # pyright: ignore[reportIndexIssue]
    except (OSError, KeyError, RuntimeError):
        return None
    return value.decode(errors="replace") if isinstance(value, bytes) else None


def is_segment(
    path: Path, segment: Segment, *, uuid: str, shape: tuple[int, int], dtype: np.dtype[Any]
) -> bool:
    """Tell whether a file is there that has room for the images of a segment, and is that one."""
    if uuid_of(path) != uuid:
        return False
    try:
        with h5py.File(path, "r") as file:
            image = cast(h5py.Dataset, file[schema.SEGMENT_IMAGE])
            first_row = int(cast(h5py.Dataset, file["entry/first_row"])[()])
            return (first_row, image.shape, image.dtype) == (
                segment.first_row,
                (segment.n_rows, *shape),
                dtype,
            )
    except (OSError, RuntimeError, KeyError, AttributeError):
        return False


def check_no_segments(dataset_path: Path) -> None:
    """Check that no images of another dataset are where a new one puts its own.

    Raises:
        DatasetError: There are some.
    """
    for path in sorted(images_folder(dataset_path).glob("*.h5")):
        raise _foreign(path, dataset_path)


def _refuse_foreign(path: Path, dataset_path: Path, uuid: str) -> None:
    if path.exists() and uuid_of(path) != uuid:
        raise _foreign(path, dataset_path)


def _foreign(path: Path, dataset_path: Path) -> DatasetError:
    return DatasetError(
        f"{path}: is there already and does not belong to {dataset_path}; move the folder"
        f" {path.parent} elsewhere"
    )


def _fill_segment(
    file: h5py.File, segment: Segment, *, uuid: str, shape: tuple[int, int], dtype: np.dtype[Any]
) -> None:
    file.attrs.update({"NX_class": "NXroot", "default": "entry", "creator": "tronlab"})
    entry = file.create_group("entry")
    entry.attrs.update({"NX_class": "NXentry", "default": "data"})
    entry["entry_identifier_uuid"] = uuid
    entry.create_dataset("first_row", data=np.int64(segment.first_row)).attrs["units"] = "1"
    plot = entry.create_group("data")
    plot.attrs.update({"NX_class": "NXdata", "signal": "image"})
    types = {schema.SEGMENT_IMAGE: dtype, schema.SEGMENT_MASK: np.dtype(np.uint8)}
    for path, kind in types.items():
        create_stack(file, path, (segment.n_rows, *shape), kind)


def create_stack(
    file: h5py.File, path: str, shape: tuple[int, ...], dtype: np.dtype[Any]
) -> h5py.Dataset:
    """Make room for a stack of images; it occupies disk only where it is written."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    stack = file.create_dataset(path, shape=shape, dtype=dtype, dcpl=properties)
    stack.attrs["units"] = "1"
    return stack


class SegmentReader:
    """Reads images and masks from the segments of a dataset, a few of them open at a time."""

    def __init__(self, dataset_path: Path, uuid: str, segments: Sequence[Segment]) -> None:
        """Remember where they are; none is opened yet."""
        self._path = dataset_path
        self._uuid = uuid
        self._segments = tuple(segments)
        self._open: OrderedDict[Segment, h5py.File] = OrderedDict()

    def read(self, path: str, row: int) -> NDArray[Any]:
        """Read image or mask (``schema.IMAGE``, ``schema.MASK``) of a row.

        Raises:
            IntegrityError: The segment is missing, damaged, or of another dataset.
        """
        try:
            segment = segment_of(self._segments, row)
        except IntegrityError as error:
            raise IntegrityError(f"{self._path}: {error}") from None
        file = self._file(segment)
        try:
            return cast(h5py.Dataset, file[STACKS[path]])[row - segment.first_row]
        except (OSError, RuntimeError, ValueError, KeyError) as error:
            raise self._damage(segment, f"cannot be read, it is damaged (HDF5: {error})") from error

    def close(self) -> None:
        """Close all segments; may be called twice."""
        while self._open:
            self._open.popitem()[1].close()

    def _file(self, segment: Segment) -> h5py.File:
        if segment not in self._open:
            self._open[segment] = self._opened(segment)
            if len(self._open) > _N_OPEN:
                self._open.popitem(last=False)[1].close()
        self._open.move_to_end(segment)
        return self._open[segment]

    def _opened(self, segment: Segment) -> h5py.File:
        place = self._path.parent / segment.name
        if not place.exists():
            raise self._damage(
                segment, f"is missing; copy it to {place.parent} from where the dataset came from"
            )
        try:
            file = h5py.File(place, "r")
        except (OSError, RuntimeError) as error:
            raise self._damage(
                segment, f"cannot be opened; fetch it again from its source (HDF5: {error})"
            ) from error
        try:
            self._check(segment, file)
        except BaseException:
            file.close()
            raise
        return file

    def _check(self, segment: Segment, file: h5py.File) -> None:
        try:
            uuid = bytes(cast(h5py.Dataset, file[schema.UUID])[()]).decode()
            first_row = int(cast(h5py.Dataset, file["entry/first_row"])[()])
            lengths = {len(cast(h5py.Dataset, file[path])) for path in STACKS.values()}
        except (OSError, RuntimeError, ValueError, TypeError, KeyError) as error:
            raise self._damage(segment, f"is no segment or damaged (HDF5: {error})") from error
        if uuid != self._uuid:
            raise self._damage(
                segment, f"belongs to another dataset (uuid {uuid}, expected {self._uuid})"
            )
        if (first_row, lengths) != (segment.first_row, {segment.n_rows}):
            raise self._damage(segment, f"is another segment: its first row is {first_row}")

    def _damage(self, segment: Segment, what: str) -> IntegrityError:
        place = self._path.parent / segment.name
        rows = f"rows {segment.first_row} to {segment.end_row - 1}"
        return IntegrityError(f"{self._path}: the images of {rows} are in {place}, which {what}")
