"""Projection of points with its derivatives, for the least-squares solvers of this package."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.camera import (
    DISTORTION_NAMES,
    CameraModel,
    distort,
    distortion_jacobian,
)
from tronlab.geometry.poses import FloatArray

INTRINSICS = ("fx_px", "fy_px", "cx_px", "cy_px", *DISTORTION_NAMES)
"""Order of the intrinsics in vectors and covariances."""
N_INTRINSICS = len(INTRINSICS)

DistortionModel: TypeAlias = Literal["pinhole", "radial", "tangential", "brown", "rational"]
DISTORTION_MODELS: tuple[DistortionModel, ...] = get_args(DistortionModel)
"""From the simplest to the most general; each contains those before it."""
_FREE_COEFFICIENTS: Mapping[DistortionModel, tuple[str, ...]] = {
    "pinhole": (),
    "radial": ("k1", "k2"),
    "tangential": ("k1", "k2", "p1", "p2"),
    "brown": ("k1", "k2", "p1", "p2", "k3"),
    "rational": DISTORTION_NAMES,
}


def free_intrinsics(model: DistortionModel) -> NDArray[np.intp]:
    """Give which entries of ``INTRINSICS`` a model leaves free, shape (n,); the others are 0."""
    free = (*INTRINSICS[:4], *_FREE_COEFFICIENTS[model])
    return np.array([INTRINSICS.index(name) for name in free])


def intrinsics_of(camera: CameraModel) -> FloatArray:
    """Give the intrinsics in the order of ``INTRINSICS``, shape (12,)."""
    focal_and_centre = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]
    return np.array([*focal_and_centre, *camera.distortion])


def with_intrinsics(camera: CameraModel, intrinsics: FloatArray) -> CameraModel:
    """Give a camera of the same image size with other intrinsics, shape (12,)."""
    fx, fy, cx, cy, *distortion = (float(value) for value in intrinsics)
    return replace(camera, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, distortion=tuple(distortion))


def project_with_jacobian(
    camera: CameraModel, p_cam: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Project points and give the derivatives.

    Args:
        camera: The camera.
        p_cam: Points in cam, shape (n, 3), metres, z > 0.

    Returns:
        Pixel coordinates, shape (n, 2); their derivatives by ``p_cam``, shape (n, 2, 3), px/m, and
        by the intrinsics, shape (n, 2, 12).
    """
    inverse_z = 1.0 / p_cam[:, 2]
    rays = p_cam[:, :2] * inverse_z[:, None]
    x, y = rays.T
    focal = np.array([camera.fx_px, camera.fy_px])
    distorted = distort(rays, camera.distortion)
    by_coefficients = _by_coefficients(x, y, camera.distortion)
    by_intrinsics = np.zeros((len(p_cam), 2, N_INTRINSICS))
    by_intrinsics[:, 0, 0], by_intrinsics[:, 1, 1] = distorted[:, 0], distorted[:, 1]
    by_intrinsics[:, 0, 2] = by_intrinsics[:, 1, 3] = 1.0
    by_intrinsics[:, :, 4:] = focal[:, None] * by_coefficients
    by_ray = focal[:, None] * distortion_jacobian(rays, camera.distortion)
    by_point = np.concatenate([by_ray, -(by_ray @ rays[:, :, None])], axis=2)
    uv = distorted * focal + [camera.cx_px, camera.cy_px]
    return uv, by_point * inverse_z[:, None, None], by_intrinsics


def _by_coefficients(x: FloatArray, y: FloatArray, coefficients: tuple[float, ...]) -> FloatArray:
    """Give d(distorted)/d(k1, k2, p1, p2, k3, k4, k5, k6), shape (n, 2, 8)."""
    k1, k2, _, _, k3, k4, k5, k6 = coefficients
    r2 = x * x + y * y
    above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    ray, powers = np.stack([x, y], 1), np.stack([r2, r2**2, r2**3], 1)
    by_above = ray[:, :, None] * (powers / below[:, None])[:, None, :]
    by_below = -by_above * (above / below)[:, None, None]
    by_tangential = np.stack(
        [np.stack([2 * x * y, r2 + 2 * y * y], 1), np.stack([r2 + 2 * x * x, 2 * x * y], 1)], 2
    )
    return np.concatenate([by_above[:, :, :2], by_tangential, by_above[:, :, 2:], by_below], axis=2)
