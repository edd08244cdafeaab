# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""Compiled kernels: rays against a height map, and the light they find there.

The surface: in each cell of four nodes two triangles that share the edge from node (i, j) to node
(i + 1, j + 1). Only its upper side is seen: a ray that starts below it, or comes in below it
through a side of the model, never meets it.

Rays run in grid coordinates: r and c count cells along the rows' and the columns' axis, z is in
metres over the map's height 0, and the ray's parameter t is the same in all of them, so that a ray
whose direction has depth 1 gives t as depth. A quadtree of maxima tells which squares of cells lie
wholly under the ray and can be skipped (Tevs, Ihrke and Seidel, I3D 2008). Its lowest level, single
cells, is read from the heights themselves. A second quadtree, of maxima over wider squares, does
the same for bundles of rays at once: it tells from which depth on the rays of neighbouring pixels,
and how far the rays from neighbouring places to the lamp, have to be followed one by one.

All kernels that call each other stay in this file: numba's cache on disk only notices changes of
the file that a kernel is in.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.render.kernels import inlined, kernel
from tronlab.render.quadtree import WIDE_LEVEL, Grid

MISSED = -1.0
"""The ray leaves the model without meeting the surface."""
BELOW = -2.0
"""The ray starts below the surface."""
LAMBERT = 0
LUNAR_LAMBERT = 1

_FAR = 1e300
_ROUNDING_M = 1e-9
_BUNDLE_PX = 4
# Levels are numpy's integers: numba would compile a kernel anew for each Python constant given.
_VIEW_LEVEL = np.int64(6)
_BUNDLE_LEVEL = np.int64(3)
_SHADOW_LEVEL = np.int64(1)
_BLOCK = 1 << int(WIDE_LEVEL)
_SHADOW_OFFSET_M = 2e-5


class View(NamedTuple):
    """Camera and lamp in grid coordinates: two in cells, the third in metres."""

    origin_trs_m: NDArray[np.float64]
    """Where the grid's origin lies."""
    eye: NDArray[np.float64]
    grid_from_cam: NDArray[np.float64]
    """Rotation, shape (3, 3), its first two rows in cells a metre."""
    lamp: NDArray[np.float64]
    intensity: float
    photometry: int
    """LAMBERT or LUNAR_LAMBERT."""
    shadow_reach: NDArray[np.float32]
    """For each block of 4 x 4 cells, which part of the way to the lamp the surface can come in
    between; 0: not known yet, ``_is_in_shadow`` fills it in. Another lamp needs another table."""


def block_shape(grid: Grid) -> tuple[int, int]:
    """Give how many blocks a table of shadow reaches has along rows and columns."""
    n_rows, n_columns = grid.height_m.shape
    return (n_rows - 2) // _BLOCK + 1, (n_columns - 2) // _BLOCK + 1


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
    t, end = _inside_model(r0, c0, z0, dr, dc, dz, t_end, n_rows, n_columns, grid.top_m)
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
    inverse_dr, inverse_dc, inverse_dz = _inverse(dr), _inverse(dc), _inverse(dz)
    level = min(level, grid.level_columns.size - 1)
    # i and j only ever move in the direction of the ray: the walk ends whatever the rounding.
    while True:
        t_row = _leaves_at(i >> level, level, r0, dr, inverse_dr)
        t_column = _leaves_at(j >> level, level, c0, dc, inverse_dc)
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
                    i = _moved(i, r0 + t * dr, dr, level, n_rows)
                    j = _moved(j, c0 + t * dc, dc, level, n_columns)
                level -= 1
                continue
        if t_out >= end:
            return MISSED
        t = t_out
        if t_row < t_column:
            j = _moved(j, c0 + t * dc, dc, level, n_columns)
            i, climbs = _stepped(i, dr, level)
        else:
            i = _moved(i, r0 + t * dr, dr, level, n_rows)
            j, climbs = _stepped(j, dc, level)
        if not (0 <= i < n_rows and 0 <= j < n_columns):
            return MISSED
        level += climbs


@inlined
def _is_below(grid, i, j, r, c, z):
    if z >= grid.top_m - _ROUNDING_M:
        return False
    low, slope_r, slope_c = _triangle(grid.height_m, i, j, c - j >= r - i)
    return z < low + slope_r * (r - i) + slope_c * (c - j) - _ROUNDING_M


@inlined
def _inverse(direction):
    """Give 1 / direction, or 0 where the ray does not move along this axis."""
    return 1.0 / direction if abs(direction) > 1.0 / _FAR else 0.0


@inlined
def _leaves_at(square, level, start, direction, inverse):
    """Give t where the ray leaves a square of the quadtree along one axis."""
    if inverse == 0.0:
        return _FAR
    return (((square + (direction > 0.0)) << level) - start) * inverse


@inlined
def _highest(grid, level, i, j):
    row_start = grid.level_start[level] + (i >> level) * grid.level_columns[level]
    return grid.node_max_m[row_start + (j >> level)]


@kernel
def _bundle_depth(grid, r0, c0, z0, dr, dc, dz, t, end, level, lowest_level):
    """Give t where a bundle of rays may first meet the surface, or else end.

    All rays must be within half a square of the lowest level of this one along r and c, and not
    below it. It may pass half such a square outside the model.
    """
    n_rows = grid.height_m.shape[0] - 1
    n_columns = grid.height_m.shape[1] - 1
    inverse_dr, inverse_dc, inverse_dz = _inverse(dr), _inverse(dc), _inverse(dz)
    i = min(max(int(np.floor(r0 + t * dr)), -_BLOCK), n_rows + _BLOCK - 1)
    j = min(max(int(np.floor(c0 + t * dc)), -_BLOCK), n_columns + _BLOCK - 1)
    while True:
        t_row = _leaves_at(i >> level, level, r0, dr, inverse_dr)
        t_column = _leaves_at(j >> level, level, c0, dc, inverse_dc)
        t_out = max(t, min(t_row, t_column, end))
        highest = _widely_highest(grid, level, i, j)
        if z0 + min(t * dz, t_out * dz) <= highest:
            if z0 + t * dz > highest:
                t = min(max(t, (highest - z0) * inverse_dz), t_out)
                i = _moved(i, r0 + t * dr, dr, level, n_rows + _BLOCK)
                j = _moved(j, c0 + t * dc, dc, level, n_columns + _BLOCK)
            if level == lowest_level:
                return t
            level -= 1
            continue
        if t_out >= end:
            return end
        t = t_out
        if t_row < t_column:
            j = _moved(j, c0 + t * dc, dc, level, n_columns + _BLOCK)
            i, climbs = _stepped(i, dr, level)
        else:
            i = _moved(i, r0 + t * dr, dr, level, n_rows + _BLOCK)
            j, climbs = _stepped(j, dc, level)
        if not (-_BLOCK <= i < n_rows + _BLOCK and -_BLOCK <= j < n_columns + _BLOCK):
            return end
        level = min(level + climbs, grid.wide_columns.size - 1)


@inlined
def _widely_highest(grid, level, i, j):
    row_start = grid.wide_start[level] + (i >> level) * grid.wide_columns[level]
    return grid.wide_max_m[row_start + (j >> level)]


@inlined
def _moved(index, place, direction, level, n_cells):
    """Give the cell of a place within the present square, but never back against the ray."""
    square_start = (index >> level) << level
    if direction > 0.0:
        last = min(square_start + (1 << level) - 1, n_cells - 1)
        return min(max(int(np.floor(place)), index), last)
    return max(min(int(np.floor(place)), index), square_start)


@inlined
def _stepped(index, direction, level):
    """Give the first cell of the next square, and 1 where that has another parent, else 0."""
    square = index >> level
    if direction > 0.0:
        return (square + 1) << level, square & 1
    return (square << level) - 1, 1 - (square & 1)


@inlined
def _inside_model(r0, c0, z0, dr, dc, dz, t_end, n_rows, n_columns, top):
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
def _triangle(height, i, j, is_upper):
    """Give height at node (i, j) and the rise a cell along r and c, on one of the triangles."""
    z00 = float(height[i, j])
    z11 = float(height[i + 1, j + 1])
    if is_upper:
        z01 = float(height[i, j + 1])
        return z00, z11 - z01, z01 - z00
    z10 = float(height[i + 1, j])
    return z00, z10 - z00, z11 - z10


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
        low, slope_r, slope_c = _triangle(height, i, j, ahead + t_middle * gain >= 0.0)
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


@inlined
def facet_normal(grid, r, c):
    """Give the unit normal of the triangle at a place; components along r, c and z."""
    i = min(max(int(r), 0), grid.height_m.shape[0] - 2)
    j = min(max(int(c), 0), grid.height_m.shape[1] - 2)
    _, slope_r, slope_c = _triangle(grid.height_m, i, j, c - j >= r - i)
    return _unit_normal(slope_r / grid.spacing_m, slope_c / grid.spacing_m)


@inlined
def smooth_normal(grid, r, c):
    """Give the unit normal from the slopes at the four nodes around, interpolated bilinearly.

    The slope at a node is that of a central step, at the border of a one-sided one.
    """
    height = grid.height_m
    i = min(max(int(r), 0), height.shape[0] - 2)
    j = min(max(int(c), 0), height.shape[1] - 2)
    a = r - i
    b = c - j
    up, down = max(i - 1, 0), min(i + 2, height.shape[0] - 1)
    left, right = max(j - 1, 0), min(j + 2, height.shape[1] - 1)
    # Differences of interpolated heights are the interpolated differences, with half the reading.
    rise_0 = _along_c(height, i + 1, j, b) - _along_c(height, up, j, b)
    rise_1 = _along_c(height, down, j, b) - _along_c(height, i, j, b)
    slope_r = (1.0 - a) * rise_0 / (i + 1 - up) + a * rise_1 / (down - i)
    rise_0 = _along_r(height, i, j + 1, a) - _along_r(height, i, left, a)
    rise_1 = _along_r(height, i, right, a) - _along_r(height, i, j, a)
    slope_c = (1.0 - b) * rise_0 / (j + 1 - left) + b * rise_1 / (right - j)
    return _unit_normal(slope_r / grid.spacing_m, slope_c / grid.spacing_m)


@inlined
def _along_c(height, i, j, b):
    return (1.0 - b) * float(height[i, j]) + b * float(height[i, j + 1])


@inlined
def _along_r(height, i, j, a):
    return (1.0 - a) * float(height[i, j]) + a * float(height[i + 1, j])


@inlined
def _unit_normal(slope_r, slope_c):
    scale = 1.0 / np.sqrt(1.0 + slope_r * slope_r + slope_c * slope_c)
    return -slope_r * scale, -slope_c * scale, scale


@kernel
def render_strips(grid, view, rays, subrays, out, part, n_parts):
    """Render the part-th of every n_parts strips of pixels.

    Args:
        grid: The surface.
        view: Camera and lamp.
        rays: Rays through the pixel centres, shape (rows, columns, 2).
        subrays: Rays whose mean light a pixel gets, shape (n, rows, columns, 2); with n = 0 the
            centre's light is taken.
        out: Arrays to fill: radiance and depth (rows, columns), points (rows, columns, 3) in trs,
            is_lit (rows, columns).
        part: The number of this part, from 0.
        n_parts: How many parts there are.
    """
    radiance, depth, points, is_lit = out
    n_rows, n_columns = depth.shape
    for top in range(part * _BUNDLE_PX, n_rows, n_parts * _BUNDLE_PX):
        bottom = min(top + _BUNDLE_PX, n_rows)
        for left in range(0, n_columns, _BUNDLE_PX):
            right = min(left + _BUNDLE_PX, n_columns)
            start = _bundle_start(
                grid, view, rays[top:bottom, left:right], subrays[:, top:bottom, left:right]
            )
            for v in range(top, bottom):
                for u in range(left, right):
                    light, t, lit = _centre(grid, view, rays[v, u], start, points[v, u])
                    depth[v, u] = t
                    is_lit[v, u] = lit
                    if subrays.shape[0] > 0:
                        light = _mean_light(grid, view, subrays[:, v, u], start)
                    radiance[v, u] = light


@kernel
def _bundle_start(grid, view, rays, subrays):
    """Give a depth before which none of the rays meets the surface; MISSED: not known.

    It is known for a camera over the model, looking down.
    """
    eye = view.eye
    n_rows = grid.height_m.shape[0] - 1
    n_columns = grid.height_m.shape[1] - 1
    if not (0.0 < eye[0] < n_rows and 0.0 < eye[1] < n_columns and eye[2] > grid.top_m):
        return MISSED
    least, most = _bounds(view, rays, subrays)
    if least[2] >= 0.0:
        return MISSED
    t_end = (grid.bottom_m - eye[2]) / least[2]
    _, t_end = _inside_slab(eye[0], least[0], n_rows, 0.0, t_end)
    _, t_end = _inside_slab(eye[0], most[0], n_rows, 0.0, t_end)
    _, t_end = _inside_slab(eye[1], least[1], n_columns, 0.0, t_end)
    _, t_end = _inside_slab(eye[1], most[1], n_columns, 0.0, t_end)
    t = (grid.top_m - eye[2]) / least[2]
    width = t_end * max(most[0] - least[0], most[1] - least[1])
    lowest_level = WIDE_LEVEL
    while (1 << lowest_level) < width:
        lowest_level += 1
    level = grid.wide_columns.size - 1
    if t >= t_end or lowest_level > level:
        return min(t, t_end)
    dr, dc = 0.5 * (least[0] + most[0]), 0.5 * (least[1] + most[1])
    level = min(level, max(lowest_level, _VIEW_LEVEL))
    z = eye[2] - _ROUNDING_M
    return _bundle_depth(grid, eye[0], eye[1], z, dr, dc, least[2], t, t_end, level, lowest_level)


@inlined
def _bounds(view, rays, subrays):
    """Give the least and the largest components of the rays' directions in grid coordinates."""
    first = _direction(view, rays[0, 0])
    r_least, c_least, z_least = first
    r_most, c_most, z_most = first
    for k in range(subrays.shape[0] + 1):
        table = rays if k == 0 else subrays[k - 1]
        for v in range(table.shape[0]):
            for u in range(table.shape[1]):
                dr, dc, dz = _direction(view, table[v, u])
                r_least, r_most = min(r_least, dr), max(r_most, dr)
                c_least, c_most = min(c_least, dc), max(c_most, dc)
                z_least, z_most = min(z_least, dz), max(z_most, dz)
    return (r_least, c_least, z_least), (r_most, c_most, z_most)


@inlined
def _direction(view, ray):
    """Give the direction of the ray (x, y, 1) in cam in grid coordinates."""
    m = view.grid_from_cam
    return (
        m[0, 0] * ray[0] + m[0, 1] * ray[1] + m[0, 2],
        m[1, 0] * ray[0] + m[1, 1] * ray[1] + m[1, 2],
        m[2, 0] * ray[0] + m[2, 1] * ray[1] + m[2, 2],
    )


@inlined
def _centre(grid, view, ray, start, point):
    """Fill in the point of a pixel and give its light, depth (NaN: none) and whether it is lit."""
    dr, dc, dz = _direction(view, ray)
    t = _depth(grid, view, dr, dc, dz, start)
    if t < 0.0:
        point[:] = np.nan
        return 0.0, np.nan, False
    point[0] = view.origin_trs_m[0] + (view.eye[0] + t * dr) * grid.spacing_m
    point[1] = view.origin_trs_m[1] + (view.eye[1] + t * dc) * grid.spacing_m
    point[2] = view.origin_trs_m[2] + view.eye[2] + t * dz
    light, lit = _light(grid, view, t, dr, dc, dz)
    return light, t, lit


@inlined
def _mean_light(grid, view, rays, start):
    total = 0.0
    for k in range(rays.shape[0]):
        dr, dc, dz = _direction(view, rays[k])
        t = _depth(grid, view, dr, dc, dz, start)
        if t >= 0.0:
            light, _ = _light(grid, view, t, dr, dc, dz)
            total += light
    return total / rays.shape[0]


@inlined
def _depth(grid, view, dr, dc, dz, start):
    """Give the depth of what a ray sees, negative where it sees nothing."""
    r0, c0, z0 = view.eye[0], view.eye[1], view.eye[2]
    if start < 0.0:
        return first_hit(grid, r0, c0, z0, dr, dc, dz, np.inf, _VIEW_LEVEL)
    n_rows = grid.height_m.shape[0] - 1
    n_columns = grid.height_m.shape[1] - 1
    _, end = _inside_slab(r0, dr, n_rows, start, np.inf)
    _, end = _inside_slab(c0, dc, n_columns, start, end)
    if not start <= end:
        return MISSED
    i = min(max(int(r0 + start * dr), 0), n_rows - 1)
    j = min(max(int(c0 + start * dc), 0), n_columns - 1)
    level = min(_BUNDLE_LEVEL, grid.level_columns.size - 1)
    return _follow(grid, r0, c0, z0, dr, dc, dz, start, end, i, j, level)


@inlined
def _light(grid, view, t, dr, dc, dz):
    """Give the radiance towards the camera at depth t of a ray, and whether the lamp reaches it."""
    spacing = grid.spacing_m
    r = view.eye[0] + t * dr
    c = view.eye[1] + t * dc
    z = view.eye[2] + t * dz
    to_lamp_x = (view.lamp[0] - r) * spacing
    to_lamp_y = (view.lamp[1] - c) * spacing
    to_lamp_z = view.lamp[2] - z
    distance = np.sqrt(to_lamp_x**2 + to_lamp_y**2 + to_lamp_z**2)
    normal_x, normal_y, normal_z = smooth_normal(grid, r, c)
    cos_incidence = (normal_x * to_lamp_x + normal_y * to_lamp_y + normal_z * to_lamp_z) / distance
    if not cos_incidence > 0.0 or _is_in_shadow(grid, view, r, c, z):
        return 0.0, False
    to_eye_x = -dr * spacing
    to_eye_y = -dc * spacing
    range_ = np.sqrt(to_eye_x**2 + to_eye_y**2 + dz**2)
    cos_emission = (normal_x * to_eye_x + normal_y * to_eye_y - normal_z * dz) / range_
    cos_phase = (to_lamp_x * to_eye_x + to_lamp_y * to_eye_y - to_lamp_z * dz) / distance / range_
    reflected = _reflected(view.photometry, cos_incidence, max(cos_emission, 0.0), cos_phase)
    return view.intensity * reflected / distance**2, True


@inlined
def _is_in_shadow(grid, view, r, c, z):
    """Follow a ray to the lamp from just above the triangle it starts on."""
    normal_x, normal_y, normal_z = facet_normal(grid, r, c)
    r += normal_x * _SHADOW_OFFSET_M / grid.spacing_m
    c += normal_y * _SHADOW_OFFSET_M / grid.spacing_m
    z += normal_z * _SHADOW_OFFSET_M
    dr = view.lamp[0] - r
    dc = view.lamp[1] - c
    dz = view.lamp[2] - z
    x, y = dr * grid.spacing_m, dc * grid.spacing_m
    if normal_x * x + normal_y * y + normal_z * dz <= 0.0:
        return True
    t_end = _shadow_reach(grid, view, r, c)
    return first_hit(grid, r, c, z, dr, dc, dz, t_end, _SHADOW_LEVEL) != MISSED


@inlined
def _shadow_reach(grid, view, r, c):
    """Give the part of the way to the lamp on which something may be in between.

    Threads may fill in the same block at once: they find the same value.
    """
    reach = view.shadow_reach
    if not (0.0 <= r < grid.height_m.shape[0] - 1 and 0.0 <= c < grid.height_m.shape[1] - 1):
        return 1.0
    i, j = int(r) >> WIDE_LEVEL, int(c) >> WIDE_LEVEL
    if reach[i, j] == 0.0:
        reach[i, j] = _block_reach(grid, view.lamp, i, j)
    return float(reach[i, j])


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
    top = grid.top_m + _ROUNDING_M
    t, end = _inside_model(r0 + margin, c0 + margin, z0, dr, dc, dz, 1.0, n_rows, n_columns, top)
    level = grid.wide_columns.size - 1
    if t < end:
        t = _bundle_depth(grid, r0, c0, z0, dr, dc, dz, t, end, level, WIDE_LEVEL)
    return np.float32(min(1.0, (1.0 - t) * (1.0 + 1e-6) + 1e-9))


@inlined
def _lowest_of_block(height, i, j):
    """Give a height below all places on a block, and a cell around: rays start a little aside."""
    lowest = height[i * _BLOCK, j * _BLOCK]
    for k in range(max(i * _BLOCK - 1, 0), min((i + 1) * _BLOCK + 2, height.shape[0])):
        for m in range(max(j * _BLOCK - 1, 0), min((j + 1) * _BLOCK + 2, height.shape[1])):
            lowest = min(lowest, height[k, m])
    return float(lowest) - _ROUNDING_M


@inlined
def _reflected(photometry, cos_incidence, cos_emission, cos_phase):
    """Give the bidirectional reflectance times cos_incidence.

    Lunar-Lambert is 2 L(g) mu0 / (mu0 + mu) + (1 - L(g)) mu0, with the Moon's L(g) of McEwen (Lunar
    and Planetary Science XXVII, 1996), a cubic in the phase angle that is held at 0 beyond its root
    near 90 degrees.
    """
    if photometry == LAMBERT:
        return cos_incidence
    phase_deg = np.degrees(np.arccos(min(max(cos_phase, -1.0), 1.0)))
    share = 1.0 + phase_deg * (-0.019 + phase_deg * (0.242e-3 - 1.46e-6 * phase_deg))
    share = max(share, 0.0)
    lommel_seeliger = 2.0 * cos_incidence / (cos_incidence + cos_emission)
    return share * lommel_seeliger + (1.0 - share) * cos_incidence
