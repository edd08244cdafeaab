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
cells, is read from the heights themselves.

All kernels that call each other stay in this file: numba's cache on disk only notices changes of
the file that a kernel is in.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.kernels import compiled

MISSED = -1.0
"""The ray leaves the model without meeting the surface."""
BELOW = -2.0
"""The ray starts below the surface."""
LAMBERT = 0
LUNAR_LAMBERT = 1

_FAR = 1e300
_ROUNDING_M = 1e-9
_TILE_PX = 16
_VIEW_LEVEL = 6
_SHADOW_LEVEL = 1
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


@compiled
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


@compiled
def _is_below(grid, i, j, r, c, z):
    if z >= grid.top_m - _ROUNDING_M:
        return False
    low, slope_r, slope_c = _triangle(grid.height_m, i, j, c - j >= r - i)
    return z < low + slope_r * (r - i) + slope_c * (c - j) - _ROUNDING_M


@compiled
def _inverse(direction):
    """Give 1 / direction, or 0 where the ray does not move along this axis."""
    return 1.0 / direction if abs(direction) > 1.0 / _FAR else 0.0


@compiled
def _leaves_at(square, level, start, direction, inverse):
    """Give t where the ray leaves a square of the quadtree along one axis."""
    if inverse == 0.0:
        return _FAR
    return (((square + (direction > 0.0)) << level) - start) * inverse


@compiled
def _highest(grid, level, i, j):
    row_start = grid.level_start[level] + (i >> level) * grid.level_columns[level]
    return grid.node_max_m[row_start + (j >> level)]


@compiled
def _moved(index, place, direction, level, n_cells):
    """Give the cell of a place within the present square, but never back against the ray."""
    square_start = (index >> level) << level
    if direction > 0.0:
        last = min(square_start + (1 << level) - 1, n_cells - 1)
        return min(max(int(place), index), last)
    return max(min(int(place), index), square_start)


@compiled
def _stepped(index, direction, level):
    """Give the first cell of the next square, and 1 where that has another parent, else 0."""
    square = index >> level
    if direction > 0.0:
        return (square + 1) << level, square & 1
    return (square << level) - 1, 1 - (square & 1)


@compiled
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


@compiled
def _inside_slab(start, direction, width, begin, end):
    if abs(direction) <= 1.0 / _FAR:
        if start < 0.0 or start > width:
            return 1.0, 0.0
        return begin, end
    first = -start / direction
    last = (width - start) / direction
    return max(begin, min(first, last)), min(end, max(first, last))


@compiled
def _triangle(height, i, j, is_upper):
    """Give height at node (i, j) and the rise a cell along r and c, on one of the triangles."""
    z00 = float(height[i, j])
    z11 = float(height[i + 1, j + 1])
    if is_upper:
        z01 = float(height[i, j + 1])
        return z00, z11 - z01, z01 - z00
    z10 = float(height[i + 1, j])
    return z00, z10 - z00, z11 - z10


@compiled
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


@compiled
def facet_normal(grid, r, c):
    """Give the unit normal of the triangle at a place; components along r, c and z."""
    i = min(max(int(r), 0), grid.height_m.shape[0] - 2)
    j = min(max(int(c), 0), grid.height_m.shape[1] - 2)
    _, slope_r, slope_c = _triangle(grid.height_m, i, j, c - j >= r - i)
    return _unit_normal(slope_r / grid.spacing_m, slope_c / grid.spacing_m)


@compiled
def smooth_normal(grid, r, c):
    """Give the unit normal from the slopes at the four nodes around, interpolated bilinearly."""
    i = min(max(int(r), 0), grid.height_m.shape[0] - 2)
    j = min(max(int(c), 0), grid.height_m.shape[1] - 2)
    a = r - i
    b = c - j
    slope_r = 0.0
    slope_c = 0.0
    for k in range(2):
        for m in range(2):
            weight = (a if k else 1.0 - a) * (b if m else 1.0 - b)
            node_r, node_c = _node_slopes(grid.height_m, i + k, j + m)
            slope_r += weight * node_r
            slope_c += weight * node_c
    return _unit_normal(slope_r / grid.spacing_m, slope_c / grid.spacing_m)


@compiled
def _node_slopes(height, i, j):
    """Give the rise a cell along r and c at a node by central, at the border one-sided, steps."""
    up = max(i - 1, 0)
    down = min(i + 1, height.shape[0] - 1)
    left = max(j - 1, 0)
    right = min(j + 1, height.shape[1] - 1)
    rise_r = (float(height[down, j]) - float(height[up, j])) / (down - up)
    rise_c = (float(height[i, right]) - float(height[i, left])) / (right - left)
    return rise_r, rise_c


@compiled
def _unit_normal(slope_r, slope_c):
    scale = 1.0 / np.sqrt(1.0 + slope_r * slope_r + slope_c * slope_c)
    return -slope_r * scale, -slope_c * scale, scale


@compiled
def render_centres(grid, view, rays, radiance, depth, points, is_lit, part, n_parts):
    """Render the part-th of every n_parts tiles at the pixel centres.

    Fills radiance and depth (rows, columns), points (rows, columns, 3) in trs and is_lit;
    rays are (rows, columns, 2).
    """
    n_rows, n_columns = depth.shape
    n_across = (n_columns + _TILE_PX - 1) // _TILE_PX
    n_down = (n_rows + _TILE_PX - 1) // _TILE_PX
    for tile in range(part, n_down * n_across, n_parts):
        top = tile // n_across * _TILE_PX
        left = tile % n_across * _TILE_PX
        for v in range(top, min(top + _TILE_PX, n_rows)):
            for u in range(left, min(left + _TILE_PX, n_columns)):
                t, dr, dc, dz = _seen(grid, view, rays[v, u, 0], rays[v, u, 1])
                radiance[v, u] = 0.0
                is_lit[v, u] = False
                if t < 0.0:
                    depth[v, u] = np.nan
                    points[v, u] = np.nan
                    continue
                depth[v, u] = t
                points[v, u, 0] = view.origin_trs_m[0] + (view.eye[0] + t * dr) * grid.spacing_m
                points[v, u, 1] = view.origin_trs_m[1] + (view.eye[1] + t * dc) * grid.spacing_m
                points[v, u, 2] = view.origin_trs_m[2] + view.eye[2] + t * dz
                light, lit = _light(grid, view, t, dr, dc, dz)
                radiance[v, u] = light
                is_lit[v, u] = lit


@compiled
def render_subpixels(grid, view, rays, radiance, part, n_parts):
    """Fill radiance (rows, columns) with the mean over rays (n, rows, columns, 2)."""
    n_rows, n_columns = radiance.shape
    n_across = (n_columns + _TILE_PX - 1) // _TILE_PX
    n_down = (n_rows + _TILE_PX - 1) // _TILE_PX
    n_rays = rays.shape[0]
    for tile in range(part, n_down * n_across, n_parts):
        top = tile // n_across * _TILE_PX
        left = tile % n_across * _TILE_PX
        for v in range(top, min(top + _TILE_PX, n_rows)):
            for u in range(left, min(left + _TILE_PX, n_columns)):
                total = 0.0
                for k in range(n_rays):
                    t, dr, dc, dz = _seen(grid, view, rays[k, v, u, 0], rays[k, v, u, 1])
                    if t >= 0.0:
                        light, _ = _light(grid, view, t, dr, dc, dz)
                        total += light
                radiance[v, u] = total / n_rays


@compiled
def _seen(grid, view, x, y):
    """Give depth (negative: nothing seen) and direction of the ray (x, y, 1) in cam."""
    m = view.grid_from_cam
    dr = m[0, 0] * x + m[0, 1] * y + m[0, 2]
    dc = m[1, 0] * x + m[1, 1] * y + m[1, 2]
    dz = m[2, 0] * x + m[2, 1] * y + m[2, 2]
    eye = view.eye
    t = first_hit(grid, eye[0], eye[1], eye[2], dr, dc, dz, np.inf, _VIEW_LEVEL)
    return t, dr, dc, dz


@compiled
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


@compiled
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
    return first_hit(grid, r, c, z, dr, dc, dz, 1.0, _SHADOW_LEVEL) != -1.0


@compiled
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
