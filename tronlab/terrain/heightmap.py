"""The height map of a terrain model, placed in F_TRS."""

from collections.abc import Iterator
from dataclasses import InitVar, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tronlab.errors import TronlabError
from tronlab.geometry.poses import FloatArray

WHITE = 65535
"""The value that stands for an albedo of 1."""
_BYTES_AT_ONCE = 1 << 24


class TerrainError(TronlabError):
    """A height map cannot be read or makes no sense."""


@dataclass(frozen=True, slots=True)
class HeightStatistics:
    """What is known of all heights together."""

    lowest_m: float
    highest_m: float
    mean_m: float


@dataclass(frozen=True, slots=True)
class KnownHeights:
    """What a file says about its heights, so that they need not all be read to know it."""

    statistics: HeightStatistics
    fingerprint: str | None
    """Names the heights, other heights have another one; None: nobody has named them."""
    file: Path | None = None
    """NumPy file they are mapped from, if they are not in memory."""


@dataclass(frozen=True, slots=True)
class HeightMap:
    """Heights on a regular grid whose axes are those of F_TRS.

    Sample (i, j) is the node at ``origin_trs_m + (i * spacing_m, j * spacing_m, height_m[i, j])``:
    rows run down the model (+X_TRS), columns to the right (+Y_TRS), heights towards the camera
    (+Z_TRS). Between nodes the surface is defined by the renderer.
    """

    height_m: NDArray[np.float32]
    """Shape (rows, columns), C-contiguous, finite."""
    spacing_m: float
    origin_trs_m: FloatArray
    """Where node (0, 0) would lie at height 0, shape (3,)."""
    known: InitVar[KnownHeights | None] = None
    """What is known of the heights; without it they are all looked at once."""
    albedo: NDArray[np.uint16] | None = None
    """Relative albedo of each sample, ``WHITE`` for 1, shape as the heights; None: 1 everywhere."""
    statistics: HeightStatistics = field(init=False, repr=False, compare=False)
    fingerprint: str | None = field(init=False, repr=False, compare=False)
    """Names the heights of a file or of the cache; None: nobody has named them."""
    file: Path | None = field(init=False, repr=False, compare=False)
    """NumPy file that the heights are mapped from, if they are not in memory."""

    def __post_init__(self, known: KnownHeights | None) -> None:
        if self.height_m.ndim != 2 or min(self.height_m.shape) < 2:
            raise TerrainError(f"height map: shape is {self.height_m.shape}, expected (>= 2, >= 2)")
        if not self.spacing_m > 0:
            raise TerrainError(f"height map: spacing is {self.spacing_m} m, must be positive")
        self._check_albedo()
        statistics = known.statistics if known else measure_heights(self.height_m)
        object.__setattr__(self, "statistics", statistics)
        object.__setattr__(self, "fingerprint", known.fingerprint if known else None)
        object.__setattr__(self, "file", known.file if known else None)

    def _check_albedo(self) -> None:
        albedo, shape = self.albedo, self.height_m.shape
        if albedo is not None and (albedo.dtype != np.uint16 or albedo.shape != shape):
            raise TerrainError(
                f"albedo: is {albedo.dtype} of shape {albedo.shape}, must be uint16 of shape"
                f" {shape}, one value a height ({WHITE} is an albedo of 1)"
            )

    def painted(self, albedo: NDArray[np.uint16] | None) -> "HeightMap":
        """Give the same heights with another albedo.

        Raises:
            TerrainError: The albedo is not uint16 or not of the heights' shape.
        """
        known = KnownHeights(self.statistics, self.fingerprint, self.file)
        return HeightMap(self.height_m, self.spacing_m, self.origin_trs_m, known, albedo)

    def thinned(self, every_n: int) -> "HeightMap":
        """Give a coarser map of every n-th sample along rows and columns alone.

        Raises:
            TerrainError: Nothing would be left.
        """
        most = min(self.height_m.shape) - 1
        if not 1 <= every_n <= most:
            raise TerrainError(
                f"every_n is {every_n}, must be from 1 to {most} for heights of"
                f" {self.height_m.shape}"
            )
        if every_n == 1:
            return self
        nth = (slice(None, None, every_n),) * 2
        return HeightMap(
            np.ascontiguousarray(self.height_m[nth]),
            self.spacing_m * every_n,
            self.origin_trs_m,
            albedo=None if self.albedo is None else np.ascontiguousarray(self.albedo[nth]),
        )

    @property
    def size_m(self) -> tuple[float, float]:
        """Get the extent along X_TRS and Y_TRS."""
        rows, columns = self.height_m.shape
        return (rows - 1) * self.spacing_m, (columns - 1) * self.spacing_m

    @property
    def relief_m(self) -> float:
        """Get the difference between the highest and the lowest sample."""
        return self.statistics.highest_m - self.statistics.lowest_m

    @property
    def mean_height_trs_m(self) -> float:
        """Get Z_TRS of the mean height: where the flat outline of the model is taken to lie."""
        return float(self.origin_trs_m[2] + self.statistics.mean_m)


class HeightSums:
    """Gathers the statistics of heights that come in bands."""

    def __init__(self) -> None:
        self._lowest, self._highest = np.inf, -np.inf
        self._sum = 0.0
        self._n = self._n_bad = 0

    def add(self, height_m: NDArray[np.floating]) -> None:
        """Take in some heights, of any shape."""
        lowest, highest = float(height_m.min()), float(height_m.max())
        if not np.isfinite(highest - lowest):
            self._n_bad += int(np.count_nonzero(~np.isfinite(height_m)))
        self._lowest, self._highest = min(self._lowest, lowest), max(self._highest, highest)
        self._sum += float(height_m.sum(dtype=np.float64))
        self._n += height_m.size

    def result(self) -> HeightStatistics:
        """Give the statistics of everything taken in.

        Raises:
            TerrainError: Some heights are not finite.
        """
        if self._n_bad:
            raise TerrainError(
                f"height map: {self._n_bad} samples are not finite; fill the holes first"
            )
        return HeightStatistics(self._lowest, self._highest, self._sum / self._n)


def measure_heights(height_m: NDArray[np.floating]) -> HeightStatistics:
    """Look at all heights, shape (rows, columns), band by band.

    Raises:
        TerrainError: Some are not finite.
    """
    sums = HeightSums()
    for first, end in bands_of_rows(height_m.shape):
        sums.add(height_m[first:end])
    return sums.result()


def bands_of_rows(shape: tuple[int, ...]) -> Iterator[tuple[int, int]]:
    """Cut rows of float32 into bands (first row, row after the last) of some 16 MB."""
    step = rows_per_band(shape[1])
    for first in range(0, shape[0], step):
        yield first, min(first + step, shape[0])


def rows_per_band(n_columns: int) -> int:
    """Give how many rows of float32 make a band of some 16 MB."""
    return max(1, _BYTES_AT_ONCE // (4 * n_columns))
