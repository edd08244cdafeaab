"""Camera intrinsics from views of a board, without the tracker."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.board import BoardView
from tronlab.calib.projection import (
    N_INTRINSICS,
    project_with_jacobian,
    with_intrinsics,
)
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray, skew

MIN_VIEWS = 6
MIN_CORNERS = 12
"""Of a view that counts."""
GRID = 5
"""The image is looked at in GRID x GRID fields."""
MIN_COVERAGE = 0.8
"""Part of the fields that must have corners."""
MIN_TILT_RAD = np.radians(10.0)
MIN_TILTED_VIEWS = 3
"""Square-on views leave focal length and distance apart by their product only."""
_ITERATIONS = cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-12


@dataclass(frozen=True, slots=True)
class IntrinsicsSolution:
    """A camera calibrated from board views."""

    camera: CameraModel
    covariance: FloatArray
    """Of fx, fy, cx, cy, k1, k2, p1, p2, k3, shape (9, 9)."""
    cam_from_board: tuple[RigidTransform, ...]
    """Of each view."""
    view_rms_px: FloatArray
    """Root mean square of the corner residuals' lengths of each view, shape (n_views,)."""
    sigma_px: float
    """One sigma of a corner's coordinate, from the residuals and their degrees of freedom."""


def solve_intrinsics(views: Sequence[BoardView], nominal: CameraModel) -> IntrinsicsSolution:
    """Calibrate a pinhole camera with five distortion coefficients.

    Args:
        views: Corners found, one entry an image; each with at least ``MIN_CORNERS``.
        nominal: The camera by its data sheet: where the solution starts.

    Raises:
        DegenerateGeometryError: Too few views, too little of the image covered, or no tilted
            views; the message says what is missing.
        CalibrationError: The solution did not converge.
    """
    check_coverage(views, nominal)
    _check_tilts([_start_pose(view, nominal) for view in views])
    camera, cam_from_board = _calibrate(views, nominal)
    return _with_statistics(camera, cam_from_board, views)


def check_coverage(views: Sequence[BoardView], camera: CameraModel) -> None:
    """Raise DegenerateGeometryError if the views cannot determine the intrinsics."""
    if len(views) < MIN_VIEWS:
        raise DegenerateGeometryError(
            f"intrinsics: {len(views)} views of the board, at least {MIN_VIEWS} needed"
        )
    for i, view in enumerate(views):
        if len(view) < MIN_CORNERS:
            raise DegenerateGeometryError(
                f"intrinsics: view {i} has {len(view)} corners, at least {MIN_CORNERS} needed"
            )
    size = np.array([camera.width_px, camera.height_px])
    uv = np.vstack([view.uv_px for view in views])
    fields = np.clip(((uv + 0.5) / size * GRID).astype(int), 0, GRID - 1)
    is_covered = np.zeros((GRID, GRID), dtype=bool)
    is_covered[fields[:, 1], fields[:, 0]] = True
    if is_covered.mean() < MIN_COVERAGE:
        picture = "\n".join("  " + "".join("x" if c else "." for c in row) for row in is_covered)
        raise DegenerateGeometryError(
            f"intrinsics: corners lie in {is_covered.mean():.0%} of the image, at least"
            f" {MIN_COVERAGE:.0%} needed; show the board where there is a dot:\n{picture}"
        )


def _start_pose(view: BoardView, nominal: CameraModel) -> RigidTransform:
    found, rvec, tvec = cv2.solvePnP(view.p_board_m, view.uv_px, nominal.matrix, None)
    if not found:
        raise CalibrationError("intrinsics: no pose of the board fits a view's corners")
    return RigidTransform.from_components(tvec.ravel(), Rotation.from_rotvec(rvec.ravel()))


def _check_tilts(cam_from_board: Sequence[RigidTransform]) -> None:
    cosines = np.array([pose.rotation.as_matrix()[2, 2] for pose in cam_from_board])
    tilts = np.arccos(np.clip(np.abs(cosines), 0.0, 1.0))
    n_tilted = int((tilts >= MIN_TILT_RAD).sum())
    if n_tilted < MIN_TILTED_VIEWS:
        raise DegenerateGeometryError(
            f"intrinsics: {n_tilted} views see the board tilted by"
            f" {np.degrees(MIN_TILT_RAD):.0f} deg or more, at least {MIN_TILTED_VIEWS} needed;"
            " square-on views do not separate focal length from distance"
        )


def _calibrate(
    views: Sequence[BoardView], nominal: CameraModel
) -> tuple[CameraModel, tuple[RigidTransform, ...]]:
    try:
        _, matrix, distortion, rvecs, tvecs = cv2.calibrateCamera(
            [view.p_board_m.astype(np.float32) for view in views],
            [view.uv_px.astype(np.float32) for view in views],
            (nominal.width_px, nominal.height_px),
            nominal.matrix,
            np.zeros(5),
            flags=cv2.CALIB_USE_INTRINSIC_GUESS,
            criteria=_ITERATIONS,
        )
    except cv2.error as error:
        raise CalibrationError(f"intrinsics: no solution: {error.err}") from error
    focal_and_centre = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    camera = with_intrinsics(nominal, np.array([*focal_and_centre, *distortion.ravel()[:5]]))
    return camera, tuple(
        RigidTransform.from_components(np.ravel(t), Rotation.from_rotvec(np.ravel(r)))
        for r, t in zip(rvecs, tvecs, strict=True)
    )


def _with_statistics(
    camera: CameraModel, cam_from_board: tuple[RigidTransform, ...], views: Sequence[BoardView]
) -> IntrinsicsSolution:
    """Add what the residuals tell; the views' poses are eliminated from the normal equations."""
    information = np.zeros((N_INTRINSICS, N_INTRINSICS))
    square_sums = np.zeros(len(views))
    for i, (pose, view) in enumerate(zip(cam_from_board, views, strict=True)):
        p_cam = pose.apply(view.p_board_m)
        uv, by_point, by_intrinsics = project_with_jacobian(camera, p_cam)
        turned = np.stack([-skew(p) for p in p_cam - pose.translation])
        by_pose = np.concatenate([by_point @ turned, by_point], axis=2).reshape(-1, 6)
        by_intrinsics = by_intrinsics.reshape(-1, N_INTRINSICS)
        basis, _ = np.linalg.qr(by_pose)
        free = by_intrinsics - basis @ (basis.T @ by_intrinsics)
        information += free.T @ free
        square_sums[i] = ((uv - view.uv_px) ** 2).sum()
    n_corners = np.array([len(view) for view in views])
    dof = 2 * n_corners.sum() - N_INTRINSICS - 6 * len(views)
    variance = square_sums.sum() / dof
    scale = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    return IntrinsicsSolution(
        camera=camera,
        covariance=variance * covariance,
        cam_from_board=cam_from_board,
        view_rms_px=np.sqrt(square_sums / n_corners),
        sigma_px=float(np.sqrt(variance)),
    )
