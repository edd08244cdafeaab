# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""How far a beam of neighbouring rays runs before any of them can meet the surface."""

import numpy as np

from tronlab.terrain.kernels import inlined, kernel

_ROUNDING_M = 1e-6
_LEAST_GAIN = 0.02
"""A beam that comes on by less than this part of a square has arrived."""


@kernel
def start_depth(grid, eye, direction, half_width):
    """Give a depth before which no ray of a beam meets the surface.

    The beam's ground is looked up in squares of the quadtree that are at least as wide as the beam,
    so that a few of them cover it.

    Args:
        grid: The surface.
        eye: Where the rays start, in grid coordinates (r, c, z).
        direction: The middle ray's direction (dr, dc, dz).
        half_width: How far other rays' directions lie from it, along r, c and z.

    Returns:
        The depth; infinity if every ray misses the model.
    """
    n_rows, n_columns = grid.height_m.shape[0] - 1, grid.height_m.shape[1] - 1
    r0, c0, z0 = eye
    dr, dc, dz = direction
    wr, wc, wz = half_width
    begin, end = _while_over(r0, dr, wr, n_rows, 0.0, np.inf)
    begin, end = _while_over(c0, dc, wc, n_columns, begin, end)
    begin, end = _while_between(z0, dz, wz, grid.bottom_m, grid.top_m, begin, end)
    if begin > end or begin == np.inf:
        return np.inf
    lowest_dz = dz - wz
    fastest = max(abs(dr) + wr, abs(dc) + wc)
    t = begin
    while lowest_dz < 0.0:
        level = _level_for(2.0 * t * max(wr, wc), grid.level_columns.size)
        step = ((1 << level) - 1) / fastest
        rows = _passed(r0, dr, wr, t, t + step)
        columns = _passed(c0, dc, wc, t, t + step)
        t_down = (_highest_on(grid, level, rows, columns) + _ROUNDING_M - z0) / lowest_dz
        on = max(min(t + step, t_down), t)
        if on > end:
            return np.inf
        if on - t < _LEAST_GAIN * step:
            return t
        t = on
    return t


@inlined
def _while_over(start, direction, half_width, n_cells, begin, end):
    """Give the part of the way on which any ray of the beam is over the model, along one axis."""
    fastest, slowest = direction + half_width, direction - half_width
    begin, end = _while_not_above(-start, -fastest, begin, end)
    return _while_not_above(start - n_cells, slowest, begin, end)


@inlined
def _while_between(start, direction, half_width, bottom, top, begin, end):
    """Give the part on which any ray of the beam is between the model's bottom and its top."""
    margin = _ROUNDING_M
    begin, end = _while_not_above(start - top - margin, direction - half_width, begin, end)
    return _while_not_above(bottom - margin - start, -direction - half_width, begin, end)


@inlined
def _while_not_above(value, slope, begin, end):
    """Give the part of begin .. end on which ``value + t * slope`` is not above 0."""
    if slope > 0.0:
        return begin, min(end, -value / slope)
    if slope < 0.0:
        return max(begin, -value / slope), end
    return (begin, end) if value <= 0.0 else (np.inf, end)


@inlined
def _level_for(width, n_levels):
    """Give the level whose squares are at least as wide."""
    level = 1
    while (1 << level) < width + 1.0 and level < n_levels - 1:
        level += 1
    return level


@inlined
def _passed(start, direction, half_width, t, t_next):
    """Give the least and the largest coordinate of the beam's rays between two depths."""
    slowest, fastest = direction - half_width, direction + half_width
    return (
        start + min(t * slowest, t_next * slowest),
        start + max(t * fastest, t_next * fastest),
    )


@inlined
def _highest_on(grid, level, rows, columns):
    """Give the largest height on the squares of a level between two rows and two columns."""
    top, bottom = _squares(rows, level, grid.height_m.shape[0] - 1)
    left, right = _squares(columns, level, grid.height_m.shape[1] - 1)
    highest = -np.inf
    for i in range(top, bottom + 1):
        row_start = grid.level_start[level] + i * grid.level_columns[level]
        for j in range(left, right + 1):
            highest = max(highest, grid.node_max_m[row_start + j])
    return highest


@inlined
def _squares(span, level, n_cells):
    """Give the first and the last square that a span of cells touches."""
    first = int(np.floor(span[0])) >> level
    last = int(np.floor(span[1])) >> level
    return max(first, 0), min(last, (n_cells - 1) >> level)
