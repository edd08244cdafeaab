"""Whether what a core answered is an answer."""

from dataclasses import fields
from reprlib import repr as brief
from typing import get_args

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.poses import FloatArray
from tronlab.nav.core import NavigationResult, Status

_TOLERANCE = 1e-4
"""How far the correlations of a covariance may be from symmetry, and their eigenvalues below 0:
what inverting an ill-conditioned matrix does to them."""
_MOST = 1 << 53
_LONGEST_S = 1e300


def checked(result: object) -> NavigationResult:
    """Give the result back if it is one that can be scored.

    Raises:
        TypeError: It is no ``NavigationResult``.
        ValueError: Something in it cannot be; the message names it.
    """
    if not isinstance(result, NavigationResult):
        raise TypeError(f"the core answered a {type(result).__name__}, not a NavigationResult")
    if result.status not in get_args(Status):
        raise ValueError(f"the core answered the unknown status {brief(result.status)}")
    if result.status == "ok":
        _check_pose(result.trs_from_cam)
    for name in (field.name for field in fields(result)):
        if name.startswith("n_"):
            _check_count(name, getattr(result, name))
        if name.startswith("time_"):
            _check_duration(name, getattr(result, name))
    for name, matrix in (("covariance", result.covariance), ("bound", result.bound)):
        if matrix is not None:
            _check_covariance(name, matrix)
    _check_inliers(result)
    return result


def _check_pose(trs_from_cam: object) -> None:
    if not isinstance(trs_from_cam, RigidTransform):
        raise ValueError("the core answered 'ok' without a pose")
    if not (trs_from_cam.single and np.isfinite(trs_from_cam.as_matrix()).all()):
        raise ValueError("the core answered 'ok' with a pose that is not finite, or several")


def _check_count(name: str, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise ValueError(f"{name} is {brief(value)}, must be a whole number")
    if not 0 <= value <= _MOST:
        raise ValueError(f"{name} is {brief(value)}, must be from 0 to {_MOST}")


def _check_duration(name: str, value: object) -> None:
    if not isinstance(value, int | float | np.number) or not 0 <= value <= _LONGEST_S:
        raise ValueError(f"{name} is {brief(value)}, must be a finite number from 0")


def _check_covariance(name: str, value: FloatArray) -> None:
    matrix = np.asarray(value, dtype=np.float64)
    if matrix.shape != (6, 6) or not np.isfinite(matrix).all():
        raise ValueError(f"{name} is not finite or not of shape (6, 6): shape {matrix.shape}")
    # Angles and lengths have sizes of their own: compare with the standard deviations of each.
    sigma = np.sqrt(np.abs(matrix.diagonal()))
    scale = np.where(sigma > 0, sigma, 1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        correlation = matrix / scale / scale[:, None]
        asymmetry = np.abs(correlation - correlation.T).max()
    if not asymmetry <= _TOLERANCE:  # NaN: beyond all bounds
        raise ValueError(f"{name} is not symmetric: {brief(matrix.tolist())}")
    if np.linalg.eigvalsh(correlation).min() < -_TOLERANCE:
        raise ValueError(
            f"{name} has a variance below 0; its diagonal: {brief(matrix.diagonal().tolist())}"
        )


def _check_inliers(result: NavigationResult) -> None:
    uv = np.asarray(result.uv_inliers)
    if uv.ndim != 2 or uv.shape[1] != 2 or not np.isfinite(uv).all():
        raise ValueError(f"uv_inliers have shape {uv.shape}, expected (n, 2), all finite")
    landmarks = np.asarray(result.landmark_inliers)
    if landmarks.ndim != 1 or (landmarks.size and len(landmarks) != len(uv)):
        raise ValueError(
            f"landmark_inliers have shape {landmarks.shape}, expected ({len(uv)},) or none"
        )
