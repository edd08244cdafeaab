# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""How far from the surface something may stand between it and the lamp.

Most places have nothing high near them: a ray to the lamp is soon over everything there is. The
wide quadtree of maxima tells where that is for all rays at once that go from a block of 4 x 4 cells
to the lamp, so that they need not be followed further. Coordinates are those of ``raycast``.
"""

import numpy as np

from tronlab.render.quadtree import WIDE_LEVEL, Grid
from tronlab.render.raycast import (
    ROUNDING_M,
    inside_model,
    inverse_of,
    leaves_at,
    moved,
    stepped,
)
from tronlab.terrain.kernels import inlined, kernel

_BLOCK = 1 << int(WIDE_LEVEL)


def block_shape(grid: Grid) -> tuple[int, int]:
    """Give how many blocks of 4 x 4 cells a table of shadow reaches has along rows and columns."""
    n_rows, n_columns = grid.height_m.shape
    return (n_rows - 2) // _BLOCK + 1, (n_columns - 2) // _BLOCK + 1


@inlined
def shadow_reach(grid, lamp, reaches, r, c):
    """Give the part of the way to the lamp on which something may be in between.

    Args:
        grid: The surface.
        lamp: Where the lamp is.
        reaches: What has been found for the lamp, of ``block_shape``; 0: not known yet, is filled
            in. Threads may do so for the same block at once: they find the same value.
        r: Where the way begins, at most a cell beside a block's place on the surface.
        c: Where the way begins.
    """
    if not (0.0 <= r < grid.height_m.shape[0] - 1 and 0.0 <= c < grid.height_m.shape[1] - 1):
        return 1.0
    i, j = int(r) >> WIDE_LEVEL, int(c) >> WIDE_LEVEL
    if reaches[i, j] == 0.0:
        reaches[i, j] = _block_reach(grid, lamp, i, j)
    return float(reaches[i, j])


@kernel
def _block_reach(grid, lamp, i, j):
    """Give the reach of a block: look from the lamp for what is in the way to any place on it."""
    r0, c0, z0 = lamp[0], lamp[1], lamp[2]
    middle = (i + 0.5) * _BLOCK, (j + 0.5) * _BLOCK
    dr, dc, dz = middle[0] - r0, middle[1] - c0, _lowest_of_block(grid.height_m, i, j) - z0
    # The lamp's rays to the block stay within half a block of this one, so may it leave the model.
    margin = 0.5 * _BLOCK
    n_rows = grid.height_m.shape[0] - 1 + _BLOCK
    n_columns = grid.height_m.shape[1] - 1 + _BLOCK
    top = grid.top_m + ROUNDING_M
    t, end = inside_model(r0 + margin, c0 + margin, z0, dr, dc, dz, 1.0, n_rows, n_columns, top)
    if t < end:
        t = _bundle_depth(grid, r0, c0, z0, dr, dc, dz, t, end)
    return np.float32(min(1.0, (1.0 - t) * (1.0 + 1e-6) + 1e-9))


@inlined
def _lowest_of_block(height, i, j):
    """Give a height below all places on a block, and a cell around: rays start a little aside."""
    lowest = height[i * _BLOCK, j * _BLOCK]
    for k in range(max(i * _BLOCK - 1, 0), min((i + 1) * _BLOCK + 2, height.shape[0])):
        for m in range(max(j * _BLOCK - 1, 0), min((j + 1) * _BLOCK + 2, height.shape[1])):
            lowest = min(lowest, height[k, m])
    return float(lowest) - ROUNDING_M


@kernel
def _bundle_depth(grid, r0, c0, z0, dr, dc, dz, t, end):
    """Give t where a bundle of rays may first meet the surface, or else end.

    All rays must be within half a block of this one along r and c, and not below it. It may pass
    half a block outside the model.
    """
    level = grid.wide_columns.size - 1
    n_rows = grid.height_m.shape[0] - 1
    n_columns = grid.height_m.shape[1] - 1
    inverse_dr, inverse_dc, inverse_dz = inverse_of(dr), inverse_of(dc), inverse_of(dz)
    i = min(max(int(np.floor(r0 + t * dr)), -_BLOCK), n_rows + _BLOCK - 1)
    j = min(max(int(np.floor(c0 + t * dc)), -_BLOCK), n_columns + _BLOCK - 1)
    while True:
        t_row = leaves_at(i >> level, level, r0, dr, inverse_dr)
        t_column = leaves_at(j >> level, level, c0, dc, inverse_dc)
        t_out = max(t, min(t_row, t_column, end))
        highest = _widely_highest(grid, level, i, j)
        if z0 + min(t * dz, t_out * dz) <= highest:
            if z0 + t * dz > highest:
                t = min(max(t, (highest - z0) * inverse_dz), t_out)
                i = moved(i, r0 + t * dr, dr, level, n_rows + _BLOCK)
                j = moved(j, c0 + t * dc, dc, level, n_columns + _BLOCK)
            if level == WIDE_LEVEL:
                return t
            level -= 1
            continue
        if t_out >= end:
            return end
        t = t_out
        if t_row < t_column:
            j = moved(j, c0 + t * dc, dc, level, n_columns + _BLOCK)
            i, climbs = stepped(i, dr, level)
        else:
            i = moved(i, r0 + t * dr, dr, level, n_rows + _BLOCK)
            j, climbs = stepped(j, dc, level)
        if not (-_BLOCK <= i < n_rows + _BLOCK and -_BLOCK <= j < n_columns + _BLOCK):
            return end
        level = min(level + climbs, grid.wide_columns.size - 1)


@inlined
def _widely_highest(grid, level, i, j):
    row_start = grid.wide_start[level] + (i >> level) * grid.wide_columns[level]
    return grid.wide_max_m[row_start + (j >> level)]
