"""Camera intrinsics from views of a board, without the tracker."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.camera.board import BoardView
from tronlab.calib.camera.bow import BOW_TERMS
from tronlab.calib.camera.fit import covariance_of_common, residuals_px
from tronlab.calib.camera.model_choice import Choice, choose_kind
from tronlab.calib.camera.outliers import Sorted, sort_out
from tronlab.calib.camera.projection import N_INTRINSICS, DistortionModel
from tronlab.calib.camera.state import CameraFit, CameraKind, Corners
from tronlab.calib.camera.view_checks import (
    check_corners,
    check_coverage,
    check_tilts,
    coverage,
    start_poses,
)
from tronlab.calib.results import CameraResult, Statistics
from tronlab.devices.laboratory import PatternSpec
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

MAX_FOCAL_SIGMA = 0.02
"""A focal length known no better than to this part of it is not determined."""
MAX_FOCAL_RATIO = 3.0
"""Of the focal length found to the nominal one, or the other way round."""


@dataclass(frozen=True, slots=True)
class IntrinsicsSolution:
    """A camera calibrated from board views."""

    camera: CameraModel
    covariance: FloatArray
    """Of ``INTRINSICS``, shape (12, 12); zero for those the distortion model fixes."""
    model: DistortionModel
    bow_m: FloatArray
    """Of the board, shape (3,); see ``bow``."""
    bow_covariance_m2: FloatArray
    """Shape (3, 3); zero if the board is taken as flat."""
    is_bow_free: bool
    cam_from_board: tuple[RigidTransform, ...]
    """Of each view, also of the outliers."""
    view_rms_px: FloatArray
    """Root mean square of the lengths of each view's residuals, shape (n_views,); single corners
    left out do not count, those of an outlier view do."""
    sigma_px: float
    """One sigma of a corner's coordinate, from the residuals and their degrees of freedom."""
    outlier_views: tuple[int, ...]
    """Views left out of the solution."""
    outlier_corners: tuple[tuple[int, int], ...]
    """View and number of each corner left out of a view that counts."""
    statistics: Statistics

    @property
    def result(self) -> CameraResult:
        """Get what the record keeps."""
        return CameraResult(
            self.camera, self.covariance, self.model, self.bow_m, dict(self.statistics)
        )


@dataclass(frozen=True, slots=True)
class _Seen:
    """The views, and what of them belongs."""

    views: Sequence[BoardView]
    corners: Corners
    found: Sorted
    good: NDArray[np.intp]
    """Views that are no outliers."""

    @property
    def inliers(self) -> Corners:
        """Get the good corners of the good views."""
        return self.corners.weighted(self.found.is_good.astype(np.float64)).of_views(self.good)


def solve_intrinsics(
    views: Sequence[BoardView],
    nominal: CameraModel,
    pattern: PatternSpec,
    *,
    model: DistortionModel | None = None,
) -> IntrinsicsSolution:
    """Calibrate a camera: intrinsics, distortion model, and the bow of the board.

    Views and corners that do not belong are left out and listed; the distortion model is chosen by
    the error in views held out of the solution (see ``outliers`` and ``model_choice``).

    Args:
        views: Corners found, one entry an image; each with at least ``MIN_CORNERS``.
        nominal: The camera by its data sheet: where the solution starts.
        pattern: What is printed on the board.
        model: The distortion model, to have no other one tried.

    Raises:
        DegenerateGeometryError: Too few views, too little of the image covered, no tilted views, a
            mirrored board, or views that leave the focal length open; the message says what is
            missing.
        CalibrationError: Corners of another board, a size in another unit, or no convergence.
    """
    check_corners(views, pattern, nominal)
    check_coverage(views, nominal)
    poses = start_poses(views, nominal)
    check_tilts(poses)
    seen = _sort_out(views, Corners.of(views, pattern), CameraFit.at(nominal, poses), model)
    choice = choose_kind(
        seen.inliers,
        seen.found.fit.of_views(seen.good),
        model=model,
        sigma_px=seen.found.sigma_px,
    )
    solution = _solution(seen, choice)
    _check_focal_length(solution, nominal)
    return solution


def _sort_out(
    views: Sequence[BoardView], corners: Corners, start: CameraFit, model: DistortionModel | None
) -> _Seen:
    found = sort_out(corners, start, model)
    good = np.setdiff1d(np.arange(len(views)), found.outlier_views)
    try:
        check_coverage([views[i] for i in good], start.camera)
    except DegenerateGeometryError as error:
        left_out = ", ".join(map(str, found.outlier_views))
        raise DegenerateGeometryError(
            f"{error}\nwithout the views that do not fit the others: {left_out}"
        ) from None
    return _Seen(views, corners, found, good)


def _solution(seen: _Seen, choice: Choice) -> IntrinsicsSolution:
    fit, kind = choice.trial.fit, choice.trial.kind
    sigma_px = _sigma_px(seen.inliers, fit, kind)
    covariance = covariance_of_common(seen.inliers, fit, kind, sigma_px=sigma_px)
    bow_covariance = covariance[N_INTRINSICS:, N_INTRINSICS:]
    of_all = _with_outlier_views(fit, seen)
    view_rms_px = _view_rms_px(of_all, seen)
    return IntrinsicsSolution(
        camera=fit.camera,
        covariance=covariance[:N_INTRINSICS, :N_INTRINSICS],
        model=kind.model,
        bow_m=fit.bow_m,
        bow_covariance_m2=bow_covariance,
        is_bow_free=kind.is_bow_free,
        cam_from_board=of_all.cam_from_board,
        view_rms_px=view_rms_px,
        sigma_px=sigma_px,
        outlier_views=seen.found.outlier_views,
        outlier_corners=(outlier_corners := seen.found.outlier_corners(seen.views)),
        statistics={
            "n_views": len(seen.good),
            "n_corners": seen.inliers.n_used,
            "sigma_px": sigma_px,
            "view_rms_px": view_rms_px.tolist(),
            "outlier_views": list(seen.found.outlier_views),
            "outlier_corners": [list(corner) for corner in outlier_corners],
            "coverage": coverage(seen.views, fit.camera).tolist(),
            "bow_sigma_m": dict(
                zip(BOW_TERMS, np.sqrt(np.diag(bow_covariance)).tolist(), strict=True)
            ),
            "models": choice.table,
            "models_left_out": choice.left_out,
        },
    )


def _sigma_px(corners: Corners, fit: CameraFit, kind: CameraKind) -> float:
    square_sum = float((corners.weights[..., None] * residuals_px(corners, fit) ** 2).sum())
    dof = 2 * corners.n_used - len(kind.free) - 6 * len(corners.weights)
    return float(np.sqrt(square_sum / dof))


def _with_outlier_views(fit: CameraFit, seen: _Seen) -> CameraFit:
    """Give the fit with the poses of all views: those of outliers from the robust solution."""
    robust = seen.found.fit
    rotations, translations = robust.rotations.as_quat(), robust.translations_m.copy()
    rotations[seen.good], translations[seen.good] = fit.rotations.as_quat(), fit.translations_m
    return CameraFit(fit.camera, fit.bow_m, Rotation.from_quat(rotations), translations)


def _view_rms_px(fit: CameraFit, seen: _Seen) -> FloatArray:
    is_counted = seen.found.is_good.copy()
    outliers = list(seen.found.outlier_views)
    is_counted[outliers] = seen.corners.weights[outliers] > 0
    squares = (residuals_px(seen.corners, fit) ** 2).sum(axis=2)
    return np.sqrt((squares * is_counted).sum(axis=1) / is_counted.sum(axis=1))


def _check_focal_length(solution: IntrinsicsSolution, nominal: CameraModel) -> None:
    found, expected = solution.camera.fx_px, nominal.fx_px
    if not 1 / MAX_FOCAL_RATIO < found / expected < MAX_FOCAL_RATIO:
        raise CalibrationError(
            f"intrinsics: the focal length comes out as {found:.0f} px, nominal are"
            f" {expected:.0f} px; check the board's columns, rows and square_m, and focal length"
            " and pixel pitch of the nominal camera"
        )
    sigma = float(np.sqrt(solution.covariance[0, 0]))
    if sigma > MAX_FOCAL_SIGMA * found:
        raise DegenerateGeometryError(
            f"intrinsics: the views leave the focal length open: {found:.0f} +- {sigma:.0f} px;"
            " add views tilted by 30 deg and more, about both axes of the board"
        )
