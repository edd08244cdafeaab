# pyright: basic
"""A height map and its quadtrees of maxima, for single rays and for bundles of rays."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.kernels import compiled

WIDE_LEVEL = np.int64(2)
"""The lowest level of the wide quadtree."""


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
    wide_max_m: NDArray[np.float32]
    """The wide quadtree: maxima over a square and half its width around it, for levels from
    ``WIDE_LEVEL`` up. What passes over a square's middle line, no wider than the square, is over
    this. Each level has one more square on every side of the model."""
    wide_start: NDArray[np.int64]
    """Where in ``wide_max_m`` the square (0, 0) of a level lies."""
    wide_columns: NDArray[np.int64]
    top_m: float
    """The largest height."""
    bottom_m: float
    """The smallest height."""
    spacing_m: float


def make_grid(height_m: NDArray[np.float32], spacing_m: float) -> Grid:
    """Build the quadtrees: less than half of the heights' memory."""
    shape = ((height_m.shape[0]) // 2, (height_m.shape[1]) // 2)
    levels = [np.empty(shape, dtype=np.float32)]
    _lowest_level(height_m, levels[0])
    while max(levels[-1].shape) > 1:
        below = levels[-1]
        levels.append(np.empty([(n + 1) // 2 for n in below.shape], dtype=np.float32))
        _next_level(below, levels[-1])
    wide = [np.empty([(n + 1) // 2 + 2 for n in level.shape], dtype=np.float32) for level in levels]
    for level, wide_level in zip(levels, wide, strict=True):
        _wide_level(level, wide_level)
    none = np.empty((0, height_m.shape[1] - 1), dtype=np.float32)
    node_max, start, columns = _joined([none, *levels])
    wide_max, wide_start, wide_columns = _joined([none, none, *wide])
    return Grid(
        height_m,
        node_max,
        start,
        columns,
        wide_max,
        wide_start + wide_columns + 1,
        wide_columns,
        float(height_m.max()),
        float(height_m.min()),
        spacing_m,
    )


def _joined(
    levels: list[NDArray[np.float32]],
) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64]]:
    """Give all levels' values in one array, where each level begins, and its columns."""
    sizes = [level.size for level in levels]
    return (
        np.concatenate([level.ravel() for level in levels]),
        np.cumsum([0, *sizes[:-1]], dtype=np.int64),
        np.array([level.shape[1] for level in levels], dtype=np.int64),
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


@compiled
def _wide_level(below, level):
    """Fill a wide level from the plain one below: 2 x 2 of its squares and one on each side."""
    n_rows, n_columns = below.shape
    for i in range(level.shape[0]):
        for j in range(level.shape[1]):
            highest = np.float32(-np.inf)
            for k in range(max(2 * i - 3, 0), min(2 * i + 1, n_rows)):
                for m in range(max(2 * j - 3, 0), min(2 * j + 1, n_columns)):
                    highest = max(highest, below[k, m])
            level[i, j] = highest
