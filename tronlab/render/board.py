# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""A textured rectangle, flat or bowed, such as a calibration board, as a camera sees it."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.render.bow import FLAT, Bow
from tronlab.render.rays import centre_rays, subpixel_rays
from tronlab.render.renderer import RenderError
from tronlab.render.settings import RaysPerPixel
from tronlab.terrain.kernels import compiled, n_cores, run_interleaved


def render_board(
    texture: NDArray[np.uint8],
    texel_m: float,
    camera: CameraModel,
    trs_from_board: RigidTransform,
    trs_from_cam: RigidTransform,
    rays_per_pixel: RaysPerPixel = 1,
    *,
    bow: Bow = FLAT,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Render a textured rectangle; only its printed side is seen.

    The board's x runs along the texture's columns, y down its rows, z away from who reads it; its
    origin is the outer corner of the top left texel. A ray meets the bowed surface; the camera must
    be on the printed side of the plane. It takes the mean of the texture over the box around its
    footprint, so that edges are smooth and stay where they are.

    Args:
        texture: Grey levels, shape (h, w); 0 is albedo 0, 255 albedo 1.
        texel_m: Side of a texel.
        camera: Intrinsics; lens distortion is applied at the ray.
        trs_from_board: Where the board is.
        trs_from_cam: Where the camera is.
        rays_per_pixel: 1 or 4.
        bow: Small against the board, in the frame of the texture.

    Returns:
        Albedo, shape (rows, columns), 0 to 1 and 0 where the board is not seen; and whether the
        pixel's centre sees the board, shape (rows, columns).

    Raises:
        RenderError: A texture of another form, or a texel that is not positive.
    """
    if texture.ndim != 2 or texture.dtype != np.uint8 or texture.size == 0:
        raise RenderError(
            f"board texture: is {texture.dtype} of shape {texture.shape}, expected uint8 (h, w)"
        )
    if not texel_m > 0:
        raise RenderError(f"board texture: texel_m is {texel_m}, must be positive")
    if rays_per_pixel not in {1, 4}:
        raise RenderError(f"rays_per_pixel is {rays_per_pixel}, must be 1 or 4")
    board_from_cam = trs_from_board.inv() * trs_from_cam
    centres = centre_rays(camera)[None]
    albedo = np.zeros(camera.shape, dtype=np.float32)
    is_seen = np.zeros(camera.shape, dtype=np.bool_)
    run_interleaved(
        _render_rows,
        _summed(texture),
        texel_m,
        bow.below(board_from_cam.translation),
        np.ascontiguousarray(board_from_cam.rotation.as_matrix()),
        np.ascontiguousarray(board_from_cam.translation),
        centres,
        centres if rays_per_pixel == 1 else subpixel_rays(camera),
        albedo,
        is_seen,
        n_threads=n_cores(),
    )
    return albedo, is_seen


def _summed(texture: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Give the integral of the albedo from the origin, in texels, shape (h + 1, w + 1)."""
    summed = np.zeros((texture.shape[0] + 1, texture.shape[1] + 1))
    summed[1:, 1:] = (texture / 255.0).cumsum(axis=0).cumsum(axis=1)
    return summed


@compiled
def _render_rows(
    summed, texel, surface, rotation, eye, centres, rays, albedo, is_seen, part, n_parts
):
    """Render every n_parts-th row."""
    n_rows, n_columns = albedo.shape
    n_rays = rays.shape[0]
    size = 1.0 / np.sqrt(n_rays)
    for v in range(part, n_rows, n_parts):
        for u in range(n_columns):
            x, y, _ = _texel_at(surface, rotation, eye, texel, centres[0, v, u])
            is_seen[v, u] = _is_inside(summed, x, y)
            total = 0.0
            for k in range(n_rays):
                x, y, depth = _texel_at(surface, rotation, eye, texel, rays[k, v, u])
                if not depth > 0.0:
                    continue
                half_x, half_y = _half_footprint(surface, rotation, eye, texel, rays[k], v, u)
                total += _mean(summed, x, y, half_x * size, half_y * size)
            albedo[v, u] = total / n_rays


@compiled
def _texel_at(surface, rotation, eye, texel, ray):
    """Give place on the board in texels and depth; NaN where the board is not."""
    right = rotation[0, 0] * ray[0] + rotation[0, 1] * ray[1] + rotation[0, 2]
    down = rotation[1, 0] * ray[0] + rotation[1, 1] * ray[1] + rotation[1, 2]
    fall = rotation[2, 0] * ray[0] + rotation[2, 1] * ray[1] + rotation[2, 2]
    depth = _depth(surface, eye, right, down, fall)
    x, y = eye[0] + depth * right, eye[1] + depth * down
    return x / texel, y / texel, depth


@compiled
def _depth(surface, eye, right, down, fall):
    """Give where a ray goes through the surface from its printed side; NaN if nowhere ahead.

    How far the ray is behind the surface is ``c + b t - bend t^2`` at depth t. The root where that
    grows is written so that a flat surface gives exactly -c / b.
    """
    if not (eye[2] < 0.0 and fall > 0.0):
        return np.nan
    bend = surface[3] * right * right + surface[4] * right * down + surface[5] * down * down
    b = fall - (surface[1] * right + surface[2] * down)
    c = eye[2] - surface[0]
    below = b + np.sqrt(b * b + 4.0 * bend * c)
    depth = -2.0 * c / below
    return depth if below > 0.0 and depth > 0.0 else np.nan


@compiled
def _is_inside(summed, x, y):
    return 0.0 <= x <= summed.shape[1] - 1 and 0.0 <= y <= summed.shape[0] - 1


@compiled
def _half_footprint(surface, rotation, eye, texel, rays, v, u):
    """Give half the extent of a whole pixel's footprint along the board's axes, in texels."""
    n_rows, n_columns, _ = rays.shape
    left, right = max(u - 1, 0), min(u + 1, n_columns - 1)
    up, down = max(v - 1, 0), min(v + 1, n_rows - 1)
    x0, y0, _ = _texel_at(surface, rotation, eye, texel, rays[v, left])
    x1, y1, _ = _texel_at(surface, rotation, eye, texel, rays[v, right])
    x2, y2, _ = _texel_at(surface, rotation, eye, texel, rays[up, u])
    x3, y3, _ = _texel_at(surface, rotation, eye, texel, rays[down, u])
    across = max(right - left, 1)
    along = max(down - up, 1)
    half_x = 0.5 * (abs(x1 - x0) / across + abs(x3 - x2) / along)
    half_y = 0.5 * (abs(y1 - y0) / across + abs(y3 - y2) / along)
    return half_x, half_y


@compiled
def _mean(summed, x, y, half_x, half_y):
    """Give the mean albedo of a box; what lies outside the board counts as 0."""
    if not (half_x > 0.0 and half_y > 0.0):
        return 0.0
    left, right = x - half_x, x + half_x
    top, bottom = y - half_y, y + half_y
    lower = _integral(summed, right, bottom) - _integral(summed, left, bottom)
    upper = _integral(summed, right, top) - _integral(summed, left, top)
    # Large sums are subtracted: rounding must not make a black field less than black.
    total = max(lower - upper, 0.0)
    return total / (4.0 * half_x * half_y)


@compiled
def _integral(summed, x, y):
    """Give the integral from the origin to (x, y): exact, as the albedo is constant in a texel."""
    x = min(max(x, 0.0), summed.shape[1] - 1.0)
    y = min(max(y, 0.0), summed.shape[0] - 1.0)
    j = min(int(x), summed.shape[1] - 2)
    i = min(int(y), summed.shape[0] - 2)
    a, b = y - i, x - j
    upper = summed[i, j] * (1.0 - b) + summed[i, j + 1] * b
    lower = summed[i + 1, j] * (1.0 - b) + summed[i + 1, j + 1] * b
    return upper * (1.0 - a) + lower * a
