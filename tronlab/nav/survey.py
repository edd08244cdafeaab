"""What a database covers: how densely, from which ranges, how often each point."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from tronlab.geometry.poses import FloatArray
from tronlab.nav.database import Database
from tronlab.nav.pruning import SAME_POINT_SIZES, SAME_SIZE

CELL_M = 0.05
"""Side of the cells that density and coverage are counted in."""
BAND_FACTOR = 2**0.5
"""Each band of ranges ends at this many times its beginning."""
MAX_DIFFERING = 0.2
"""Landmarks of one place and size show one point if no greater part of their bits differs. Of
unrelated AKAZE landmarks 47 per cent do in the median, and less than 20 once in ten thousand."""

_N_SAMPLED = 4000
_SAMPLE_SEED = 7
_ROWS_AT_ONCE = 1 << 17


@dataclass(frozen=True, slots=True)
class Survey:
    """Numbers of a database."""

    low_trs_m: FloatArray
    """Least X, Y and Z of a landmark, shape (3,)."""
    high_trs_m: FloatArray
    n_in_cell: NDArray[np.int64]
    """Landmarks by cell and range band, shape (rows along X, columns along Y, bands)."""
    corner_trs_m: tuple[float, float]
    """Least X and Y of the cells."""
    bands_m: FloatArray
    """Limits of the range bands, ascending, shape (bands + 1,)."""
    range_m: tuple[float, float, float]
    """Least, median and greatest distance from which a landmark was seen."""
    n_views_of_point: NDArray[np.int64]
    """In how many views the point of a landmark is a landmark, for a sample of them."""

    @property
    def density_per_m2(self) -> FloatArray:
        """Get landmarks by square metre of the ground, shape (rows, columns)."""
        return self.n_in_cell.sum(axis=2) / CELL_M**2

    @property
    def covered_m2(self) -> float:
        """Get the area of all cells that have a landmark."""
        return float(np.count_nonzero(self.n_in_cell.any(axis=2))) * CELL_M**2

    @property
    def covered_share(self) -> FloatArray:
        """Get which part of those cells has landmarks from each range band, shape (bands,)."""
        of_band = np.count_nonzero(self.n_in_cell, axis=(0, 1))
        return of_band / np.count_nonzero(self.n_in_cell.any(axis=2))


def survey(database: Database) -> Survey:
    """Look at all landmarks of a database, a piece at a time."""
    low, high = database.p_trs_m.min(axis=0), database.p_trs_m.max(axis=0)
    range_m = _ranges(database)
    first = np.floor(np.log(range_m.min()) / np.log(BAND_FACTOR))
    last = np.floor(np.log(range_m.max()) / np.log(BAND_FACTOR)) + 1
    bands_m = BAND_FACTOR ** np.arange(first, last + 1)
    corner = np.floor(low[:2] / CELL_M).astype(np.int64)
    shape = (*(np.floor(high[:2] / CELL_M).astype(np.int64) - corner + 1), len(bands_m) - 1)
    n_in_cell = np.zeros(int(np.prod(shape)), np.int64)
    for rows in _pieces(len(database)):
        cell = np.floor(database.p_trs_m[rows, :2] / CELL_M).astype(np.int64) - corner
        band = np.clip(np.searchsorted(bands_m, range_m[rows], "right") - 1, 0, shape[2] - 1)
        at = np.ravel_multi_index((cell[:, 0], cell[:, 1], band), shape)
        n_in_cell += np.bincount(at, minlength=len(n_in_cell))
    return Survey(
        low_trs_m=low,
        high_trs_m=high,
        n_in_cell=n_in_cell.reshape(shape),
        corner_trs_m=(float(corner[0]) * CELL_M, float(corner[1]) * CELL_M),
        bands_m=bands_m,
        range_m=(float(range_m.min()), float(np.median(range_m)), float(range_m.max())),
        n_views_of_point=_views_of_points(database),
    )


def _pieces(n: int) -> Iterator[slice]:
    for first in range(0, n, _ROWS_AT_ONCE):
        yield slice(first, first + _ROWS_AT_ONCE)


def _ranges(database: Database) -> FloatArray:
    range_m = np.empty(len(database))
    for rows in _pieces(len(database)):
        p_eye_m = database.p_views_trs_m[database.view[rows]]
        range_m[rows] = np.linalg.norm(database.p_trs_m[rows] - p_eye_m, axis=1)
    return range_m


def _views_of_points(database: Database) -> NDArray[np.int64]:
    """Count the views that show the points of some landmarks."""
    n = min(_N_SAMPLED, len(database))
    rng = np.random.default_rng(_SAMPLE_SEED)
    sample = np.sort(rng.choice(len(database), n, replace=False))
    size_m = database.size_m[sample]
    near = KDTree(database.p_trs_m).query_ball_point(
        database.p_trs_m[sample], SAME_POINT_SIZES * size_m
    )
    max_bits = MAX_DIFFERING * 8 * database.descriptors.shape[1]
    counts = np.zeros(n, np.int64)
    for i, neighbours in enumerate(near):
        ratio = database.size_m[neighbours] / size_m[i]
        others = np.array(neighbours)[np.maximum(ratio, 1 / ratio) < SAME_SIZE]
        differing = database.descriptors[others] ^ database.descriptors[sample[i]]
        bits = np.bitwise_count(differing).sum(axis=1, dtype=np.int64)
        counts[i] = len(np.unique(database.view[others[bits <= max_bits]]))
    return counts
