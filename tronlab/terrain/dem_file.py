"""Heights in a NumPy file that may be larger than memory: read and written in pieces."""

import io
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.new_file import NewFile


class HeightsFile(NewFile):
    """Heights being written, shape ``shape``, as NAME.npy; see ``NewFile``.

    Raises:
        TerrainError: The name does not end in .npy; or as ``NewFile``.
    """

    def __init__(self, path: Path, shape: tuple[int, ...]) -> None:
        if path.suffix != ".npy":
            raise TerrainError(f"{path}: a terrain model is written to a file NAME.npy")
        self.shape = (int(shape[0]), int(shape[1]))
        self._header = _header(self.shape)
        super().__init__(path, len(self._header) + 4 * self.shape[0] * self.shape[1])

    def write(self, row: int, column: int, height_m: NDArray[np.float32]) -> None:
        """Write a block of heights whose first sample is (row, column).

        Raises:
            TerrainError: The disk does not take it.
        """
        block = np.ascontiguousarray(height_m, dtype=np.float32)
        pieces = [block] if block.shape[1] == self.shape[1] else block
        try:
            for i, piece in enumerate(pieces):
                place = len(self._header) + 4 * ((row + i) * self.shape[1] + column)
                _write_all(self.descriptor, piece.data.cast("B"), place)
        except OSError as error:
            raise self._cannot_be_written(error) from error

    def read_rows(self, first: int, end: int) -> NDArray[np.float32]:
        """Read rows that were written, up to and without ``end``."""
        height_m = np.empty((end - first, self.shape[1]), np.float32)
        read_rows(self.descriptor, len(self._header), first, height_m)
        return height_m

    def put_in_place_with(self, beside: Path, text: str) -> None:
        """Give the heights their name, and write a text beside them.

        Raises:
            TerrainError: One of the two cannot be written.
        """
        content = text.encode()
        try:
            _write_all(self.descriptor, memoryview(self._header), 0)
        except OSError as error:
            raise self._cannot_be_written(error) from error
        with NewFile(beside, len(content)) as described:
            _write_all(described.descriptor, memoryview(content), 0)
            described.put_in_place()
        self.put_in_place()


def rows_offset(path: Path, shape: tuple[int, int]) -> int:
    """Give where the first row begins in a NumPy file of float32, C order, of this shape.

    Raises:
        OSError: It cannot be read.
        TerrainError: It is no NumPy file, or of another kind or shape.
    """
    with path.open("rb") as file:
        try:
            version = np.lib.format.read_magic(file)
            read: Any = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }[version]
            found, is_fortran, kind = read(file)
        except (ValueError, KeyError, EOFError) as error:
            raise TerrainError(f"{path}: is not a NumPy file: {error}") from error
        offset = file.tell()
    if found != shape or is_fortran or kind != np.dtype("<f4"):
        raise TerrainError(
            f"{path}: is {kind} of shape {found}{' in Fortran order' if is_fortran else ''},"
            f" its description says float32 of shape {shape}: they do not belong together"
        )
    return offset


def read_rows(file: int, offset: int, first: int, into: NDArray[np.float32]) -> None:
    """Read rows from number ``first`` on into a contiguous array, from an open file.

    Raises:
        TerrainError: The file ends before.
    """
    view = into.data.cast("B")
    place, n_done = offset + first * into.shape[1] * 4, 0
    while n_done < len(view):
        n = os.preadv(file, [view[n_done:]], place + n_done)
        if n == 0:
            raise TerrainError(f"the heights' file ends within row {first} to the end of its band")
        n_done += n


def _write_all(file: int, view: memoryview, place: int) -> None:
    n_done = 0
    while n_done < len(view):
        n_done += os.pwrite(file, view[n_done:], place + n_done)


def _header(shape: tuple[int, int]) -> bytes:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f4", "fortran_order": False, "shape": shape}
    )
    return header.getvalue()
