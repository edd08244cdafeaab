# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""What light falls on the points that a tile's rays have met, looked up in the map of the lamp.

Does for lanes what ``surface.smooth_normal``, ``lamp.map.visibility_at`` and
``prefilter.filtered_at`` do for one point.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.render.lamp.map import LampMap
from tronlab.render.lanes.edges import settle_edges
from tronlab.render.lanes.rows import (
    COLUMN,
    DEPTH,
    IS_LIT,
    LAMP_X,
    LAMP_Y,
    LAMP_Z,
    LIGHT_SHARE,
    LIGHT_X,
    LIGHT_Y,
    LIGHT_Z,
    MEAN_PART,
    NODE_0_0,
    NODE_0_1,
    NODE_0_LEFT,
    NODE_0_RIGHT,
    NODE_1_0,
    NODE_1_1,
    NODE_1_LEFT,
    NODE_1_RIGHT,
    NODE_DOWN_0,
    NODE_DOWN_1,
    NODE_UP_0,
    NODE_UP_1,
    PART_C,
    PART_R,
    PER_DISTANCE,
    ROW,
    SHARE_00,
    SHARE_01,
    SHARE_10,
    SHARE_11,
    STATE,
    XY_00,
    XY_01,
    XY_10,
    XY_11,
    ZW_00,
    ZW_01,
    ZW_10,
    ZW_11,
    C,
    R,
)
from tronlab.render.lanes.stepping import HIT, held, least, limits
from tronlab.render.surface import albedo_at
from tronlab.terrain.kernels import inlined, kernel

_ZERO, _ONE, _TWO, _HALF = np.float32(0), np.float32(1), np.float32(2), np.float32(0.5)
_PER_SHARE = np.float32(1 / 255)
_PER_MEAN = np.float32(1 / 32767)
_FAR = 1e9
_LEAST_RADIUS_M = 1e-9
_PER_RISE = np.float32(2 / np.pi)
_SAMPLE = 16
"""The nearest depth is looked for among one lane in so many."""


class MapView(NamedTuple):
    """A ``LampMap`` as the lanes read it."""

    visibility: NDArray[np.uint8]
    radius_m: float
    """Of the lamp."""
    pairs: NDArray[np.int32]
    """Means of the pyramid, two in one: x and y, z and share, by turns."""
    level_start: NDArray[np.int64]
    level_rows: NDArray[np.int64]
    level_columns: NDArray[np.int64]


def map_view(lamp_map: LampMap, radius_m: float) -> MapView:
    """Give a map of the lamp as the lanes read it; nothing is copied."""
    pyramid = lamp_map.pyramid
    return MapView(
        lamp_map.visibility,
        float(radius_m),
        pyramid.means.reshape(-1).view(np.int32),
        pyramid.level_start,
        pyramid.level_rows,
        pyramid.level_columns,
    )


@kernel
def look_up(grid, light, lamp_map, frame, footprint, n_centres, n, floats, ints):
    """Fill in LIGHT of all lanes that count, and IS_LIT of the pixel centres.

    Args:
        grid: The surface.
        light: A ``Light``.
        lamp_map: A ``MapView``.
        frame: Where the lanes count from.
        footprint: Of a pixel; of no width: the light at the point is taken.
        n_centres: So many lanes come first whose rays go through pixel centres.
        n: The number of lanes.
        floats: Rows of floats.
        ints: Rows of integers.
    """
    nearest = frame.depth + _nearest(n, floats, ints)
    level = 0
    top_level = lamp_map.level_rows.size - 2
    while footprint.width * nearest >= (2 << level) and level < top_level:
        level += 1
    is_mean = footprint.width > 0.0 and top_level >= 0
    n_points = n_centres if is_mean and level > 0 else n
    _look_at_points(grid, lamp_map, frame, n_points, floats, ints)
    if light.disk_m.shape[0] == 1:
        settle_edges(grid, light, frame, n_points, floats, ints)
    if light.albedo.shape[0] > 0:
        _weigh_by_albedo(light.albedo, frame, n_points, floats)
    if is_mean:
        # As arrays of their own: LLVM has to see that the loops over them count from 0.
        first = n_centres if n > n_centres else 0
        others, states = floats[first:], ints[first:]
        _mix_in_means(lamp_map, frame, footprint, level, n - first, others, states)


@inlined
def _nearest(n, floats, ints):
    nearest = _FAR
    for k in range(0, n, _SAMPLE):
        if ints[STATE + k] == HIT:
            nearest = min(nearest, floats[DEPTH + k])
    return nearest if nearest < _FAR else 0.0


@kernel
def _look_at_points(grid, lamp_map, frame, n, floats, ints):
    """Fill in LIGHT, without albedo, and IS_LIT of the first lanes."""
    low_r, high_r = limits(frame.row, grid.height_m.shape[0] - 1)
    low_c, high_c = limits(frame.column, grid.height_m.shape[1] - 1)
    for k in range(n):
        r, c = held(floats[R + k], low_r, high_r), held(floats[C + k], low_c, high_c)
        row, column = np.floor(r), np.floor(c)
        ints[ROW + k], ints[COLUMN + k] = np.int32(row), np.int32(column)
        floats[PART_R + k], floats[PART_C + k] = r - row, c - column
    _read_nodes(grid.height_m, lamp_map.visibility, frame, n, floats, ints)
    spacing, per_two_cells = np.float32(grid.spacing_m), np.float32(0.5 / grid.spacing_m)
    radius = np.float32(max(lamp_map.radius_m, _LEAST_RADIUS_M))
    for k in range(n):
        a, b = floats[PART_R + k], floats[PART_C + k]
        h_0 = _mix(floats[NODE_0_0 + k], floats[NODE_0_1 + k], b)
        h_1 = _mix(floats[NODE_1_0 + k], floats[NODE_1_1 + k], b)
        h_up = _mix(floats[NODE_UP_0 + k], floats[NODE_UP_1 + k], b)
        h_down = _mix(floats[NODE_DOWN_0 + k], floats[NODE_DOWN_1 + k], b)
        x = -_mix(h_1 - h_up, h_down - h_0, a) * per_two_cells
        h_0 = _mix(floats[NODE_0_0 + k], floats[NODE_1_0 + k], a)
        h_1 = _mix(floats[NODE_0_1 + k], floats[NODE_1_1 + k], a)
        h_left = _mix(floats[NODE_0_LEFT + k], floats[NODE_1_LEFT + k], a)
        h_right = _mix(floats[NODE_0_RIGHT + k], floats[NODE_1_RIGHT + k], a)
        y = -_mix(h_1 - h_left, h_right - h_0, b) * per_two_cells
        share_0 = _mix(np.float32(ints[SHARE_00 + k]), np.float32(ints[SHARE_01 + k]), b)
        share_1 = _mix(np.float32(ints[SHARE_10 + k]), np.float32(ints[SHARE_11 + k]), b)
        share = _mix(share_0, share_1, a) * _PER_SHARE
        faces_it = x * floats[LAMP_X + k] + y * floats[LAMP_Y + k] + floats[LAMP_Z + k] > _ZERO
        share = least(share, _share_over_facet(k, a, b, spacing, radius, floats))
        share = share if faces_it & (ints[STATE + k] == HIT) else _ZERO
        up_part = share / np.sqrt(x * x + y * y + _ONE)
        floats[LIGHT_X + k], floats[LIGHT_Y + k] = x * up_part, y * up_part
        floats[LIGHT_Z + k], floats[LIGHT_SHARE + k] = up_part, share
        ints[IS_LIT + k] = np.int32(share >= _HALF)


@inlined
def _share_over_facet(k, a, b, spacing, radius, floats):
    """Give the share of the lamp over the plane of the triangle that a point lies on.

    In the segment of a disk the series of the arc sine ends after its first term.
    """
    node_00, node_01 = floats[NODE_0_0 + k], floats[NODE_0_1 + k]
    node_10, node_11 = floats[NODE_1_0 + k], floats[NODE_1_1 + k]
    is_upper = b >= a
    rise_r = node_11 - node_01 if is_upper else node_10 - node_00
    rise_c = node_01 - node_00 if is_upper else node_11 - node_10
    up = floats[LAMP_Z + k] * spacing
    up -= rise_r * floats[LAMP_X + k] + rise_c * floats[LAMP_Y + k]
    normal = np.sqrt(spacing * spacing + rise_r * rise_r + rise_c * rise_c)
    s = held(up / (normal * radius * floats[PER_DISTANCE + k]), -_ONE, _ONE)
    return _HALF + s * (_PER_RISE - s * s * (_PER_RISE - _HALF))


@inlined
def _read_nodes(height, shares, frame, n, floats, ints):
    """Read the heights around each lane's cell and how much of the lamp its nodes see."""
    last_row, last_column = height.shape[0] - 1, height.shape[1] - 1
    n_at_border = 0
    for k in range(n):
        i, j = ints[ROW + k] + frame.row, ints[COLUMN + k] + frame.column
        up, down = max(i - 1, 0), min(i + 2, last_row)
        left, right = max(j - 1, 0), min(j + 2, last_column)
        n_at_border += (down - up != 3) | (right - left != 3)
        u, d, row, below = np.uint64(up), np.uint64(down), np.uint64(i), np.uint64(i + 1)
        before, after = np.uint64(left), np.uint64(right)
        column, beside = np.uint64(j), np.uint64(j + 1)
        floats[NODE_UP_0 + k] = height[u, column]
        floats[NODE_UP_1 + k] = height[u, beside]
        floats[NODE_0_LEFT + k] = height[row, before]
        floats[NODE_0_0 + k] = height[row, column]
        floats[NODE_0_1 + k] = height[row, beside]
        floats[NODE_0_RIGHT + k] = height[row, after]
        floats[NODE_1_LEFT + k] = height[below, before]
        floats[NODE_1_0 + k] = height[below, column]
        floats[NODE_1_1 + k] = height[below, beside]
        floats[NODE_1_RIGHT + k] = height[below, after]
        floats[NODE_DOWN_0 + k] = height[d, column]
        floats[NODE_DOWN_1 + k] = height[d, beside]
        ints[SHARE_00 + k] = shares[row, column]
        ints[SHARE_01 + k] = shares[row, beside]
        ints[SHARE_10 + k] = shares[below, column]
        ints[SHARE_11 + k] = shares[below, beside]
    if n_at_border > 0:
        _continue_past_border(frame, last_row, last_column, n, floats, ints)


@inlined
def _mix(a, b, part):
    return a + part * (b - a)


@kernel
def _continue_past_border(frame, last_row, last_column, n, floats, ints):
    """Continue the surface straight where there are no nodes: one-sided steps at the border."""
    for k in range(n):
        i, j = ints[ROW + k] + frame.row, ints[COLUMN + k] + frame.column
        if i == 0:
            floats[NODE_UP_0 + k] = _TWO * floats[NODE_0_0 + k] - floats[NODE_1_0 + k]
            floats[NODE_UP_1 + k] = _TWO * floats[NODE_0_1 + k] - floats[NODE_1_1 + k]
        if i + 1 == last_row:
            floats[NODE_DOWN_0 + k] = _TWO * floats[NODE_1_0 + k] - floats[NODE_0_0 + k]
            floats[NODE_DOWN_1 + k] = _TWO * floats[NODE_1_1 + k] - floats[NODE_0_1 + k]
        if j == 0:
            floats[NODE_0_LEFT + k] = _TWO * floats[NODE_0_0 + k] - floats[NODE_0_1 + k]
            floats[NODE_1_LEFT + k] = _TWO * floats[NODE_1_0 + k] - floats[NODE_1_1 + k]
        if j + 1 == last_column:
            floats[NODE_0_RIGHT + k] = _TWO * floats[NODE_0_1 + k] - floats[NODE_0_0 + k]
            floats[NODE_1_RIGHT + k] = _TWO * floats[NODE_1_1 + k] - floats[NODE_1_0 + k]


@inlined
def _weigh_by_albedo(albedo, frame, n, floats):
    for k in range(n):
        if floats[LIGHT_SHARE + k] > _ZERO:
            r, c = float(floats[R + k]) + frame.row, float(floats[C + k]) + frame.column
            here = np.float32(albedo_at(albedo, r, c))
            floats[LIGHT_X + k] *= here
            floats[LIGHT_Y + k] *= here
            floats[LIGHT_Z + k] *= here
            floats[LIGHT_SHARE + k] *= here


@inlined
def _mix_in_means(lamp_map, frame, footprint, level, n, floats, ints):
    """Mix LIGHT of the two levels that a pixel's width lies between; level 0 is at the point."""
    width, depth = np.float32(footprint.width / (1 << level)), np.float32(frame.depth)
    for k in range(n):
        part = held(width * (depth + floats[DEPTH + k]) - _ONE, _ZERO, _ONE)
        floats[MEAN_PART + k] = part
        at_point = _ONE - part
        for light in (LIGHT_X, LIGHT_Y, LIGHT_Z, LIGHT_SHARE):
            floats[light + k] = at_point * floats[light + k] if level == 0 else _ZERO
    for probe in range(footprint.n_probes):
        along = (probe + 0.5) / footprint.n_probes - 0.5
        if level > 0:
            _add_means(lamp_map, frame, footprint, along, level, True, n, floats, ints)
        _add_means(lamp_map, frame, footprint, along, level + 1, False, n, floats, ints)


@kernel
def _add_means(lamp_map, frame, footprint, along, level, is_finer, n, floats, ints):
    """Add to LIGHT the mean on squares of one of two levels, as much of it as MEAN_PART says.

    Interpolates bilinearly between the middles of four squares.
    """
    n_rows, n_columns = lamp_map.level_rows[level], lamp_map.level_columns[level]
    per_cell = np.float32(1.0 / (1 << level))
    # Counted in squares from the middle of the first one.
    offset_r = np.float32((frame.row + 0.5) / (1 << level) - 0.5)
    offset_c = np.float32((frame.column + 0.5) / (1 << level) - 0.5)
    aside_r, aside_c = np.float32(along * footprint.long_r), np.float32(along * footprint.long_c)
    depth, last_r, last_c = (
        np.float32(frame.depth),
        np.float32(n_rows - 1),
        np.float32(n_columns - 1),
    )
    inner_r, inner_c = np.float32(max(n_rows - 2, 0)), np.float32(max(n_columns - 2, 0))
    for k in range(n):
        t = depth + floats[DEPTH + k]
        r = held((floats[R + k] + t * aside_r) * per_cell + offset_r, _ZERO, last_r)
        c = held((floats[C + k] + t * aside_c) * per_cell + offset_c, _ZERO, last_c)
        row, column = held(np.floor(r), _ZERO, inner_r), held(np.floor(c), _ZERO, inner_c)
        ints[ROW + k], ints[COLUMN + k] = np.int32(row), np.int32(column)
        floats[PART_R + k], floats[PART_C + k] = r - row, c - column
    start, pairs = lamp_map.level_start[level], lamp_map.pairs
    to_right = np.uint64(2 if n_columns > 1 else 0)
    to_below = np.uint64(2 * n_columns if n_rows > 1 else 0)
    second = np.uint64(1)
    for k in range(n):
        at = np.uint64(2 * (start + ints[ROW + k] * n_columns + ints[COLUMN + k]))
        ints[XY_00 + k] = pairs[at]
        ints[ZW_00 + k] = pairs[at + second]
        ints[XY_01 + k] = pairs[at + to_right]
        ints[ZW_01 + k] = pairs[at + to_right + second]
        at += to_below
        ints[XY_10 + k] = pairs[at]
        ints[ZW_10 + k] = pairs[at + second]
        ints[XY_11 + k] = pairs[at + to_right]
        ints[ZW_11 + k] = pairs[at + to_right + second]
    per_probe = np.float32(1.0 / footprint.n_probes) * _PER_MEAN
    for k in range(n):
        a, b = floats[PART_R + k], floats[PART_C + k]
        part = _ONE - floats[MEAN_PART + k] if is_finer else floats[MEAN_PART + k]
        part *= per_probe
        w_1 = a * part
        w_0 = part - w_1
        w_01, w_11 = w_0 * b, w_1 * b
        w_00, w_10 = w_0 - w_01, w_1 - w_11
        v_00, v_01, v_10, v_11 = ints[XY_00 + k], ints[XY_01 + k], ints[XY_10 + k], ints[XY_11 + k]
        floats[LIGHT_X + k] += (
            w_00 * _low(v_00) + w_01 * _low(v_01) + w_10 * _low(v_10) + w_11 * _low(v_11)
        )
        floats[LIGHT_Y + k] += (
            w_00 * _high(v_00) + w_01 * _high(v_01) + w_10 * _high(v_10) + w_11 * _high(v_11)
        )
        v_00, v_01, v_10, v_11 = ints[ZW_00 + k], ints[ZW_01 + k], ints[ZW_10 + k], ints[ZW_11 + k]
        floats[LIGHT_Z + k] += (
            w_00 * _low(v_00) + w_01 * _low(v_01) + w_10 * _low(v_10) + w_11 * _low(v_11)
        )
        floats[LIGHT_SHARE + k] += (
            w_00 * _high(v_00) + w_01 * _high(v_01) + w_10 * _high(v_10) + w_11 * _high(v_11)
        )


@inlined
def _low(pair):
    """Give the first of two values of 16 bits."""
    return np.float32(np.int32(np.int32(pair << 16) >> 16))


@inlined
def _high(pair):
    """Give the second of two values of 16 bits."""
    return np.float32(np.int32(pair >> 16))
