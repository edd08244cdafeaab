"""Projection of points with its derivatives, for the least-squares solvers of this package."""

from dataclasses import replace

import numpy as np

from tronlab.geometry.camera import CameraModel, distort, distortion_jacobian
from tronlab.geometry.poses import FloatArray

N_INTRINSICS = 9
"""fx, fy, cx, cy, k1, k2, p1, p2, k3."""


def intrinsics_of(camera: CameraModel) -> FloatArray:
    """Give fx, fy, cx, cy, k1, k2, p1, p2, k3, shape (9,)."""
    focal_and_centre = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]
    return np.array([*focal_and_centre, *camera.distortion])


def with_intrinsics(camera: CameraModel, intrinsics: FloatArray) -> CameraModel:
    """Give a camera of the same image size with other intrinsics, shape (9,)."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = (float(value) for value in intrinsics)
    return replace(camera, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, distortion=(k1, k2, p1, p2, k3))


def project_with_jacobian(
    camera: CameraModel, p_cam: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Project points and give the derivatives.

    Args:
        camera: The camera.
        p_cam: Points in cam, shape (n, 3), metres, z > 0.

    Returns:
        Pixel coordinates, shape (n, 2); their derivatives by ``p_cam``, shape (n, 2, 3), px/m, and
        by the intrinsics, shape (n, 2, 9).
    """
    inverse_z = 1.0 / p_cam[:, 2]
    rays = p_cam[:, :2] * inverse_z[:, None]
    x, y = rays.T
    r2 = x * x + y * y
    focal = np.array([camera.fx_px, camera.fy_px])
    distorted = distort(rays, camera.distortion)
    by_coefficients = np.stack(
        [
            np.stack([x * r2, y * r2], 1),
            np.stack([x * r2**2, y * r2**2], 1),
            np.stack([2 * x * y, r2 + 2 * y * y], 1),
            np.stack([r2 + 2 * x * x, 2 * x * y], 1),
            np.stack([x * r2**3, y * r2**3], 1),
        ],
        axis=2,
    )
    by_intrinsics = np.zeros((len(p_cam), 2, N_INTRINSICS))
    by_intrinsics[:, 0, 0], by_intrinsics[:, 1, 1] = distorted[:, 0], distorted[:, 1]
    by_intrinsics[:, 0, 2] = by_intrinsics[:, 1, 3] = 1.0
    by_intrinsics[:, :, 4:] = focal[:, None] * by_coefficients
    by_ray = focal[:, None] * distortion_jacobian(rays, camera.distortion)
    by_point = np.concatenate([by_ray, -(by_ray @ rays[:, :, None])], axis=2)
    uv = distorted * focal + [camera.cx_px, camera.cy_px]
    return uv, by_point * inverse_z[:, None, None], by_intrinsics
