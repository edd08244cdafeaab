# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""The reference renderer's loop over the pixels."""

import numpy as np

from tronlab.render.lighting import light_at
from tronlab.render.raycast import first_hit
from tronlab.render.view import direction_of
from tronlab.terrain.kernels import inlined, kernel

# A numpy integer: numba would compile a kernel anew for each Python constant given.
_VIEW_LEVEL = np.int64(6)


@kernel
def render_rows(grid, view, light, rays, subrays, out, part, n_parts):
    """Render every n_parts-th row of pixels.

    Args:
        grid: The surface.
        view: The camera.
        light: The lamp.
        rays: Rays through the pixel centres, shape (rows, columns, 2).
        subrays: Rays whose mean light a pixel gets, shape (n, rows, columns, 2); with n = 0 the
            centre's light is taken.
        out: Arrays to fill: radiance and depth (rows, columns), points (rows, columns, 3) in trs,
            is_lit (rows, columns).
        part: The first row.
        n_parts: How far rows are apart.
    """
    radiance, depth, points, is_lit = out
    n_rows, n_columns = depth.shape
    n_rays = subrays.shape[0]
    for v in range(part, n_rows, n_parts):
        for u in range(n_columns):
            direction = direction_of(view, rays[v, u])
            t = _depth(grid, view, direction)
            depth[v, u] = t if t >= 0.0 else np.nan
            _fill_point(grid, view, direction, t, points[v, u])
            radiance[v, u], is_lit[v, u] = _light(grid, view, light, direction, t)
            if n_rays > 0:
                total = 0.0
                for k in range(n_rays):
                    direction = direction_of(view, subrays[k, v, u])
                    t = _depth(grid, view, direction)
                    total += _light(grid, view, light, direction, t)[0]
                radiance[v, u] = total / n_rays


@inlined
def _depth(grid, view, direction):
    """Give the depth of what a ray sees, negative where it sees nothing."""
    dr, dc, dz = direction
    r, c, z = view.eye[0], view.eye[1], view.eye[2]
    return first_hit(grid, r, c, z, dr, dc, dz, np.inf, _VIEW_LEVEL)


@inlined
def _fill_point(grid, view, direction, t, point):
    if t < 0.0:
        point[:] = np.nan
        return
    dr, dc, dz = direction
    point[0] = view.origin_trs_m[0] + (view.eye[0] + t * dr) * grid.spacing_m
    point[1] = view.origin_trs_m[1] + (view.eye[1] + t * dc) * grid.spacing_m
    point[2] = view.origin_trs_m[2] + view.eye[2] + t * dz


@kernel
def _light(grid, view, light, direction, t):
    """Give the light of the point at depth t of a ray, and whether the lamp lights it."""
    if t < 0.0:
        return 0.0, False
    dr, dc, dz = direction
    x, y = -dr * grid.spacing_m, -dc * grid.spacing_m
    length = np.sqrt(x * x + y * y + dz * dz)
    to_eye = (x / length, y / length, -dz / length)
    r, c, z = view.eye[0] + t * dr, view.eye[1] + t * dc, view.eye[2] + t * dz
    radiance, is_lit = light_at(grid, light, r, c, z, to_eye)
    if view.vignetting_power > 0.0:
        # The direction has depth 1, so that its length is 1 / cos of the angle off the axis.
        radiance *= length**-view.vignetting_power
    return radiance, is_lit
