"""A camera that is known already: only where the board is in each view remains to be found."""

from collections.abc import Sequence

import numpy as np

from tronlab.calib.camera.board import BoardView
from tronlab.calib.camera.bow import N_BOW
from tronlab.calib.camera.fit import resect, residuals_px
from tronlab.calib.camera.intrinsics import IntrinsicsSolution
from tronlab.calib.camera.projection import (
    DISTORTION_MODELS,
    N_INTRINSICS,
    DistortionModel,
    free_intrinsics,
    intrinsics_of,
)
from tronlab.calib.camera.state import CameraFit, Corners
from tronlab.calib.camera.view_checks import MIN_CORNERS, check_corners, start_poses
from tronlab.devices.laboratory import PatternSpec
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel


def known_camera(
    views: Sequence[BoardView], camera: CameraModel, pattern: PatternSpec
) -> IntrinsicsSolution:
    """Find the poses of a flat board in the views of a camera that is taken as it is.

    Args:
        views: Corners found, one entry an image.
        camera: The camera; it counts as known exactly.
        pattern: What is printed on the board.

    Raises:
        CalibrationError: Corners of another board, a size in another unit, a view with fewer than
            ``MIN_CORNERS`` corners, or no convergence.
    """
    check_corners(views, pattern, camera)
    for i, view in enumerate(views):
        if len(view) < MIN_CORNERS:
            raise CalibrationError(
                f"camera: view {i} has {len(view)} corners, at least {MIN_CORNERS} needed"
            )
    corners = Corners.of(views, pattern)
    fit = resect(corners, CameraFit.at(camera, start_poses(views, camera)))
    square_sums = (corners.weights[..., None] * residuals_px(corners, fit) ** 2).sum(axis=(1, 2))
    dof = 2 * corners.n_used - 6 * len(views)
    view_rms_px = np.sqrt(square_sums / np.count_nonzero(corners.weights, axis=1))
    sigma_px = float(np.sqrt(square_sums.sum() / dof))
    return IntrinsicsSolution(
        camera=camera,
        covariance=np.zeros((N_INTRINSICS, N_INTRINSICS)),
        model=_simplest_model(camera),
        bow_m=np.zeros(N_BOW),
        bow_covariance_m2=np.zeros((N_BOW, N_BOW)),
        is_bow_free=False,
        cam_from_board=fit.cam_from_board,
        view_rms_px=view_rms_px,
        sigma_px=sigma_px,
        outlier_views=(),
        outlier_corners=(),
        statistics={
            "n_views": len(views),
            "n_corners": corners.n_used,
            "sigma_px": sigma_px,
            "view_rms_px": view_rms_px.tolist(),
            "outlier_views": [],
            "outlier_corners": [],
        },
    )


def _simplest_model(camera: CameraModel) -> DistortionModel:
    """Give the simplest model that has all coefficients the camera has."""
    used = np.flatnonzero(intrinsics_of(camera))
    return next(m for m in DISTORTION_MODELS if np.isin(used, free_intrinsics(m)).all())
