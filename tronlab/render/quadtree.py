# pyright: basic
"""A height map and its quadtree of maxima."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.kernels import compiled


class Grid(NamedTuple):
    """A height map and its quadtree, as the kernels see it."""

    height_m: NDArray[np.float32]
    """Shape (rows, columns)."""
    node_max_m: NDArray[np.float32]
    """Maxima of all levels from 1 up, one after the other, each level by rows."""
    level_start: NDArray[np.int64]
    """Where in ``node_max_m`` a level begins; entry 0 is not used."""
    level_columns: NDArray[np.int64]
    """Columns of a level."""
    top_m: float
    """The largest height."""
    spacing_m: float


def make_grid(height_m: NDArray[np.float32], spacing_m: float) -> Grid:
    """Build the quadtree: a third of the heights' memory."""
    shape = ((height_m.shape[0]) // 2, (height_m.shape[1]) // 2)
    levels = [np.empty(shape, dtype=np.float32)]
    _lowest_level(height_m, levels[0])
    while max(levels[-1].shape) > 1:
        below = levels[-1]
        levels.append(np.empty([(n + 1) // 2 for n in below.shape], dtype=np.float32))
        _next_level(below, levels[-1])
    starts = np.concatenate([[0, 0], np.cumsum([level.size for level in levels[:-1]])])
    columns = [height_m.shape[1] - 1] + [level.shape[1] for level in levels]
    return Grid(
        height_m,
        np.concatenate([level.ravel() for level in levels]),
        starts.astype(np.int64),
        np.array(columns, dtype=np.int64),
        float(height_m.max()),
        spacing_m,
    )


@compiled
def _lowest_level(height, level):
    """Fill level 1: a node covers 2 x 2 cells, which are 3 x 3 samples."""
    n_rows, n_columns = height.shape
    for i in range(level.shape[0]):
        for j in range(level.shape[1]):
            highest = height[2 * i, 2 * j]
            for k in range(2 * i, min(2 * i + 3, n_rows)):
                for m in range(2 * j, min(2 * j + 3, n_columns)):
                    highest = max(highest, height[k, m])
            level[i, j] = highest


@compiled
def _next_level(below, level):
    n_rows, n_columns = below.shape
    for i in range(level.shape[0]):
        for j in range(level.shape[1]):
            highest = below[2 * i, 2 * j]
            for k in range(2 * i, min(2 * i + 2, n_rows)):
                for m in range(2 * j, min(2 * j + 2, n_columns)):
                    highest = max(highest, below[k, m])
            level[i, j] = highest
