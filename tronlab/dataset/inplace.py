"""Overwriting values of an HDF5 file in place, past HDF5.

Once the structure of a file is made, nothing but these bytes changes: neither a kill nor a full
disk can leave the structure half changed, and readers may open the file meanwhile.
"""

import math
import os
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray


class InPlaceFile:
    """The contiguous datasets of an HDF5 file, open for overwriting."""

    def __init__(self, path: Path) -> None:
        """Find where each dataset lies.

        Raises:
            OSError: The file cannot be opened for writing.
        """
        self._places = _places(path)
        self._descriptor = os.open(path, os.O_RDWR)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def write(self, path: str, value: ArrayLike) -> None:
        """Overwrite a whole dataset.

        Raises:
            OSError: The disk does not take it.
        """
        offset, dtype, shape = self._places[path]
        self._write_at(offset, np.asarray(value, dtype), shape)

    def write_row(self, path: str, row: int, value: ArrayLike) -> None:
        """Overwrite one row of a dataset.

        Raises:
            OSError: The disk does not take it.
        """
        offset, dtype, (n_rows, *shape) = self._places[path]
        if not 0 <= row < n_rows:
            raise IndexError(f"{path}: no row {row} of {n_rows}")
        n_bytes = dtype.itemsize * math.prod(shape)
        self._write_at(offset + row * n_bytes, np.asarray(value, dtype), tuple(shape))

    def sync(self) -> None:
        """Have everything put on the disk.

        Raises:
            OSError: The disk does not take it.
        """
        os.fsync(self._descriptor)

    def close(self) -> None:
        """Close the file; may be called twice."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def _write_at(self, offset: int, value: NDArray[Any], shape: tuple[int, ...]) -> None:
        if value.shape != shape:
            raise ValueError(f"shape is {value.shape}, the file has {shape}")
        rest = np.ascontiguousarray(value).reshape(-1).view(np.uint8).data
        while rest:
            n_written = os.pwrite(self._descriptor, rest, offset)
            rest, offset = rest[n_written:], offset + n_written


def _places(path: Path) -> dict[str, tuple[int, np.dtype[Any], tuple[int, ...]]]:
    """Give offset, type and shape of each contiguous dataset by its path."""
    places: dict[str, tuple[int, np.dtype[Any], tuple[int, ...]]] = {}

    def note(name: str, item: h5py.Group | h5py.Dataset) -> None:
        if isinstance(item, h5py.Dataset) and _is_contiguous(item):
            places[name] = (item.id.get_offset(), item.dtype, item.shape)

    with h5py.File(path, "r", locking=False) as file:
        file.visititems(note)
    return places


def _is_contiguous(item: h5py.Dataset) -> bool:
    return (
        item.id.get_create_plist().get_layout() == h5py.h5d.CONTIGUOUS
        and item.id.get_offset() is not None
        and not item.dtype.hasobject
    )
