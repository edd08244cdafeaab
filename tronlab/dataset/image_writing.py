"""Where the images of a recording go: into segments, or into the dataset's own file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tronlab.dataset import schema
from tronlab.dataset.inplace import InPlaceFile
from tronlab.dataset.master import Master
from tronlab.dataset.segments import Segment, create_segment, is_segment, segment_of
from tronlab.errors import DatasetError


class ImageWriter(Protocol):
    """Stores image and mask of one row after the other."""

    dtype: np.dtype[Any]
    """Of the images."""

    def write(self, row: int, image: NDArray[Any], mask: NDArray[np.uint8]) -> None:
        """Store image and mask; raises ``OSError`` or ``RuntimeError`` if the disk is full."""
        ...

    def sync(self) -> None:
        """Have everything put on the disk."""
        ...

    def close(self) -> None:
        """Close what is open; may be called twice."""
        ...


class MasterImages:
    """Images in the dataset's own file."""

    def __init__(self, master: Master, dtype: np.dtype[Any]) -> None:
        """Write into the stacks that are there."""
        self.dtype = dtype
        self._master = master

    def write(self, row: int, image: NDArray[Any], mask: NDArray[np.uint8]) -> None:
        """Store image and mask."""
        self._master.write_row(schema.IMAGE, row, image)
        self._master.write_row(schema.MASK, row, mask)

    def sync(self) -> None:
        """Leave it to the file's owner."""

    def close(self) -> None:
        """Likewise."""


class SegmentImages:
    """Images in segments; one is open, and a full one is on the disk before the next begins."""

    def __init__(
        self,
        dataset_path: Path,
        segments: Sequence[Segment],
        *,
        uuid: str,
        shape: tuple[int, int],
        dtype: np.dtype[Any],
    ) -> None:
        """Remember the segments; the first one is begun with the first image."""
        self.dtype = dtype
        self._dataset_path = dataset_path
        self._segments = tuple(segments)
        self._uuid = uuid
        self._shape = shape
        self._segment: Segment | None = None
        self._file: InPlaceFile | None = None

    def write(self, row: int, image: NDArray[Any], mask: NDArray[np.uint8]) -> None:
        """Store image and mask.

        Raises:
            DatasetError: The file of another dataset is where the next segment belongs.
            OSError, RuntimeError: The disk does not take it.
        """
        segment = segment_of(self._segments, row)
        if segment != self._segment or self._file is None:
            self.close()
            self._file = self._opened(segment, row)
            self._segment = segment
        self._file.write_row(schema.SEGMENT_IMAGE, row - segment.first_row, image)
        self._file.write_row(schema.SEGMENT_MASK, row - segment.first_row, mask)
        if row == segment.end_row - 1:
            self._file.sync()

    def sync(self) -> None:
        """Have everything put on the disk."""
        if self._file is not None:
            self._file.sync()

    def close(self) -> None:
        """Close the open segment; may be called twice."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _opened(self, segment: Segment, row: int) -> InPlaceFile:
        path = self._dataset_path.parent / segment.name
        if not is_segment(path, segment, uuid=self._uuid, shape=self._shape, dtype=self.dtype):
            if row > segment.first_row:
                raise DatasetError(
                    f"{path}: is missing, damaged or not the segment it should be, and holds images"
                    f" of {self._dataset_path}; put it back"
                )
            create_segment(
                self._dataset_path, segment, uuid=self._uuid, shape=self._shape, dtype=self.dtype
            )
        return InPlaceFile(path)
