"""What the readers of all formats give, and what the writers say they did."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.heightmap import TerrainError

Announce: TypeAlias = Callable[[str], None]
"""Is told in one line what a user should know."""
Heights: TypeAlias = NDArray[np.float32] | NDArray[np.float64]
Window: TypeAlias = tuple[int, int, int, int]
"""A part of a raster: first row, first column, number of rows, number of columns."""

SMALLEST_SIDE = 8
_ROWS_AT_ONCE = 1024


@dataclass(frozen=True, slots=True)
class Raster:
    """Heights as a file has them, before they become a terrain model.

    Row 0 is the northern one and column 0 the western one, where the file knows of directions.
    """

    height_m: Heights
    """Shape (rows, columns), the file's unit and offset applied; NaN where there is a hole. Plain
    numbers of no unit where ``has_unit`` is False. May be a read-only view of the file itself."""
    spacing_m: tuple[float, float] | None = None
    """Between samples along rows (from one row to the next) and along columns; None: not known."""
    has_unit: bool = True
    crs: str | None = None
    """WKT of the coordinate reference system."""
    corner_m: tuple[float, float] | None = None
    """Where the centre of sample (0, 0) lies in ``crs``: x (east) and y (north)."""

    @property
    def n_holes(self) -> int:
        """Count the samples that are not finite."""
        return sum(
            int(np.count_nonzero(~np.isfinite(self.height_m[first : first + _ROWS_AT_ONCE])))
            for first in range(0, self.height_m.shape[0], _ROWS_AT_ONCE)
        )


@dataclass(frozen=True, slots=True)
class WriteReport:
    """What a file keeps of the heights given to it."""

    path: Path
    largest_error_m: float = 0.0
    """Of a height read back from the file."""
    height_step_m: float | None = None
    """Height of one level, where the format has levels."""
    height_offset_m: float | None = None
    """Height of level 0, where the format has levels."""
    has_unit: bool = True
    """False: the numbers here are not metres."""
    not_kept: tuple[str, ...] = ()
    """What was known and cannot be said in this format."""

    def __str__(self) -> str:
        unit = " m" if self.has_unit else ""
        heights = "heights kept as they are"
        if self.height_step_m is not None and self.height_offset_m is not None:
            heights = (
                f"heights in steps of {self.height_step_m:.4g}{unit} from"
                f" {self.height_offset_m:.6g}{unit}, wrong by at most"
                f" {self.largest_error_m:.2g}{unit}"
            )
        lost = f"; not kept in this format: {', '.join(self.not_kept)}" if self.not_kept else ""
        return f"{self.path.name}: {heights}{lost}"


def check_shape(shape: tuple[int, ...], path: Path) -> None:
    """Refuse what is no height map.

    Raises:
        TerrainError: Not two dimensions, or too few samples along one.
    """
    if len(shape) != 2 or min(shape) < SMALLEST_SIDE:
        raise TerrainError(
            f"{path}: shape is {shape}, expected at least ({SMALLEST_SIDE}, {SMALLEST_SIDE})"
        )


def window_slices(window: Window | None, shape: tuple[int, ...], path: Path) -> tuple[slice, slice]:
    """Give the rows and columns of a window, all of them for None.

    Raises:
        TerrainError: The window is empty or reaches outside.
    """
    if window is None:
        return slice(0, shape[0]), slice(0, shape[1])
    row, column, rows, columns = window
    if min(row, column) < 0 or min(rows, columns) < 1:
        raise TerrainError(
            f"{path}: the part {list(window)} (row, column, rows, columns) must start at 0 or"
            " more and have at least one row and column"
        )
    if row + rows > shape[0] or column + columns > shape[1]:
        raise TerrainError(
            f"{path}: the part {list(window)} (row, column, rows, columns) reaches to row"
            f" {row + rows} and column {column + columns}, the file has {shape[0]} x {shape[1]}"
        )
    return slice(row, row + rows), slice(column, column + columns)


def corner_of_window(
    corner_m: tuple[float, float] | None,
    spacing_m: tuple[float, float] | None,
    window: Window | None,
) -> tuple[float, float] | None:
    """Give the map coordinates of a window's first sample, row 0 being the northern one."""
    if window is None or corner_m is None or spacing_m is None:
        return corner_m
    row, column, _, _ = window
    return corner_m[0] + column * spacing_m[1], corner_m[1] - row * spacing_m[0]


def needs_extra(path: Path, package: str) -> TerrainError:
    """Say that a format's package is not installed."""
    return TerrainError(
        f"{path}: this format needs the package {package}, which is not installed:"
        " pip install 'tronlab[geo]'"
    )


def from_numbers(
    numbers: NDArray[Any], *, scale: float = 1.0, offset: float = 0.0, holes: Any = None
) -> Heights:
    """Turn a file's numbers into heights, ``numbers * scale + offset``.

    float32 where it loses nothing that counts: it holds 24 bits, which is enough for 16 of them
    and a scale, not for an offset such as a planet's radius.

    Args:
        numbers: Any real type, any byte order.
        scale: Height of 1.
        offset: Height of 0.
        holes: Mask of the samples that become NaN, of the shape of ``numbers``; None: none.
    """
    kind, itemsize = numbers.dtype.kind, numbers.dtype.itemsize
    is_short = itemsize <= 2 or (kind == "f" and itemsize == 4)
    dtype = np.float32 if is_short and offset == 0.0 else np.float64
    heights: Any = np.asarray(numbers, dtype=dtype)
    if (scale, offset) != (1.0, 0.0):
        heights = heights * dtype(scale) + dtype(offset)
    if holes is not None and np.any(holes):
        heights = np.where(holes, dtype(np.nan), heights)
    return heights
