"""Height maps on a finer or coarser grid, and what that loses."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.config import MAX_SAMPLES
from tronlab.terrain.formats.model import SMALLEST_SIDE, Announce, Heights
from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.lengths import length_text

_SAMPLES_AT_ONCE = 1 << 24
_ROWS_AT_ONCE = 256
_SPLINE_REACH = 24
"""Samples after which a cubic spline no longer feels its end: (2 - sqrt 3)^24 = 2e-14."""
_SIGMA_OF_STEP = 0.5
_SIGMAS_OF_GAUSSIAN = 4.0
_WHOLE = 1e-9
"""A share of a sample that counts as rounding."""


@dataclass(frozen=True, slots=True)
class ResamplingLoss:
    """What a new grid no longer knows of the old one: new minus old, at the old samples."""

    rms_m: float
    largest_m: float
    shortest_wave_m: tuple[float, float]
    """Shortest wave that the new grid can carry and the old one could, along rows and columns: two
    samples of the coarser of both."""
    lost_relief_share: float
    """How much smaller the difference between highest and lowest height has become, of 1."""

    def scaled(self, factor: float) -> "ResamplingLoss":
        """Give the loss of heights that are made higher by a factor afterwards."""
        return replace(self, rms_m=factor * self.rms_m, largest_m=factor * self.largest_m)

    def __str__(self) -> str:
        waves = dict.fromkeys(length_text(wave_m) for wave_m in self.shortest_wave_m)
        return (
            f"resampling changed heights by {length_text(self.rms_m)} rms, at most"
            f" {length_text(self.largest_m)}, and the relief by"
            f" {-100 * self.lost_relief_share:+.2g} %; the shortest waves left are"
            f" {' and '.join(waves)} long"
        )


def middle_of_shape(
    shape: tuple[int, ...], size_m: tuple[float, float], *, aspect: float = 1.0
) -> tuple[slice, slice]:
    """Cut the middle of a grid out so that it has the shape of a size.

    Args:
        shape: Rows and columns of the grid.
        size_m: Extent along rows and columns that the grid is to be laid on.
        aspect: How many times further apart samples are along rows than along columns.

    Returns:
        Rows and columns to keep.

    Raises:
        TerrainError: Too few samples are left.
    """
    rows, columns = shape
    sample_m = max(size_m[0] / ((rows - 1) * aspect), size_m[1] / (columns - 1))
    kept_rows = min(rows, round(size_m[0] / (sample_m * aspect)) + 1)
    kept_columns = min(columns, round(size_m[1] / sample_m) + 1)
    if min(kept_rows, kept_columns) < SMALLEST_SIDE:
        raise TerrainError(
            f"{rows} x {columns} samples cut to the shape of size_m {list(size_m)} leave"
            f" {kept_rows} x {kept_columns}, needed are at least {SMALLEST_SIDE} x {SMALLEST_SIDE}"
        )
    top, left = (rows - kept_rows) // 2, (columns - kept_columns) // 2
    return slice(top, top + kept_rows), slice(left, left + kept_columns)


def cut_to_shape(
    height_m: Heights,
    size_m: tuple[float, float],
    *,
    aspect: float,
    name: str = "",
    announce: Announce,
) -> Heights:
    """Cut the middle out as ``middle_of_shape`` does, and tell what is left away.

    Args:
        height_m: Shape (rows, columns).
        size_m: As in ``middle_of_shape``.
        aspect: As in ``middle_of_shape``.
        name: What the line told begins with.
        announce: Is told, if anything is cut off.

    Raises:
        TerrainError: As ``middle_of_shape``.
    """
    rows, columns = middle_of_shape(height_m.shape, size_m, aspect=aspect)
    middle = height_m[rows, columns]
    if middle.shape != height_m.shape:
        announce(
            f"{name}{height_m.shape[0]} x {height_m.shape[1]} samples do not have the shape of"
            f" {size_m[0]:g} x {size_m[1]:g} m: using the middle, {middle.shape[0]} x"
            f" {middle.shape[1]} from row {rows.start}, column {columns.start}"
        )
    return middle


def resample(
    height_m: Heights,
    spacing_m: tuple[float, float],
    shape: tuple[int, int],
    *,
    on_progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> tuple[Heights, ResamplingLoss]:
    """Put heights on a grid of another shape with the same four corners.

    In between samples the surface is the bicubic spline through them. Along an axis that becomes
    coarser by a factor s a Gaussian of sigma s / 2 samples is applied first: it leaves 73 % of the
    height of waves of four new samples, 29 % of two, the shortest that the new grid carries, and
    0.7 % of one, which the new grid would take for a slope.

    Args:
        height_m: Shape (rows, columns), finite. May be mapped from a file: a band is in memory.
        spacing_m: Along rows and columns.
        shape: Rows and columns of the new grid.
        on_progress: Is told rows done and rows in all.

    Returns:
        Heights of the type of ``height_m`` and of the shape asked for, and what they have lost.

    Raises:
        TerrainError: The heights have holes, one of the grids is too small, or the new one too
            large.
    """
    _check_grids(height_m.shape, shape)
    pairs = list(zip(height_m.shape, shape, strict=True))
    grids = _Grids(
        spacing_m,
        tuple(np.linspace(0, old - 1, new) for old, new in pairs),
        tuple(np.linspace(0, new - 1, old) for old, new in pairs),
    )
    return _resampled(height_m, grids, on_progress)


def resample_to_spacing(
    height_m: Heights,
    spacing_m: tuple[float, float],
    new_spacing_m: float,
    *,
    on_progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> tuple[Heights, ResamplingLoss]:
    """Put heights on a grid of squares that begins at the same corner; see ``resample``.

    Less than one new sample may be left over at the last row and column.

    Raises:
        TerrainError: As ``resample``, or the new spacing is not positive.
    """
    if not new_spacing_m > 0.0:
        raise TerrainError(f"resampling: the new spacing is {new_spacing_m} m, must be positive")
    steps = [new_spacing_m / old_m for old_m in spacing_m]
    shape = tuple(
        int((n - 1) / step + _WHOLE) + 1 for n, step in zip(height_m.shape, steps, strict=True)
    )
    _check_grids(height_m.shape, shape)
    new_places: list[NDArray[np.float64]] = []
    old_places: list[NDArray[np.float64]] = []
    for n, n_new, step in zip(height_m.shape, shape, steps, strict=True):
        new_places.append(np.minimum(np.arange(n_new) * step, n - 1))
        n_covered = int((n_new - 1) * step + _WHOLE) + 1
        old_places.append(np.minimum(np.arange(n_covered) / step, n_new - 1))
    grids = _Grids(spacing_m, tuple(new_places), tuple(old_places))
    return _resampled(height_m, grids, on_progress)


@dataclass(frozen=True, slots=True)
class _Grids:
    """An old and a new grid: where the samples of each lie in the other, along rows and columns."""

    old_spacing_m: tuple[float, float]
    new_in_old: tuple[NDArray[np.float64], ...]
    """The new samples, counted in samples of the old grid, ascending."""
    old_in_new: tuple[NDArray[np.float64], ...]
    """The old samples that the new grid covers."""

    @property
    def steps(self) -> tuple[float, float]:
        """Get how many old samples lie between two new ones."""
        along_rows, along_columns = (float(places[1] - places[0]) for places in self.new_in_old)
        return along_rows, along_columns

    @property
    def n_rows(self) -> int:
        """Get the rows to compute, there and back."""
        return len(self.new_in_old[0]) + len(self.old_in_new[0])


def _check_grids(old: tuple[int, ...], new: tuple[int, ...]) -> None:
    for name, (rows, columns) in {"old": old, "new": new}.items():
        if min(rows, columns) < SMALLEST_SIDE:
            raise TerrainError(
                f"resampling: the {name} grid is {rows} x {columns}, needed are at least"
                f" {SMALLEST_SIDE} x {SMALLEST_SIDE}"
            )
    if new[0] * new[1] > MAX_SAMPLES:
        raise TerrainError(
            f"resampling: the new grid would have {new[0]} x {new[1]} samples (at most"
            f" {MAX_SAMPLES}); make the spacing larger"
        )


def _resampled(
    height_m: Heights, grids: _Grids, on_progress: Callable[[int, int], None]
) -> tuple[Heights, ResamplingLoss]:
    shape = (len(grids.new_in_old[0]), len(grids.new_in_old[1]))
    resampled: Any = np.empty(shape, dtype=height_m.dtype)
    sigmas = [_SIGMA_OF_STEP * step if step > 1.0 else 0.0 for step in grids.steps]
    for rows, block in _spline(height_m, grids.new_in_old, sigmas):
        resampled[rows] = block
        on_progress(rows.stop, grids.n_rows)
    return resampled, _loss(height_m, resampled, grids, on_progress)


def _loss(
    old_m: Heights, new_m: Heights, grids: _Grids, on_progress: Callable[[int, int], None]
) -> ResamplingLoss:
    """Go back to the old samples and compare."""
    n_rows, n_columns = (len(places) for places in grids.old_in_new)
    sum_of_squares, largest_m, lowest_m, highest_m = 0.0, 0.0, np.inf, -np.inf
    for rows, block in _spline(new_m, grids.old_in_new, [0.0, 0.0]):
        before = old_m[rows, :n_columns]
        change = block - before
        sum_of_squares += float(np.sum(change * change))
        largest_m = max(largest_m, float(np.abs(change).max()))
        lowest_m = min(lowest_m, float(before.min()))
        highest_m = max(highest_m, float(before.max()))
        on_progress(len(new_m) + rows.stop, grids.n_rows)
    relief_m = highest_m - lowest_m
    step_x, step_y = (max(step, 1.0) for step in grids.steps)
    return ResamplingLoss(
        rms_m=float(np.sqrt(sum_of_squares / (n_rows * n_columns))),
        largest_m=largest_m,
        shortest_wave_m=(2 * step_x * grids.old_spacing_m[0], 2 * step_y * grids.old_spacing_m[1]),
        lost_relief_share=1.0 - float(np.ptp(new_m)) / relief_m if relief_m > 0.0 else 0.0,
    )


def _spline(
    samples: Heights, places: tuple[NDArray[np.float64], ...], sigmas: list[float]
) -> Iterator[tuple[slice, NDArray[np.float64]]]:
    """Evaluate the smoothed bicubic spline at places in ascending order, some rows at a time."""
    from scipy.interpolate import make_interp_spline
    from scipy.ndimage import gaussian_filter

    x, y = places
    columns = np.arange(samples.shape[1])
    for band, wanted in _bands(samples.shape, x, sigmas[0]):
        heights: Any = np.asarray(samples[band], dtype=np.float64)
        if not np.isfinite(heights).all():
            raise TerrainError("resampling: the heights have holes; fill them first")
        if max(sigmas) > 0.0:
            heights = gaussian_filter(heights, sigmas, truncate=_SIGMAS_OF_GAUSSIAN)
        tall = make_interp_spline(np.arange(band.start, band.stop), heights, k=3, axis=0)
        for first in range(wanted.start, wanted.stop, _ROWS_AT_ONCE):
            rows = slice(first, min(first + _ROWS_AT_ONCE, wanted.stop))
            wide = make_interp_spline(columns, tall(x[rows]), k=3, axis=1)
            yield rows, wide(y)


def _bands(
    shape: tuple[int, ...], x: NDArray[np.float64], sigma: float
) -> Iterator[tuple[slice, slice]]:
    """Cut rows into bands that fit memory: the rows of samples, and of places inside them.

    Bands overlap as far as the filter and the spline notice, so that no seam is left.
    """
    n_rows, n_columns = shape
    reach = _SPLINE_REACH + int(np.ceil(_SIGMAS_OF_GAUSSIAN * sigma))
    inner = max(2 * reach, _SAMPLES_AT_ONCE // n_columns - 2 * reach)
    if inner + 2 * reach >= n_rows:
        yield slice(0, n_rows), slice(0, len(x))
        return
    for first in range(0, n_rows, inner):
        wanted = np.searchsorted(x, [first, first + inner])
        if first + inner >= n_rows:
            wanted[1] = len(x)
        if wanted[0] < wanted[1]:
            band = slice(max(0, first - reach), min(first + inner + reach, n_rows))
            yield band, slice(int(wanted[0]), int(wanted[1]))
