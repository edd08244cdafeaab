"""How far anything is from the terrain model, never told too far.

Around a place the model is as high as its highest sample within some radius r; so what hovers g
above that is at least min(g, r) away. The best of many radii is exact over flat ground, and over
slopes and edges less than the true distance by at most about a third.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from tronlab.geometry.poses import FloatArray
from tronlab.terrain.heightmap import HeightMap

_CELL_M: Final = 0.02
"""Heights are those of the highest sample of cells about this large."""
_RADIUS_GROWTH: Final = 1.15
_LARGEST_RADIUS_M: Final = 8.0
"""Nothing is told to be farther from the model than this."""


@dataclass(frozen=True, slots=True)
class TerrainClearance:
    """The terrain model as a solid: everything below its surface, without end."""

    _low_m: FloatArray
    """Least X and Y in trs, shape (2,)."""
    _high_m: FloatArray
    _cell_m: float
    _radii_m: FloatArray
    """Shape (levels,), growing."""
    _height_m: FloatArray
    """Highest Z in trs within each radius of a cell, shape (levels, rows, columns)."""

    @classmethod
    def of(cls, heightmap: HeightMap) -> "TerrainClearance":
        """Prepare a height map."""
        n_nodes = max(1, round(_CELL_M / heightmap.spacing_m))
        cell_m = n_nodes * heightmap.spacing_m
        highest = _highest_of_cells(heightmap.height_m, n_nodes).astype(np.float64)
        n_cells = _radii_in_cells(_LARGEST_RADIUS_M / cell_m)
        dilated = [
            maximum_filter(highest, size=2 * int(n) + 1, mode="constant", cval=-np.inf)
            for n in n_cells
        ]
        low = heightmap.origin_trs_m[:2]
        return cls(
            _low_m=low,
            _high_m=low + heightmap.size_m,
            _cell_m=cell_m,
            _radii_m=n_cells * cell_m,
            _height_m=np.stack(dilated) + heightmap.origin_trs_m[2],
        )

    def of_cylinders_m(
        self, p_trs_m: FloatArray, radius_m: FloatArray, bottom_trs_m: FloatArray
    ) -> FloatArray:
        """Bound the distance of upright cylinders from the model; negative: they may meet.

        Args:
            p_trs_m: A point on their axes, shape (..., 3).
            radius_m: Their radii, shape (...).
            bottom_trs_m: Z of their lower ends, shape (...).
        """
        xy = p_trs_m[..., :2]
        beside = np.clip(xy, self._low_m, self._high_m)
        row, column = self._cells(beside)
        gap_m = bottom_trs_m[..., np.newaxis] - np.moveaxis(self._height_m[:, row, column], 0, -1)
        reach_m = self._radii_m - radius_m[..., np.newaxis]
        least_m = np.minimum(gap_m, reach_m).max(axis=-1)
        sideways_m = np.maximum(np.linalg.norm(xy - beside, axis=-1) - radius_m, 0.0)
        # What is nearest to a point beside a convex outline is farther by at least a right angle.
        return np.where(sideways_m > 0.0, np.hypot(sideways_m, np.maximum(least_m, 0.0)), least_m)

    def of_segments_m(self, p0_trs_m: FloatArray, p1_trs_m: FloatArray) -> FloatArray:
        """Bound the distance of line segments, ends of shape (..., 3), from the model."""
        middle = (p0_trs_m + p1_trs_m) / 2.0
        radius_m = np.linalg.norm((p1_trs_m - p0_trs_m)[..., :2], axis=-1) / 2.0
        return self.of_cylinders_m(middle, radius_m, np.minimum(p0_trs_m, p1_trs_m)[..., 2])

    def _cells(self, xy_trs_m: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        n_rows, n_columns = self._height_m.shape[1:]
        index = np.floor((xy_trs_m - self._low_m) / self._cell_m).astype(np.intp)
        return (
            np.clip(index[..., 0], 0, n_rows - 1),
            np.clip(index[..., 1], 0, n_columns - 1),
        )


def _highest_of_cells(height_m: NDArray[np.float32], n_nodes: int) -> NDArray[np.float32]:
    """Give the highest node of each cell; nodes on the border of two belong to both."""
    for axis in (0, 1):
        starts = np.arange(0, height_m.shape[axis] - 1, n_nodes)
        within = np.maximum.reduceat(height_m, starts, axis=axis)
        ends = np.minimum(starts + n_nodes, height_m.shape[axis] - 1)
        height_m = np.maximum(within, np.take(height_m, ends, axis=axis))
    return height_m


def _radii_in_cells(largest: float) -> FloatArray:
    """Give whole numbers from 1 that grow by a factor once steps of 1 are finer than that."""
    radii = [1.0]
    while radii[-1] < largest:
        radii.append(max(radii[-1] + 1.0, float(round(radii[-1] * _RADIUS_GROWTH))))
    return np.array(radii)
