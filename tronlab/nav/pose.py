"""The pose of a camera from rays and the points they hit: EPnP, RANSAC, robust least squares."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.camera import CameraModel, distortion_jacobian
from tronlab.geometry.poses import FloatArray
from tronlab.geometry.uncertainty import perturb

MIN_POINTS = 6
"""EPnP is defined from four points on; below six its answer is not worth having."""
RANSAC_ROUNDS = 1000
RANSAC_CONFIDENCE = 0.9999
TUKEY_CUT = 5.1
"""Residual, in standard deviations of one coordinate, from which a match has no weight: about 95 %
efficiency for Gaussian noise in two dimensions (Tukey's biweight)."""

_RAYLEIGH_MEDIAN = 1.1774100225154747
_MAX_ITERATIONS = 30
_CONVERGED = 1e-9
_CONVERGED_ENOUGH = 1e-6
"""Radians and metres: matches at the edge of having weight may come and go for ever."""
_MIN_SIGMA_PX = 1e-6


class NoPoseError(Exception):
    """The matches do not lead to a pose; it becomes a result with this text as its reason."""


@dataclass(frozen=True, slots=True)
class Correspondences:
    """Image positions and the points they show."""

    uv: FloatArray
    """Shape (n, 2), pixels."""
    rays: FloatArray
    """The rays through ``uv``, shape (n, 2)."""
    p_trs_m: FloatArray
    """Shape (n, 3)."""
    scale: FloatArray
    """How much less certain each position is than the best, shape (n,), 1 or more."""

    def __len__(self) -> int:
        return len(self.uv)

    def take(self, chosen: NDArray[Any]) -> "Correspondences":
        """Give the chosen ones, by index or by a mask."""
        return Correspondences(
            self.uv[chosen], self.rays[chosen], self.p_trs_m[chosen], self.scale[chosen]
        )


@dataclass(frozen=True, slots=True)
class PoseEstimate:
    """A pose by least squares, with what it rests on."""

    trs_from_cam: RigidTransform
    covariance: FloatArray
    """Of (rotation vector, translation) in trs, shape (6, 6), rad and m."""
    is_inlier: NDArray[np.bool_]
    """Which correspondences have weight, shape (n,)."""
    sigma_px: float
    """Standard deviation of one coordinate of the most certain positions."""


def solve_epnp(matches: Correspondences) -> RigidTransform:
    """Find ``trs_from_cam`` by EPnP (Lepetit et al., IJCV 81, 2009), every match trusted.

    Raises:
        NoPoseError: Too few matches, no solution, or one with points behind the camera.
    """
    _need(len(matches), MIN_POINTS, "matches")
    try:
        found, rotation_vector, translation = cv2.solvePnP(
            *_for_opencv(matches), np.eye(3), None, flags=cv2.SOLVEPNP_EPNP
        )
    except cv2.error as error:
        raise NoPoseError(f"EPnP failed: {_first_line(error)}") from error
    if not found:
        raise NoPoseError("EPnP found no solution")
    return _checked(rotation_vector, translation, matches)


def solve_ransac(
    matches: Correspondences, *, tolerance: float
) -> tuple[RigidTransform, NDArray[np.bool_]]:
    """Find ``trs_from_cam`` from matches of which some are wrong (RANSAC around EPnP).

    Args:
        matches: Correspondences, the most similar first.
        tolerance: Largest distance of an inlier on the plane at unit depth.

    Returns:
        The pose and which matches agree with it, shape (n,).

    Raises:
        NoPoseError: Too few matches, or too few of them agree.
    """
    _need(len(matches), MIN_POINTS, "matches")
    try:
        answer: Any = cv2.solvePnPRansac(
            *_for_opencv(matches),
            np.eye(3),
            None,
            iterationsCount=RANSAC_ROUNDS,
            reprojectionError=tolerance,
            confidence=RANSAC_CONFIDENCE,
            flags=cv2.SOLVEPNP_EPNP,
        )
    except cv2.error as error:
        raise NoPoseError(f"RANSAC failed: {_first_line(error)}") from error
    found, rotation_vector, translation, inliers = answer
    if not found or inliers is None:
        raise NoPoseError(f"RANSAC: no pose that {MIN_POINTS} of {len(matches)} matches agree with")
    agrees = np.zeros(len(matches), np.bool_)
    agrees[np.asarray(inliers).ravel()] = True
    _need(int(agrees.sum()), MIN_POINTS, "agreeing matches")
    return _checked(rotation_vector, translation, matches.take(agrees)), agrees


def refine_pose(
    start: RigidTransform, matches: Correspondences, camera: CameraModel, *, gate_px: float
) -> PoseEstimate:
    """Find the pose of least robustly weighted reprojection error, and its covariance.

    The matches within ``gate_px`` of the start take part; scale and weights are estimated anew in
    every iteration, and matches leave and return as their residuals say.

    Args:
        start: ``trs_from_cam`` near the answer.
        matches: All correspondences, wrong ones among them.
        camera: Intrinsics.
        gate_px: Largest residual at the start, pixels times ``scale``.

    Raises:
        NoPoseError: Too few matches agree, they do not determine the pose, or no convergence.
    """
    pose, gate = start, gate_px
    step, sigma = np.full(6, np.inf), gate_px
    for _ in range(_MAX_ITERATIONS):
        residuals = residuals_px(pose, matches, camera) / matches.scale[:, None]
        length = np.linalg.norm(residuals, axis=1)
        sigma = _sigma(length, gate)
        gate = min(gate, max(2.0 * TUKEY_CUT * sigma, 0.1))
        weights = _tukey(length / (TUKEY_CUT * sigma))
        _need(int((weights > 0).sum()), MIN_POINTS, "agreeing matches")
        jacobian = jacobian_px(pose, matches, camera) / matches.scale[:, None, None]
        step = _solve(jacobian, residuals, weights)
        pose = perturb(pose, step)
        if np.abs(step).max() < _CONVERGED:
            break
    if np.abs(step).max() > _CONVERGED_ENOUGH:
        raise NoPoseError(f"least squares did not converge in {_MAX_ITERATIONS} iterations")
    return _estimate(pose, matches, camera, sigma=sigma)


def residuals_px(
    trs_from_cam: RigidTransform, matches: Correspondences, camera: CameraModel
) -> FloatArray:
    """Give observed minus projected position, shape (n, 2), pixels; NaN behind the camera."""
    return matches.uv - camera.project(trs_from_cam.inv().apply(matches.p_trs_m))


def jacobian_px(
    trs_from_cam: RigidTransform, matches: Correspondences, camera: CameraModel
) -> FloatArray:
    """Give d(projected uv)/d(rotation vector, translation), shape (n, 2, 6), px per rad and m.

    The perturbation is that of ``geometry.uncertainty``: a left rotation in trs, and a translation.
    """
    cam_from_trs = trs_from_cam.rotation.inv().as_matrix()
    arm = matches.p_trs_m - trs_from_cam.translation
    p_cam = arm @ cam_from_trs.T
    x, y, z = p_cam.T
    zero = np.zeros_like(z)
    perspective = np.stack(
        [np.stack([1 / z, zero, -x / z**2], -1), np.stack([zero, 1 / z, -y / z**2], -1)], -2
    )
    arm_x, arm_y, arm_z = arm.T
    cross = np.stack(
        [
            np.stack([zero, -arm_z, arm_y], -1),
            np.stack([arm_z, zero, -arm_x], -1),
            np.stack([-arm_y, arm_x, zero], -1),
        ],
        -2,
    )
    moved = np.concatenate([cam_from_trs @ cross, np.broadcast_to(-cam_from_trs, cross.shape)], -1)
    lens = distortion_jacobian(p_cam[:, :2] / z[:, None], camera.distortion)
    focal = np.diag([camera.fx_px, camera.fy_px])
    return focal @ lens @ perspective @ moved


def _estimate(
    pose: RigidTransform, matches: Correspondences, camera: CameraModel, *, sigma: float
) -> PoseEstimate:
    """Give the estimate with the covariance of an M-estimator (Huber, Robust Statistics, 7.6)."""
    residuals = residuals_px(pose, matches, camera) / matches.scale[:, None]
    length = np.linalg.norm(residuals, axis=1)
    q = (length / (TUKEY_CUT * sigma)) ** 2
    is_inlier = q < 1.0
    n = int(is_inlier.sum())
    _need(n, MIN_POINTS, "agreeing matches")
    weights = _tukey(np.sqrt(q[is_inlier]))
    psi_squared = float((weights**2 * length[is_inlier] ** 2).sum() / (2 * n - 6))
    slope = float(((1.0 - q[is_inlier]) * (1.0 - 3.0 * q[is_inlier])).mean())
    if slope <= 0:
        raise NoPoseError("the residuals look like no measurement noise: the covariance is unknown")
    jacobian = jacobian_px(pose, matches.take(is_inlier), camera)
    jacobian /= matches.scale[is_inlier, None, None]
    information = np.einsum("nij,nik->jk", jacobian, jacobian)
    covariance = psi_squared / slope**2 * _invert(information)
    return PoseEstimate(pose, covariance, is_inlier, float(np.sqrt(psi_squared) / slope))


def _solve(jacobian: FloatArray, residuals: FloatArray, weights: FloatArray) -> FloatArray:
    used = weights > 0
    a = (jacobian[used] * weights[used, None, None]).reshape(-1, 6)
    j, r = jacobian[used].reshape(-1, 6), residuals[used].ravel()
    return _invert(a.T @ j) @ (a.T @ r)


def _invert(information: FloatArray) -> FloatArray:
    """Invert an information matrix (6, 6) of mixed units."""
    size = np.sqrt(np.diag(information))
    if not (np.isfinite(information).all() and size.min() > 0):
        raise NoPoseError("the matches do not determine the pose")
    scaled = information / np.outer(size, size)
    if np.linalg.cond(scaled) > 1e12:
        raise NoPoseError("the matches do not determine the pose: the points are degenerate")
    return np.linalg.inv(scaled) / np.outer(size, size)


def _sigma(length: FloatArray, gate: float) -> float:
    near = length[length < gate]
    _need(len(near), MIN_POINTS, f"matches within {gate:.1f} px")
    return max(float(np.median(near)) / _RAYLEIGH_MEDIAN, _MIN_SIGMA_PX)


def _tukey(relative: FloatArray) -> FloatArray:
    return np.where(relative < 1.0, (1.0 - np.minimum(relative, 1.0) ** 2) ** 2, 0.0)


def _checked(rotation_vector: Any, translation: Any, matches: Correspondences) -> RigidTransform:
    """Turn OpenCV's ``cam_from_trs`` round, if it is a pose that sees its points."""
    vector = np.concatenate([np.ravel(rotation_vector), np.ravel(translation)]).astype(np.float64)
    if not np.isfinite(vector).all():
        raise NoPoseError("the solver's pose is not finite")
    cam_from_trs = RigidTransform.from_components(vector[3:], Rotation.from_rotvec(vector[:3]))
    n_behind = int((cam_from_trs.apply(matches.p_trs_m)[:, 2] <= 0).sum())
    if n_behind:
        raise NoPoseError(f"the pose has {n_behind} of {len(matches)} points behind the camera")
    return cam_from_trs.inv()


def _for_opencv(matches: Correspondences) -> tuple[FloatArray, FloatArray]:
    """Give points and rays laid out row by row: OpenCV miscounts the points of other layouts."""
    return np.ascontiguousarray(matches.p_trs_m), np.ascontiguousarray(matches.rays)


def _need(n: int, n_min: int, what: str) -> None:
    if n < n_min:
        raise NoPoseError(f"{n} {what}, at least {n_min} needed")


def _first_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
