# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""Where a ray meets a height map: a walk through the squares of its quadtree.

The surface is that of ``surface``. Only its upper side is seen: a ray that starts below it, or
comes in below it through a side of the model, never meets it.

Rays run in grid coordinates: r and c count cells along the rows' and the columns' axis, z is in
metres over the map's height 0, and the ray's parameter t is the same in all of them, so that a ray
whose direction has depth 1 gives t as depth. A quadtree of maxima tells which squares of cells lie
wholly under the ray and can be skipped (Tevs, Ihrke and Seidel, I3D 2008). Its lowest level, single
cells, is read from the heights themselves.
"""

import numpy as np

from tronlab.render.surface import triangle
from tronlab.terrain.kernels import inlined, kernel

MISSED = -1.0
"""The ray leaves the model without meeting the surface."""
BELOW = -2.0
"""The ray starts below the surface."""
ROUNDING_M = 1e-9

_FAR = 1e300


@kernel
def first_hit(grid, r0, c0, z0, dr, dc, dz, t_end, level):
    """Find where a ray first meets the surface from above.

    The ray starts at (r0, c0, z0), in the model or outside, and runs along (dr, dc, dz), of any
    length and direction, to t_end of these lengths. The quadtree's level to begin at changes the
    time, not the result.

    Returns:
        t of the hit, 0 <= t <= t_end; or MISSED or BELOW.
    """
    n_rows = grid.height_m.shape[0] - 1
    n_columns = grid.height_m.shape[1] - 1
    t, end = inside_model(r0, c0, z0, dr, dc, dz, t_end, n_rows, n_columns, grid.top_m)
    if not t <= end:
        return MISSED
    i = min(max(int(r0 + t * dr), 0), n_rows - 1)
    j = min(max(int(c0 + t * dc), 0), n_columns - 1)
    if _is_below(grid, i, j, r0 + t * dr, c0 + t * dc, z0 + t * dz):
        return BELOW
    return _follow(grid, r0, c0, z0, dr, dc, dz, t, end, i, j, level)


@kernel
def _follow(grid, r0, c0, z0, dr, dc, dz, t, end, i, j, level):
    """Find the first hit from t on, where the ray is in cell (i, j) and above the surface."""
    n_rows = grid.height_m.shape[0] - 1
    n_columns = grid.height_m.shape[1] - 1
    inverse_dr, inverse_dc, inverse_dz = inverse_of(dr), inverse_of(dc), inverse_of(dz)
    level = min(level, grid.level_columns.size - 1)
    # i and j only ever move in the direction of the ray: the walk ends whatever the rounding.
    while True:
        t_row = leaves_at(i >> level, level, r0, dr, inverse_dr)
        t_column = leaves_at(j >> level, level, c0, dc, inverse_dc)
        t_out = max(t, min(t_row, t_column, end))
        z_in, z_out = z0 + t * dz, z0 + t_out * dz
        if level == 0:
            t_hit = _hit_in_cell(grid.height_m, i, j, r0, c0, z0, dr, dc, dz, t, t_out)
            if t_hit >= 0.0:
                return t_hit
        else:
            highest = _highest(grid, level, i, j)
            if min(z_in, z_out) <= highest:
                if z_in > highest:
                    t = min(max(t, (highest - z0) * inverse_dz), t_out)
                    i = moved(i, r0 + t * dr, dr, level, n_rows)
                    j = moved(j, c0 + t * dc, dc, level, n_columns)
                level -= 1
                continue
        if t_out >= end:
            return MISSED
        t = t_out
        if t_row < t_column:
            j = moved(j, c0 + t * dc, dc, level, n_columns)
            i, climbs = stepped(i, dr, level)
        else:
            i = moved(i, r0 + t * dr, dr, level, n_rows)
            j, climbs = stepped(j, dc, level)
        if not (0 <= i < n_rows and 0 <= j < n_columns):
            return MISSED
        level += climbs


@inlined
def _is_below(grid, i, j, r, c, z):
    if z >= grid.top_m - ROUNDING_M:
        return False
    low, slope_r, slope_c = triangle(grid.height_m, i, j, c - j >= r - i)
    return z < low + slope_r * (r - i) + slope_c * (c - j) - ROUNDING_M


@inlined
def inverse_of(direction):
    """Give 1 / direction, or 0 where the ray does not move along this axis."""
    return 1.0 / direction if abs(direction) > 1.0 / _FAR else 0.0


@inlined
def leaves_at(square, level, start, direction, inverse):
    """Give t where the ray leaves a square of the quadtree along one axis."""
    if inverse == 0.0:
        return _FAR
    return (((square + (direction > 0.0)) << level) - start) * inverse


@inlined
def _highest(grid, level, i, j):
    row_start = grid.level_start[level] + (i >> level) * grid.level_columns[level]
    return grid.node_max_m[row_start + (j >> level)]


@inlined
def moved(index, place, direction, level, n_cells):
    """Give the cell of a place within the present square, but never back against the ray."""
    square_start = (index >> level) << level
    if direction > 0.0:
        last = min(square_start + (1 << level) - 1, n_cells - 1)
        return min(max(int(np.floor(place)), index), last)
    return max(min(int(np.floor(place)), index), square_start)


@inlined
def stepped(index, direction, level):
    """Give the first cell of the next square, and 1 where that has another parent, else 0."""
    square = index >> level
    if direction > 0.0:
        return (square + 1) << level, square & 1
    return (square << level) - 1, 1 - (square & 1)


@inlined
def inside_model(r0, c0, z0, dr, dc, dz, t_end, n_rows, n_columns, top):
    """Give the part of a ray over the model's outline and not above its top; begin > end: none."""
    begin, end = _inside_slab(r0, dr, n_rows, 0.0, t_end)
    begin, end = _inside_slab(c0, dc, n_columns, begin, end)
    if dz < 0.0:
        begin = max(begin, (top - z0) / dz)
    elif dz > 0.0:
        end = min(end, (top - z0) / dz)
    elif z0 > top:
        return 1.0, 0.0
    return begin, end


@inlined
def _inside_slab(start, direction, width, begin, end):
    if abs(direction) <= 1.0 / _FAR:
        if start < 0.0 or start > width:
            return 1.0, 0.0
        return begin, end
    first = -start / direction
    last = (width - start) / direction
    return max(begin, min(first, last)), min(end, max(first, last))


@inlined
def _hit_in_cell(height, i, j, r0, c0, z0, dr, dc, dz, t_in, t_out):
    """Find where the ray meets the cell's triangles between t_in and t_out, or give MISSED."""
    lowest = min(z0 + t_in * dz, z0 + t_out * dz)
    if lowest > max(height[i, j], height[i, j + 1], height[i + 1, j], height[i + 1, j + 1]):
        return MISSED
    # The ray crosses the diagonal where c - j = r - i.
    ahead = (c0 - j) - (r0 - i)
    gain = dc - dr
    t_diagonal = -ahead / gain if gain != 0.0 else _FAR
    if not t_in < t_diagonal < t_out:
        t_diagonal = t_out
    begin, end = t_in, t_diagonal
    for _ in range(2):
        t_middle = 0.5 * (begin + end)
        low, slope_r, slope_c = triangle(height, i, j, ahead + t_middle * gain >= 0.0)
        over = z0 - low - slope_r * (r0 - i) - slope_c * (c0 - j)
        fall = dz - slope_r * dr - slope_c * dc
        if over + begin * fall <= 0.0:
            return begin
        if over + end * fall <= 0.0:
            return min(max(-over / fall, begin), end)
        if end == t_out:
            return MISSED
        begin, end = t_diagonal, t_out
    return MISSED
