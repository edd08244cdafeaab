"""Camera, hand-eye transform and board in one least-squares solution over pixels and poses.

Unknown are the intrinsics, ``tmac_from_cam``, ``trk_from_board``, and the true pose of the T-MAC at
every station, which the tracker's reading binds by its covariance. So each measurement counts by
its own noise, and what stays uncertain comes out with its covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.board import BoardView
from tronlab.calib.hand_eye import HandEyeStart
from tronlab.calib.projection import (
    N_INTRINSICS,
    intrinsics_of,
    project_with_jacobian,
    with_intrinsics,
)
from tronlab.devices.readings import PoseReading
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.geometry.uncertainty import perturb

_HAND_EYE = slice(N_INTRINSICS, N_INTRINSICS + 6)
_BOARD = slice(N_INTRINSICS + 6, N_INTRINSICS + 12)
_N_COMMON = N_INTRINSICS + 12
"""Unknowns that all stations share; six of each station follow."""

_FIRST_DAMPING = 1e-6
_LAST_DAMPING = 1e6
_MAX_STEPS = 100
_CONVERGED = 1e-12
"""Relative change of the sum of squares a step must promise to be worth taking."""


@dataclass(frozen=True, slots=True)
class Station:
    """What was measured while the robot stood still."""

    reading: PoseReading
    view: BoardView


@dataclass(frozen=True, slots=True)
class BundleSolution:
    """What the stations determine, with covariance and residuals."""

    camera: CameraModel
    camera_covariance: FloatArray
    """Of fx, fy, cx, cy, k1, k2, p1, p2, k3, shape (9, 9)."""
    tmac_from_cam: RigidTransform
    tmac_from_cam_covariance: FloatArray
    """Of (rotation vector, translation) in tmac, shape (6, 6), rad and m."""
    trk_from_board: RigidTransform
    residuals_px: tuple[FloatArray, ...]
    """Projected minus detected corners of each station, shape (n, 2)."""
    pose_corrections: FloatArray
    """From the tracker's reading to the estimated pose, (rotation vector, translation) in trk,
    shape (n_stations, 6), rad and m."""
    chi_square_pixels: float
    dof_pixels: float
    chi_square_poses: float
    """Squared pose corrections in units of the tracker's covariance."""
    dof_poses: float
    """What ``chi_square_poses`` is expected to be."""


@dataclass(frozen=True, slots=True)
class _Problem:
    camera: CameraModel
    start: HandEyeStart
    tmac_rotations: Rotation
    """As the tracker read them, one a station."""
    p_tmac_trk_m: FloatArray
    """As the tracker read them, shape (n_stations, 3)."""
    pose_weights: FloatArray
    """W with W^T W the inverse covariance of each reading, shape (n_stations, 6, 6)."""
    i_station: NDArray[np.intp]
    """Station of each corner, shape (n,)."""
    p_board_m: FloatArray
    uv_px: FloatArray
    sigma_px: float


@dataclass(frozen=True, slots=True)
class _State:
    """The unknowns as values, at one step."""

    camera: CameraModel
    tmac_from_cam: RigidTransform
    trk_from_board: RigidTransform
    tmac_rotations: FloatArray
    """Of each corner's station, shape (n, 3, 3)."""
    p_tmac_trk_m: FloatArray
    """Of each corner's station, shape (n, 3)."""


def solve_bundle(
    stations: Sequence[Station], *, camera: CameraModel, start: HandEyeStart, sigma_px: float
) -> BundleSolution:
    """Solve for everything at once.

    Args:
        stations: At least three, with turns about two axes (``solve_closed_form`` checks that).
        camera: Where the intrinsics start.
        start: Where hand-eye transform and board start.
        sigma_px: One sigma of a corner's coordinate.

    Raises:
        CalibrationError: A reading without a usable covariance, or no convergence.
    """
    problem = _make_problem(stations, camera, start, sigma_px)
    unknowns = np.zeros(_N_COMMON + 6 * len(stations))
    unknowns[:N_INTRINSICS] = intrinsics_of(camera)
    return _solution(problem, _minimise(problem, unknowns))


def _minimise(problem: _Problem, x: FloatArray) -> FloatArray:
    """Find the unknowns of the least sum of squares by Levenberg's and Marquardt's method.

    The normal equations are solved, columns scaled: the problem is well determined, and a dense
    factorisation of the Jacobian would take a hundred times as long.
    """
    residuals, damping = _residuals(problem, x), _FIRST_DAMPING
    for _ in range(_MAX_STEPS):
        cost = residuals @ residuals
        jacobian = _jacobian(problem, x)
        scale = np.linalg.norm(jacobian, axis=0)
        normal = (jacobian / scale).T @ (jacobian / scale)
        gradient = (jacobian / scale).T @ residuals
        while damping < _LAST_DAMPING:
            step = np.linalg.solve(normal + damping * np.eye(len(x)), -gradient)
            if -(gradient @ step) < _CONVERGED * (1.0 + cost):
                return x + step / scale
            trial = x + step / scale
            trial_residuals = _residuals(problem, trial)
            if trial_residuals @ trial_residuals < cost:  # false for NaN
                x, residuals, damping = trial, trial_residuals, damping / 10
                break
            damping *= 10
        else:
            break
    raise CalibrationError(
        "hand-eye: the least-squares solution does not converge; start and measurements contradict"
        " each other"
    )


def _make_problem(
    stations: Sequence[Station], camera: CameraModel, start: HandEyeStart, sigma_px: float
) -> _Problem:
    weights: list[FloatArray] = []
    for i, station in enumerate(stations):
        try:
            root = np.linalg.cholesky(station.reading.covariance)
        except np.linalg.LinAlgError:
            raise CalibrationError(
                f"hand-eye: the covariance of the tracker's reading at station {i} is not positive"
                " definite"
            ) from None
        weights.append(np.asarray(np.linalg.inv(root), dtype=np.float64))
    poses = [station.reading.trk_from_tmac for station in stations]
    return _Problem(
        camera=camera,
        start=start,
        tmac_rotations=Rotation.concatenate([pose.rotation for pose in poses]),
        p_tmac_trk_m=np.array([pose.translation for pose in poses]),
        pose_weights=np.array(weights),
        i_station=np.repeat(np.arange(len(stations)), [len(station.view) for station in stations]),
        p_board_m=np.vstack([station.view.p_board_m for station in stations]),
        uv_px=np.vstack([station.view.uv_px for station in stations]),
        sigma_px=sigma_px,
    )


def _station_unknowns(x: FloatArray) -> FloatArray:
    return x[_N_COMMON:].reshape(-1, 6)


def _state(problem: _Problem, x: FloatArray) -> _State:
    unknowns = _station_unknowns(x)
    rotations = Rotation.from_rotvec(unknowns[:, :3]) * problem.tmac_rotations
    return _State(
        camera=with_intrinsics(problem.camera, x[:N_INTRINSICS]),
        tmac_from_cam=perturb(problem.start.tmac_from_cam, x[_HAND_EYE]),
        trk_from_board=perturb(problem.start.trk_from_board, x[_BOARD]),
        tmac_rotations=rotations.as_matrix()[problem.i_station],
        p_tmac_trk_m=(problem.p_tmac_trk_m + unknowns[:, 3:])[problem.i_station],
    )


def _points(problem: _Problem, state: _State) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Give the corners in trk, in tmac less the camera's place, and in cam, shape (n, 3) each."""
    p_trk = state.trk_from_board.apply(problem.p_board_m)
    p_tmac = np.einsum("nji,nj->ni", state.tmac_rotations, p_trk - state.p_tmac_trk_m)
    from_cam_tmac = p_tmac - state.tmac_from_cam.translation
    return p_trk, from_cam_tmac, state.tmac_from_cam.rotation.inv().apply(from_cam_tmac)


def _residuals(problem: _Problem, x: FloatArray) -> FloatArray:
    state = _state(problem, x)
    uv, _, _ = project_with_jacobian(state.camera, _points(problem, state)[2])
    poses = np.einsum("nij,nj->ni", problem.pose_weights, _station_unknowns(x))
    return np.concatenate([((uv - problem.uv_px) / problem.sigma_px).ravel(), poses.ravel()])


def _jacobian(problem: _Problem, x: FloatArray) -> FloatArray:
    """Give the derivatives of the residuals by the unknowns, shape (n_residuals, n_unknowns)."""
    state = _state(problem, x)
    n_corners, n_stations = len(problem.uv_px), len(problem.p_tmac_trk_m)
    by_hand_eye, by_board, by_station, by_intrinsics = _pixel_derivatives(problem, state)
    pixels = np.zeros((n_corners, 2, len(x)))
    pixels[:, :, :N_INTRINSICS] = by_intrinsics
    pixels[:, :, _HAND_EYE] = by_hand_eye @ _unknown_to_left(x[_HAND_EYE])
    pixels[:, :, _BOARD] = by_board @ _unknown_to_left(x[_BOARD])
    poses = np.zeros((n_stations, 6, len(x)))
    for i, unknowns in enumerate(_station_unknowns(x)):
        own = slice(_N_COMMON + 6 * i, _N_COMMON + 6 * i + 6)
        is_own = problem.i_station == i
        pixels[is_own, :, own] = by_station[is_own] @ _unknown_to_left(unknowns)
        poses[i, :, own] = problem.pose_weights[i]
    return np.vstack(
        [pixels.reshape(2 * n_corners, -1) / problem.sigma_px, poses.reshape(6 * n_stations, -1)]
    )


def _pixel_derivatives(
    problem: _Problem, state: _State
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Give d(uv) by small (rotation, translation) of hand-eye, board, station; by intrinsics.

    p_cam = Rx^T (Rs^T (p_trk - ts) - tx), and a pose's small rotation turns about its parent's
    axes, so that of a vector v the derivative is -[v]x.
    """
    p_trk, from_cam_tmac, p_cam = _points(problem, state)
    _, by_point, by_intrinsics = project_with_jacobian(state.camera, p_cam)
    by_tmac = by_point @ state.tmac_from_cam.rotation.as_matrix().T
    by_trk = by_tmac @ np.swapaxes(state.tmac_rotations, 1, 2)
    by_hand_eye = np.concatenate([by_tmac @ _cross(from_cam_tmac), -by_tmac], axis=2)
    by_station = np.concatenate([by_trk @ _cross(p_trk - state.p_tmac_trk_m), -by_trk], axis=2)
    turned_board = p_trk - state.trk_from_board.translation
    by_board = np.concatenate([-by_trk @ _cross(turned_board), by_trk], axis=2)
    return by_hand_eye, by_board, by_station, by_intrinsics


def _cross(v: FloatArray) -> FloatArray:
    """Give the matrices [v]x, shape (n, 3, 3)."""
    matrices = np.zeros((len(v), 3, 3))
    matrices[:, [2, 0, 1], [1, 2, 0]] = v
    return matrices - np.swapaxes(matrices, 1, 2)


def _unknown_to_left(unknown: FloatArray) -> FloatArray:
    """Give d(small left perturbation) by the unknown (rotation vector, translation), (6, 6).

    exp(w + dw) = exp(J dw) exp(w) with the left Jacobian J of SO(3) (Chirikjian, Stochastic Models,
    Information Theory, and Lie Groups, vol. 2, 2012).
    """
    w = unknown[:3]
    angle = float(np.linalg.norm(w))
    w_cross = _cross(w[None])[0]
    matrix = np.eye(6)
    if angle < 1e-8:
        matrix[:3, :3] += w_cross / 2
        return matrix
    matrix[:3, :3] += (1 - np.cos(angle)) / angle**2 * w_cross
    matrix[:3, :3] += (angle - np.sin(angle)) / angle**3 * w_cross @ w_cross
    return matrix


def _solution(problem: _Problem, x: FloatArray) -> BundleSolution:
    residuals, jacobian, state = _residuals(problem, x), _jacobian(problem, x), _state(problem, x)
    covariance = _covariance(jacobian)
    n_pixels = problem.uv_px.size
    pixels, poses = residuals[:n_pixels], residuals[n_pixels:]
    rows = jacobian[n_pixels:]
    explained_poses = float(np.einsum("ij,jk,ik->", rows, covariance, rows))
    n_unknowns = len(x)
    to_left = _unknown_to_left(x[_HAND_EYE])
    by_corner = (pixels * problem.sigma_px).reshape(-1, 2)
    return BundleSolution(
        camera=state.camera,
        camera_covariance=covariance[:N_INTRINSICS, :N_INTRINSICS],
        tmac_from_cam=state.tmac_from_cam,
        tmac_from_cam_covariance=to_left @ covariance[_HAND_EYE, _HAND_EYE] @ to_left.T,
        trk_from_board=state.trk_from_board,
        residuals_px=tuple(
            by_corner[problem.i_station == i] for i in range(len(problem.p_tmac_trk_m))
        ),
        pose_corrections=_station_unknowns(x),
        chi_square_pixels=float(pixels @ pixels),
        dof_pixels=len(pixels) - (n_unknowns - explained_poses),
        chi_square_poses=float(poses @ poses),
        dof_poses=len(poses) - explained_poses,
    )


def _covariance(jacobian: FloatArray) -> FloatArray:
    """Invert the normal equations, columns scaled to length 1 before."""
    scale = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / scale
    try:
        inverse = np.linalg.inv(scaled.T @ scaled)
    except np.linalg.LinAlgError:
        raise CalibrationError("hand-eye: the stations do not determine the solution") from None
    covariance = inverse / np.outer(scale, scale)
    return (covariance + covariance.T) / 2
