# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""Rays of a tile stepped together: each step one short loop over all of them.

A loop either reads the surface at scattered places or calculates, without a branch, so that LLVM
makes vector instructions of the calculating ones. For that they know 32-bit numbers only: a
64-bit one among them halves the speed or ends it. ``benchmarks/render_speed.py`` guards this.

Positions are counted from a corner of the quadtree near the tile's start and ray parameters from
its start depth: so small, 32 bits hold them to a micrometre.
"""

from typing import NamedTuple

import numpy as np

from tronlab.render.lanes.rows import (
    COLUMN,
    DEPTH,
    END,
    FAR_SIDE_C,
    FAR_SIDE_R,
    HIGHEST,
    INVERSE_C,
    INVERSE_R,
    INVERSE_Z,
    LEVEL,
    NODE_00,
    NODE_01,
    NODE_10,
    NODE_11,
    NUDGE,
    ROW,
    SIZE,
    START_C,
    START_R,
    START_Z,
    STATE,
    TOWARDS_C,
    TOWARDS_R,
    TOWARDS_Z,
)
from tronlab.render.surface import triangle
from tronlab.terrain.kernels import inlined, kernel

TOP_LEVEL = 9
"""Rays skip squares of at most so many levels; positions count from a corner of such a square."""

IN_SQUARE = np.int32(1)
IN_CELL = np.int32(0)
MISSED = np.int32(-1)
HIT = np.int32(-2)

_ZERO, _ONE, _TWO, _HALF = np.float32(0), np.float32(1), np.float32(2), np.float32(0.5)
_LARGEST = np.float32(1e9)
_SMALLEST = np.float32(1e-9)
_BELOW_ONE = np.float32(1 - 2.0**-22)
_NUDGE_CELLS = np.float32(1e-3)
_SIDE_NUDGES = np.float32(100)
_MARGIN_M = np.float32(1e-5)
_ROUNDING_M = np.float32(1e-6)
_FIRST_LEVEL = 3
_NEXT = np.uint64(1)
_FEW = 8
"""Cells are looked at when only one ray in so many is still among larger squares."""


class Frame(NamedTuple):
    """Where a tile's rays count from."""

    depth: float
    """The tile's start depth."""
    row: int
    """Cell (row, column) whose near corner is the origin: a multiple of 2**TOP_LEVEL."""
    column: int


@kernel
def aim_lanes(grid, eye, grid_from_cam, middle, offset, depth, floats, ints):
    """Set a tile's rays at their start: at the start depth or where they enter the model.

    Args:
        grid: The surface.
        eye: The camera in grid coordinates, shape (3,).
        grid_from_cam: Rotation, shape (3, 3), its first two rows in cells a metre.
        middle: Middle of the tile's rays (x, y).
        offset: From there to each ray, shape (2, lanes).
        depth: The start depth.
        floats: Rows of floats to fill.
        ints: Rows of integers to fill.

    Returns:
        The frame in which the lanes count.
    """
    m = grid_from_cam
    n_rows, n_columns = grid.height_m.shape[0] - 1, grid.height_m.shape[1] - 1
    dr = m[0, 0] * middle[0] + m[0, 1] * middle[1] + m[0, 2]
    dc = m[1, 0] * middle[0] + m[1, 1] * middle[1] + m[1, 2]
    dz = m[2, 0] * middle[0] + m[2, 1] * middle[1] + m[2, 2]
    r, c, z = eye[0] + depth * dr, eye[1] + depth * dc, eye[2] + depth * dz
    frame = Frame(depth, _corner(r, n_rows), _corner(c, n_columns))
    size = np.float32(1 << min(_FIRST_LEVEL, grid.level_columns.size - 1))
    level = np.int32(min(_FIRST_LEVEL, grid.level_columns.size - 1))
    n = offset.shape[1]
    _spread(START_R, TOWARDS_R, INVERSE_R, m[0], r - frame.row, dr, depth, offset, floats)
    _spread(START_C, TOWARDS_C, INVERSE_C, m[1], c - frame.column, dc, depth, offset, floats)
    _spread(START_Z, TOWARDS_Z, INVERSE_Z, m[2], z, dz, depth, offset, floats)
    first_r, last_r = np.float32(-frame.row), np.float32(n_rows - frame.row)
    first_c, last_c = np.float32(-frame.column), np.float32(n_columns - frame.column)
    top, bottom = np.float32(grid.top_m) + _MARGIN_M, np.float32(grid.bottom_m) - _MARGIN_M
    n_entering = np.int32(0)
    for k in range(n):
        inverse_r, inverse_c = floats[INVERSE_R + k], floats[INVERSE_C + k]
        nudge = _NUDGE_CELLS * least(abs(inverse_r), abs(inverse_c))
        r_1 = (first_r - floats[START_R + k]) * inverse_r
        r_2 = (last_r - floats[START_R + k]) * inverse_r
        c_1 = (first_c - floats[START_C + k]) * inverse_c
        c_2 = (last_c - floats[START_C + k]) * inverse_c
        entry = _greatest(least(r_1, r_2), least(c_1, c_2))
        # A nudge may carry a ray past the bottom before it is told what lies there.
        to = bottom if floats[TOWARDS_Z + k] < _ZERO else top
        end = (to - floats[START_Z + k]) * floats[INVERSE_Z + k] + _TWO * nudge
        end = least(least(_greatest(r_1, r_2), _greatest(c_1, c_2)), end)
        t = _greatest(entry, _ZERO)
        floats[DEPTH + k] = t
        floats[END + k] = end
        floats[SIZE + k] = size
        ints[LEVEL + k] = level
        ints[STATE + k] = IN_SQUARE if t < end else MISSED
        floats[FAR_SIDE_R + k] = _ONE if inverse_r > _ZERO else _ZERO
        floats[FAR_SIDE_C + k] = _ONE if inverse_c > _ZERO else _ZERO
        floats[NUDGE + k] = nudge
        # The tile's start depth itself may be where rays enter, but for rounding.
        n_entering = np.int32(n_entering + (entry > -_SIDE_NUDGES * nudge))
    if n_entering > 0 or depth == 0.0:
        _drop_buried(grid, frame, n, floats, ints)
    return frame


@inlined
def _corner(place, n_cells):
    cell = min(max(int(place), 0), n_cells - 1)
    return cell >> TOP_LEVEL << TOP_LEVEL


@inlined
def _spread(start, towards, inverse, row, middle_start, middle_towards, depth, offset, floats):
    """Fill in the rays' start and direction along one axis."""
    along_x, along_y = np.float32(row[0]), np.float32(row[1])
    first, direction, t = np.float32(middle_start), np.float32(middle_towards), np.float32(depth)
    for k in range(offset.shape[1]):
        aside = along_x * offset[0, k] + along_y * offset[1, k]
        d = direction + aside
        floats[start + k] = first + t * aside
        floats[towards + k] = d
        floats[inverse + k] = _ONE / d if abs(d) > _SMALLEST else _LARGEST


@inlined
def _drop_buried(grid, frame, n, floats, ints):
    """Let rays miss that start below the surface or come in below it through a side."""
    low_r, high_r = limits(frame.row, grid.height_m.shape[0] - 1)
    low_c, high_c = limits(frame.column, grid.height_m.shape[1] - 1)
    for k in range(n):
        if ints[STATE + k] == IN_SQUARE:
            t = floats[DEPTH + k]
            r = _along(START_R, TOWARDS_R, k, t, low_r, high_r, floats)
            c = _along(START_C, TOWARDS_C, k, t, low_c, high_c, floats)
            z = floats[START_Z + k] + t * floats[TOWARDS_Z + k]
            i, j = int(np.floor(r)), int(np.floor(c))
            a, b = r - i, c - j
            height, rise_r, rise_c = triangle(
                grid.height_m, i + frame.row, j + frame.column, b >= a
            )
            if z < height + rise_r * a + rise_c * b - _ROUNDING_M:
                ints[STATE + k] = MISSED


@kernel
def follow_lanes(grid, frame, n, floats, ints, level_start):
    """Find where the lanes' rays first meet the surface.

    Args:
        grid: The surface.
        frame: Where the lanes count from.
        n: The number of lanes.
        floats: Rows of floats; DEPTH becomes that of the hit.
        ints: Rows of integers; STATE becomes HIT or MISSED.
        level_start: Room for TOP_LEVEL + 1 numbers.
    """
    n_levels = min(grid.level_columns.size, TOP_LEVEL + 1)
    for level in range(1, n_levels):
        level_start[level] = (
            grid.level_start[level]
            + (frame.row >> level) * grid.level_columns[level]
            + (frame.column >> level)
        )
    n_walking = n
    while n_walking > 0:
        n_walking = _skip_squares(grid, frame, n, floats, ints, level_start, n_levels - 1)
        while n_walking * _FEW >= n:
            n_walking = _skip_squares(grid, frame, n, floats, ints, level_start, n_levels - 1)
        n_walking += _try_cells(grid, frame, n, floats, ints)


@kernel
def _skip_squares(grid, frame, n, floats, ints, level_start, top_level):
    """Let each ray IN_SQUARE pass its square, or go down to its height and look closer.

    Returns:
        How many rays are among squares still.
    """
    low_r, high_r = limits(frame.row, grid.height_m.shape[0] - 1)
    low_c, high_c = limits(frame.column, grid.height_m.shape[1] - 1)
    for k in range(n):
        t, per_cell = floats[DEPTH + k], _ONE / floats[SIZE + k]
        r = _along(START_R, TOWARDS_R, k, t, low_r, high_r, floats)
        c = _along(START_C, TOWARDS_C, k, t, low_c, high_c, floats)
        ints[ROW + k] = np.int32(np.floor(r * per_cell))
        ints[COLUMN + k] = np.int32(np.floor(c * per_cell))
    for k in range(n):
        level = ints[LEVEL + k]
        row_start = level_start[level] + ints[ROW + k] * grid.level_columns[level]
        floats[HIGHEST + k] = grid.node_max_m[row_start + ints[COLUMN + k]]
    largest = np.float32(1 << top_level)
    n_walking = np.int32(0)
    for k in range(n):
        t, size, highest = floats[DEPTH + k], floats[SIZE + k], floats[HIGHEST + k]
        r = _along(START_R, TOWARDS_R, k, t, low_r, high_r, floats)
        c = _along(START_C, TOWARDS_C, k, t, low_c, high_c, floats)
        z = floats[START_Z + k] + t * floats[TOWARDS_Z + k]
        t_out = _way_out(k, r, c, ints[ROW + k], ints[COLUMN + k], size, floats)
        passes = least(z, z + t_out * floats[TOWARDS_Z + k]) > highest
        t_down = (highest - z) * floats[INVERSE_Z + k] if z > highest else _ZERO
        t_next = t + (t_out + floats[NUDGE + k] if passes else t_down)
        was_among = ints[STATE + k] == IN_SQUARE
        goes_on = was_among & (t_next < floats[END + k])
        level = ints[LEVEL + k]
        size_next = least(_TWO * size, largest) if passes else _greatest(_HALF * size, _TWO)
        level_next = np.int32(min(level + 1, top_level) if passes else max(level - 1, 1))
        state = IN_CELL if (level == 1) & (not passes) else IN_SQUARE
        state = state if goes_on else MISSED
        state = state if was_among else ints[STATE + k]
        floats[DEPTH + k] = t_next if goes_on else t
        floats[SIZE + k] = size_next if was_among else size
        ints[LEVEL + k] = level_next if was_among else level
        ints[STATE + k] = state
        n_walking = np.int32(n_walking + (state == IN_SQUARE))
    return n_walking


@kernel
def _try_cells(grid, frame, n, floats, ints):
    """Let each ray IN_CELL meet the cell's triangles, or pass on to the next square.

    On the triangle towards (i + 1, j) the surface's height is a plane, on the other that plane and
    a multiple of the distance from the diagonal: so the ray's height over the surface is linear
    from here to the diagonal and from there to the way out, and three values of it tell all.

    Returns:
        How many rays pass on.
    """
    low_r, high_r = limits(frame.row, grid.height_m.shape[0] - 1)
    low_c, high_c = limits(frame.column, grid.height_m.shape[1] - 1)
    for k in range(n):
        t = floats[DEPTH + k]
        ints[ROW + k] = np.int32(np.floor(_along(START_R, TOWARDS_R, k, t, low_r, high_r, floats)))
        ints[COLUMN + k] = np.int32(
            np.floor(_along(START_C, TOWARDS_C, k, t, low_c, high_c, floats))
        )
    for k in range(n):
        i, j = np.uint64(ints[ROW + k] + frame.row), np.uint64(ints[COLUMN + k] + frame.column)
        floats[NODE_00 + k] = grid.height_m[i, j]
        floats[NODE_01 + k] = grid.height_m[i, j + _NEXT]
        floats[NODE_10 + k] = grid.height_m[i + _NEXT, j]
        floats[NODE_11 + k] = grid.height_m[i + _NEXT, j + _NEXT]
    n_passing = np.int32(0)
    for k in range(n):
        t, end = floats[DEPTH + k], floats[END + k]
        r = _along(START_R, TOWARDS_R, k, t, low_r, high_r, floats)
        c = _along(START_C, TOWARDS_C, k, t, low_c, high_c, floats)
        t_out = _way_out(k, r, c, ints[ROW + k], ints[COLUMN + k], _ONE, floats)
        t_out = _greatest(least(t_out, end - t), _ZERO)
        dr, dc = floats[TOWARDS_R + k], floats[TOWARDS_C + k]
        node_00, node_10, node_11 = floats[NODE_00 + k], floats[NODE_10 + k], floats[NODE_11 + k]
        rise_r, rise_c = node_10 - node_00, node_11 - node_10
        twist = rise_c - (floats[NODE_01 + k] - node_00)
        a, b = r - np.float32(ints[ROW + k]), c - np.float32(ints[COLUMN + k])
        z = floats[START_Z + k] + t * floats[TOWARDS_Z + k]
        over, fall = (
            z - node_00 - a * rise_r - b * rise_c,
            floats[TOWARDS_Z + k] - rise_r * dr - rise_c * dc,
        )
        ahead, gain = a - b, dr - dc
        t_diagonal = -ahead / gain
        t_diagonal = t_diagonal if (t_diagonal > _ZERO) & (t_diagonal < t_out) else t_out
        over_0 = over - twist * least(ahead, _ZERO)
        over_1 = over + t_diagonal * fall - twist * least(ahead + t_diagonal * gain, _ZERO)
        over_2 = over + t_out * fall - twist * least(ahead + t_out * gain, _ZERO)
        t_first = t_diagonal * over_0 / (over_0 - over_1)
        t_second = t_diagonal + (t_out - t_diagonal) * over_1 / (over_1 - over_2)
        t_hit = t_first if over_1 <= _ZERO else t_second
        # The nudge may have carried the ray below the surface.
        t_back = over_0 / (twist * gain - fall if ahead < _ZERO else -fall)
        t_hit = _greatest(least(t_back, _ZERO), -floats[NUDGE + k]) if over_0 <= _ZERO else t_hit
        is_hit = (over_0 <= _ZERO) | (over_1 <= _ZERO) | (over_2 <= _ZERO)
        t_next = t + t_out + floats[NUDGE + k]
        was_in_cell = ints[STATE + k] == IN_CELL
        state = IN_SQUARE if t_next < end else MISSED
        state = HIT if is_hit else state
        t_next = t + t_hit if is_hit else t_next
        floats[DEPTH + k] = t_next if was_in_cell & (state != MISSED) else t
        ints[STATE + k] = state if was_in_cell else ints[STATE + k]
        n_passing = np.int32(n_passing + (was_in_cell & (state == IN_SQUARE)))
    return n_passing


@inlined
def limits(corner, n_cells):
    """Give the least and the largest coordinate whose cell lies in the model, along one axis."""
    return np.float32(-corner), np.float32(n_cells - corner) * _BELOW_ONE


@inlined
def _along(start, towards, k, t, low, high, floats):
    """Give a ray's coordinate along one axis, held within the model."""
    return held(floats[start + k] + t * floats[towards + k], low, high)


@inlined
def held(value, low, high):
    """Give the value, or the limit that it is beyond."""
    return least(_greatest(value, low), high)


@inlined
def _way_out(k, r, c, row, column, size, floats):
    """Give how far it is to where a ray leaves its square."""
    side_r = (np.float32(row) + floats[FAR_SIDE_R + k]) * size
    side_c = (np.float32(column) + floats[FAR_SIDE_C + k]) * size
    t_r, t_c = (side_r - r) * floats[INVERSE_R + k], (side_c - c) * floats[INVERSE_C + k]
    return _greatest(least(t_r, t_c), _ZERO)


@inlined
def least(a, b):
    """Give the smaller one; a comparison as vector instructions know it, unlike Python's min."""
    return a if a < b else b


@inlined
def _greatest(a, b):
    return a if a > b else b
