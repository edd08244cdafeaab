"""The pose by robustly weighted least squares, and its covariance."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.nav.pose.bound import invert_information
from tronlab.nav.pose.correspondences import MIN_POINTS, Correspondences, NoPoseError, need
from tronlab.nav.pose.projection import (
    MIN_SIGMA_PX,
    RAYLEIGH_MEDIAN,
    jacobian_of_arms_px,
    jacobian_px,
    residuals_px,
)
from tronlab.nav.pose.smooth_noise import unit_covariance

TUKEY_CUT = 5.1
"""Residual, in standard deviations of one coordinate, from which a match has no weight: about 95 %
efficiency for Gaussian noise in two dimensions (Tukey's biweight)."""
TUKEY_EFFICIENCY = 0.9491
"""Variance of the mean over that of the biweight with this cut, for Gaussian noise in the plane."""

_MAX_ITERATIONS = 50
_SCALE_ITERATIONS = 25
"""In so many the scale is estimated anew; with one that stays every later step is downhill, where
matches at the edge of having weight could come and go for ever."""
_CONVERGED = 1e-7
_CONVERGED_ENOUGH = 1e-6
"""Radians and metres."""
_SAME_VIEW = 1e-4
"""After a smaller step, radians and metres, the Jacobian is the one before: most iterations only
settle scale and weights, and the pose they lead to changes by that part of its standard
deviation."""


@dataclass(frozen=True, slots=True)
class PoseEstimate:
    """A pose by least squares, with what it rests on."""

    trs_from_cam: RigidTransform
    covariance: FloatArray
    """Of (rotation vector, translation) in trs, shape (6, 6), rad and m."""
    is_inlier: NDArray[np.bool_]
    """Which correspondences have weight, shape (n,)."""
    sigma_px: float
    """Standard deviation of one coordinate of the most certain positions, with what the weights
    cost."""
    smooth_ratio: float
    """Variance of the position over what independent noise of ``sigma_px`` would make it, 1 or
    more; see ``smooth_noise``."""

    @property
    def noise_px(self) -> float:
        """Get the standard deviation of one coordinate, for the Cramer-Rao bound."""
        return self.sigma_px * TUKEY_EFFICIENCY**0.5


def refine_pose(
    start: RigidTransform, matches: Correspondences, camera: CameraModel, *, gate_px: float
) -> PoseEstimate:
    """Find the pose of least robustly weighted reprojection error, and its covariance.

    The matches within ``gate_px`` of the start take part; scale and weights are estimated anew as
    it goes, and matches leave and return as their residuals say.

    Args:
        start: ``trs_from_cam`` near the answer.
        matches: All correspondences, wrong ones among them.
        camera: Intrinsics.
        gate_px: Largest residual at the start, pixels times ``scale``.

    Raises:
        NoPoseError: Too few matches agree, they do not determine the pose, or no convergence.
    """
    # Not as one transform: scipy makes a rotation of it anew, and checks it, at every look.
    rotation, translation = start.rotation, start.translation
    gate, step, sigma = gate_px, np.full(6, np.inf), gate_px
    jacobian = np.empty((len(matches), 2, 6))
    for iteration in range(_MAX_ITERATIONS):
        matrix = rotation.as_matrix()
        arm_m = matches.p_trs_m - translation
        residuals = (matches.uv - camera.project(arm_m @ matrix)) / matches.scale[:, None]
        length = np.linalg.norm(residuals, axis=1)
        if iteration < _SCALE_ITERATIONS:
            sigma = _sigma(length, gate)
            gate = min(gate, max(2.0 * TUKEY_CUT * sigma, 0.1))
        weights = _tukey(length / (TUKEY_CUT * sigma))
        used = np.flatnonzero(weights)
        need(len(used), MIN_POINTS, "agreeing matches")
        if np.abs(step).max() > _SAME_VIEW:
            jacobian = _jacobian(arm_m, matrix, camera)
            jacobian /= matches.scale[:, None, None]
        step = _solve(jacobian[used], residuals[used], weights[used])
        rotation, translation = Rotation.from_rotvec(step[:3]) * rotation, translation + step[3:]
        if np.abs(step).max() < _CONVERGED:
            break
    if np.abs(step).max() > _CONVERGED_ENOUGH:
        raise NoPoseError(f"least squares did not converge in {_MAX_ITERATIONS} iterations")
    pose = RigidTransform.from_components(translation, rotation)
    return _estimate(pose, matches, camera, sigma=sigma)


def _jacobian(arm_m: FloatArray, rotation: FloatArray, camera: CameraModel) -> FloatArray:
    """Give the Jacobian for all points; of those beside the camera, which have no weight, any."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.ascontiguousarray(jacobian_of_arms_px(arm_m, rotation, camera))


def _estimate(
    pose: RigidTransform, matches: Correspondences, camera: CameraModel, *, sigma: float
) -> PoseEstimate:
    """Give the estimate with the covariance of an M-estimator (Huber, Robust Statistics, 7.6).

    Huber's is for independent noise; smooth noise, which a pose follows, may be stronger.
    """
    residuals = residuals_px(pose, matches, camera) / matches.scale[:, None]
    q = (np.linalg.norm(residuals, axis=1) / (TUKEY_CUT * sigma)) ** 2
    is_inlier = q < 1.0
    inliers, residuals, q = matches.take(is_inlier), residuals[is_inlier], q[is_inlier]
    need(len(inliers), MIN_POINTS, "agreeing matches")
    psi = _tukey(np.sqrt(q))[:, None] * residuals
    psi_squared = float((psi**2).sum() / (2 * len(inliers) - 6))
    slope = float(((1.0 - q) * (1.0 - 3.0 * q)).mean())
    if slope <= 0:
        raise NoPoseError("the residuals look like no measurement noise: the covariance is unknown")
    jacobian = jacobian_px(pose, inliers, camera) / inliers.scale[:, None, None]
    information = np.einsum("nij,nik->jk", jacobian, jacobian)
    sigma_px = float(np.sqrt(psi_squared) / slope)
    unit, independent = unit_covariance(inliers, psi, jacobian), invert_information(information)
    ratio = float(np.trace(unit[3:, 3:]) / np.trace(independent[3:, 3:]))
    return PoseEstimate(pose, sigma_px**2 * unit, is_inlier, sigma_px, ratio)


def _solve(jacobian: FloatArray, residuals: FloatArray, weights: FloatArray) -> FloatArray:
    rows = jacobian.reshape(-1, 6)
    weighted = (rows * np.repeat(weights, 2)[:, None]).T
    return invert_information(weighted @ rows) @ (weighted @ residuals.ravel())


def _sigma(length: FloatArray, gate: float) -> float:
    near = length[length < gate]
    need(len(near), MIN_POINTS, f"matches within {gate:.1f} px")
    return max(float(np.median(near)) / RAYLEIGH_MEDIAN, MIN_SIGMA_PX)


def _tukey(relative: FloatArray) -> FloatArray:
    return np.where(relative < 1.0, (1.0 - np.minimum(relative, 1.0) ** 2) ** 2, 0.0)
