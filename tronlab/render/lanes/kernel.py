# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""The fast renderer's loop over tiles of pixels."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.render.lanes.footprint import Footprint, footprint_of
from tronlab.render.lanes.light import light_lanes
from tronlab.render.lanes.rows import (
    DEPTH,
    IS_LIT,
    N_FLOAT_ROWS,
    N_INT_ROWS,
    RADIANCE,
    STATE,
    C,
    R,
    Z,
)
from tronlab.render.lanes.start_depth import start_depth
from tronlab.render.lanes.stepping import HIT, TOP_LEVEL, aim_lanes, follow_lanes
from tronlab.render.lanes.tiles import LANES
from tronlab.render.view import direction_of
from tronlab.terrain.kernels import inlined, kernel

_NONE = np.float32(np.nan)


class Scratch(NamedTuple):
    """Room for the lanes of each part of the work: kernels make no arrays."""

    floats: NDArray[np.float32]
    ints: NDArray[np.int32]
    level_start: NDArray[np.int64]


def make_scratch(n_parts: int) -> Scratch:
    """Make room for so many parts at once."""
    return Scratch(
        np.zeros((n_parts, N_FLOAT_ROWS * LANES), dtype=np.float32),
        np.zeros((n_parts, N_INT_ROWS * LANES), dtype=np.int32),
        np.zeros((n_parts, TOP_LEVEL + 1), dtype=np.int64),
    )


@kernel
def render_tiles(
    grid, view, light, lamp_map, shadow_rays, tiles, pitch, out, scratch, part, n_parts
):
    """Render the part-th of every n_parts tiles of pixels.

    Args:
        grid: The surface.
        view: The camera.
        light: The lamp.
        lamp_map: Its light on the nodes; None with shadow_rays.
        shadow_rays: True: shadows are found by rays; None: in the map.
        tiles: The camera's rays.
        pitch: Difference between the rays whose light is averaged over the ground between them,
            along x and y; 0: the light at the points is taken.
        out: Arrays to fill: radiance and depth (rows, columns), points (rows, columns, 3) in trs,
            is_lit (rows, columns).
        scratch: Room for n_parts parts.
        part: The number of this part, from 0.
        n_parts: How many parts there are.
    """
    n_rows, n_columns = tiles.middle.shape[0], tiles.middle.shape[1]
    n, n_centres = tiles.offset.shape[3], tiles.side_px * tiles.side_px
    floats, ints = scratch.floats[part], scratch.ints[part]
    for tile in range(part, n_rows * n_columns, n_parts):
        i, j = tile // n_columns, tile % n_columns
        middle = tiles.middle[i, j]
        direction = direction_of(view, middle)
        half_width = _spread(view, tiles.half_width[i, j])
        eye = (view.eye[0], view.eye[1], view.eye[2])
        depth = start_depth(grid, eye, direction, half_width)
        if depth == np.inf:
            _store_nothing(out, i, j, tiles.side_px)
            continue
        offset = tiles.offset[i, j]
        frame = aim_lanes(grid, view.eye, view.grid_from_cam, middle, offset, depth, floats, ints)
        follow_lanes(grid, frame, n, floats, ints, scratch.level_start[part])
        footprint = Footprint(0.0, 0.0, 0.0, 1)
        if pitch[0] > 0.0:
            footprint = footprint_of(view, direction, pitch)
        light_lanes(
            grid, view, light, lamp_map, shadow_rays, frame, footprint, n_centres, n, floats, ints
        )
        _store(grid, view, frame, out, i, j, tiles.side_px, n, floats, ints)


@inlined
def _spread(view, half_width):
    """Give how far rays' directions lie from the middle one's, in grid coordinates."""
    m = view.grid_from_cam
    return (
        abs(m[0, 0]) * half_width[0] + abs(m[0, 1]) * half_width[1],
        abs(m[1, 0]) * half_width[0] + abs(m[1, 1]) * half_width[1],
        abs(m[2, 0]) * half_width[0] + abs(m[2, 1]) * half_width[1],
    )


@inlined
def _store_nothing(out, i, j, side):
    radiance, depth, points, is_lit = out
    radiance[i * side : (i + 1) * side, j * side : (j + 1) * side] = 0.0
    depth[i * side : (i + 1) * side, j * side : (j + 1) * side] = np.nan
    points[i * side : (i + 1) * side, j * side : (j + 1) * side] = np.nan
    is_lit[i * side : (i + 1) * side, j * side : (j + 1) * side] = False


@kernel
def _store(grid, view, frame, out, i, j, side, n, floats, ints):
    """Store what the lanes have found in the pixels of tile (i, j)."""
    radiance, depth, points, is_lit = out
    spacing = grid.spacing_m
    x = view.origin_trs_m[0] + frame.row * spacing
    y = view.origin_trs_m[1] + frame.column * spacing
    z = view.origin_trs_m[2]
    n_centres = side * side
    for row in range(min(side, depth.shape[0] - i * side)):
        v = i * side + row
        for column in range(min(side, depth.shape[1] - j * side)):
            u = j * side + column
            k = row * side + column
            radiance[v, u] = _mean_radiance(k, n_centres, n, floats, ints)
            if ints[STATE + k] == HIT:
                depth[v, u] = np.float32(frame.depth + floats[DEPTH + k])
                points[v, u, 0] = np.float32(x + floats[R + k] * spacing)
                points[v, u, 1] = np.float32(y + floats[C + k] * spacing)
                points[v, u, 2] = np.float32(z + floats[Z + k])
                is_lit[v, u] = ints[IS_LIT + k] != 0
            else:
                depth[v, u] = _NONE
                points[v, u, 0] = points[v, u, 1] = points[v, u, 2] = _NONE
                is_lit[v, u] = False


@inlined
def _mean_radiance(k, n_centres, n, floats, ints):
    """Give the radiance of pixel k: of its one ray, or the mean of those around its centre."""
    if n == n_centres:
        return floats[RADIANCE + k] if ints[STATE + k] == HIT else np.float32(0.0)
    total = np.float32(0.0)
    for lane in range(k + n_centres, n, n_centres):
        if ints[STATE + lane] == HIT:
            total += floats[RADIANCE + lane]
    return total / np.float32(n // n_centres - 1)
