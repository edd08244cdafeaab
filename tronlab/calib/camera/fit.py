"""Least squares of one camera over views of a board: intrinsics, bow, and the views' poses.

Levenberg's and Marquardt's method. A pose touches the corners of its own view alone, so the poses
are eliminated from the normal equations (Schur complement; Triggs et al., Bundle Adjustment - A
Modern Synthesis, 2000, section 6.1), and what is left to solve has the size of the intrinsics.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tronlab.calib.camera.projection import INTRINSICS, N_INTRINSICS, project_with_jacobian
from tronlab.calib.camera.state import N_COMMON, CameraFit, CameraKind, Corners
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

BOW_PRIOR_M = 2e-3
"""A board bows by this much, one sigma; it keeps the bow determined where the views do not."""
DENOMINATOR_PRIOR = 1.0
"""Size of k4, k5, k6, one sigma: of the many that give nearly the same distortion, because factors
above and below cancel, those without large factors are taken."""


_DENOMINATOR = [INTRINSICS.index(name) for name in ("k4", "k5", "k6")]
_FIRST_DAMPING = 1e-6
_LAST_DAMPING = 1e8
_MAX_STEPS = 60
_CONVERGED = 1e-7
"""Part of the sum of squares a step must promise to be worth another one after it. Of 2000
residuals it is 2e-4 sigma^2: no unknown is then more than 0.02 of its sigma away."""
_EXACT_PX2 = 1e-12
"""A promise below this is rounding."""


@dataclass(frozen=True, slots=True)
class _Normal:
    """Normal equations, blocks of shared unknowns and of each view's pose."""

    common: FloatArray
    """Shape (n_free, n_free)."""
    mixed: FloatArray
    """Shape (n_views, 6, n_free)."""
    poses: FloatArray
    """Shape (n_views, 6, 6)."""
    common_gradient: FloatArray
    pose_gradients: FloatArray
    """Shape (n_views, 6)."""

    def step(self, damping: float) -> tuple[FloatArray, FloatArray, float]:
        """Give the steps of shared unknowns and poses, and the decrease they promise."""
        poses = _damped(self.poses, damping)
        solved = np.linalg.solve(
            poses, np.concatenate([self.mixed, self.pose_gradients[:, :, None]], axis=2)
        )
        by_common, by_gradient = solved[:, :, :-1], solved[:, :, -1]
        reduced = _damped(self.common, damping) - np.einsum("vip,viq->pq", self.mixed, by_common)
        right = np.einsum("vip,vi->p", self.mixed, by_gradient) - self.common_gradient
        scale = np.sqrt(np.diag(self.common))
        common = np.linalg.solve(reduced / np.outer(scale, scale), right / scale) / scale
        pose_steps = -by_gradient - by_common @ common
        promise = -self.common_gradient @ common - (self.pose_gradients * pose_steps).sum()
        return common, pose_steps, float(promise)

    def covariance(self) -> FloatArray:
        """Give the inverse of what is left of the shared unknowns' equations, (n_free, n_free)."""
        by_common = np.linalg.solve(self.poses, self.mixed)
        reduced = self.common - np.einsum("vip,viq->pq", self.mixed, by_common)
        scale = np.sqrt(np.diag(self.common))
        inverse = np.linalg.inv(reduced / np.outer(scale, scale)) / np.outer(scale, scale)
        return (inverse + inverse.T) / 2


def fit_camera(
    corners: Corners, start: CameraFit, kind: CameraKind, *, sigma_px: float
) -> CameraFit:
    """Find camera, bow and poses of the least weighted sum of squares.

    Args:
        corners: What was seen.
        start: Where to start; poses in the order of ``corners``.
        kind: What is free.
        sigma_px: One sigma of a corner's coordinate: what the priors are weighed against.

    Raises:
        CalibrationError: It does not converge.
    """
    return _minimise(corners, start.restricted(kind), kind.free, sigma_px)


def resect(corners: Corners, fit: CameraFit) -> CameraFit:
    """Find the poses alone, with the camera and the bow as they are.

    Raises:
        CalibrationError: It does not converge.
    """
    return _minimise(corners, fit, np.zeros(0, dtype=np.intp), 1.0)


def residuals_px(corners: Corners, fit: CameraFit) -> FloatArray:
    """Give projected less detected corners, shape (n_views, n, 2); filled-up ones are as well."""
    return _projected(_points(corners, fit)[1], fit.camera) - corners.uv_px


def covariance_of_common(
    corners: Corners, fit: CameraFit, kind: CameraKind, *, sigma_px: float
) -> FloatArray:
    """Give the covariance of what all views share, shape (15, 15); zero for what is not free.

    Raises:
        CalibrationError: The views do not determine it.
    """
    normal = _normal_equations(corners, fit, kind.free, prior_information(sigma_px))
    covariance = np.zeros((N_COMMON, N_COMMON))
    try:
        covariance[np.ix_(kind.free, kind.free)] = sigma_px**2 * normal.covariance()
    except np.linalg.LinAlgError:
        raise _undetermined() from None
    if (np.diag(covariance)[kind.free] <= 0).any():
        raise _undetermined()
    return covariance


def _minimise(
    corners: Corners, start: CameraFit, free: NDArray[np.intp], sigma_px: float
) -> CameraFit:
    prior = prior_information(sigma_px)
    fit, cost, damping = start, _cost(corners, start, prior), _FIRST_DAMPING
    for _ in range(_MAX_STEPS):
        normal = _normal_equations(corners, fit, free, prior)
        while damping < _LAST_DAMPING:
            common, poses, promise = _step(normal, damping)
            trial = fit.moved(_spread(common, free), poses)
            if promise < _CONVERGED * cost + _EXACT_PX2:
                return trial if _cost(corners, trial, prior) <= cost else fit
            trial_cost = _cost(corners, trial, prior)
            if trial_cost < cost:
                fit, cost, damping = trial, trial_cost, max(damping / 10, 1e-15)
                break
            damping *= 10
        else:
            break
    raise CalibrationError(
        "intrinsics: the least-squares solution does not converge; check that pattern and nominal"
        " camera are those of the images"
    )


def _step(normal: _Normal, damping: float) -> tuple[FloatArray, FloatArray, float]:
    try:
        return normal.step(damping)
    except np.linalg.LinAlgError:
        raise _undetermined() from None


def _undetermined() -> CalibrationError:
    return CalibrationError(
        "intrinsics: the views do not determine the camera; add views at other places of the image,"
        " tilted by 20 deg and more about both axes of the board"
    )


def prior_information(sigma_px: float) -> FloatArray:
    """Give what is known before of what all views share, shape (15,).

    It is the inverse variance of each, times ``sigma_px`` squared: to be added to the diagonal of
    normal equations whose residuals are in pixels.
    """
    prior = np.zeros(N_COMMON)
    prior[_DENOMINATOR] = (sigma_px / DENOMINATOR_PRIOR) ** 2
    prior[N_INTRINSICS:] = (sigma_px / BOW_PRIOR_M) ** 2
    return prior


def _spread(values: FloatArray, free: NDArray[np.intp]) -> FloatArray:
    spread = np.zeros(N_COMMON)
    spread[free] = values
    return spread


def _damped(matrices: FloatArray, damping: float) -> FloatArray:
    return matrices * (1.0 + damping * np.eye(matrices.shape[-1]))


def _points(corners: Corners, fit: CameraFit) -> tuple[FloatArray, FloatArray]:
    """Give the corners turned into cam, before and after the translation, (n_views, n, 3)."""
    on_board = corners.p_board_m.copy()
    on_board[..., 2] += corners.basis @ fit.bow_m
    turned = on_board @ np.swapaxes(fit.rotations.as_matrix(), 1, 2)
    return turned, turned + fit.translations_m[:, None, :]


def _projected(p_cam: FloatArray, camera: CameraModel) -> FloatArray:
    return camera.pixels(p_cam[..., :2] / p_cam[..., 2:])


def _cost(corners: Corners, fit: CameraFit, prior: FloatArray) -> float:
    _, p_cam = _points(corners, fit)
    if not (p_cam[..., 2] > 0).all():
        return np.inf
    squares = ((_projected(p_cam, fit.camera) - corners.uv_px) ** 2).sum(axis=2)
    cost = (corners.weights * squares).sum() + prior @ fit.common**2
    return float(cost) if np.isfinite(cost) else np.inf


def _normal_equations(
    corners: Corners, fit: CameraFit, free: NDArray[np.intp], prior: FloatArray
) -> _Normal:
    residuals, by_common, by_pose = _derivatives(corners, fit)
    n_views, n, _ = corners.uv_px.shape
    root = np.sqrt(corners.weights)[:, :, None, None]
    rows = np.concatenate([by_common[..., free], by_pose, residuals[..., None]], axis=3) * root
    rows = rows.reshape(n_views, 2 * n, -1)
    products = np.swapaxes(rows, 1, 2) @ rows
    n_free, pose = len(free), slice(len(free), len(free) + 6)
    common_sum = products[:, :n_free].sum(axis=0)
    return _Normal(
        common=common_sum[:, :n_free] + np.diag(prior[free]),
        mixed=products[:, pose, :n_free],
        poses=products[:, pose, pose],
        common_gradient=common_sum[:, -1] + (prior * fit.common)[free],
        pose_gradients=products[:, pose, -1],
    )


def _derivatives(corners: Corners, fit: CameraFit) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Give residuals, derivatives by what is shared and by the poses, (n_views, n, 2, ...)."""
    turned, p_cam = _points(corners, fit)
    n_views, n, _ = p_cam.shape
    uv, by_point, by_intrinsics = project_with_jacobian(fit.camera, p_cam.reshape(-1, 3))
    by_point = by_point.reshape(n_views, n, 2, 3)
    by_intrinsics = by_intrinsics.reshape(n_views, n, 2, N_INTRINSICS)
    by_height = np.einsum("vnij,vj->vni", by_point, fit.rotations.as_matrix()[:, :, 2])
    by_bow = by_height[..., None] * corners.basis[:, :, None, :]
    by_turn = np.cross(turned[:, :, None, :], by_point)
    return (
        uv.reshape(n_views, n, 2) - corners.uv_px,
        np.concatenate([by_intrinsics, by_bow], axis=3),
        np.concatenate([by_turn, by_point], axis=3),
    )
