"""Hand-eye transform from pairs of poses that somebody else measured: files instead of pixels.

Nothing is known of the poses' noise; it is estimated with the solution, see ``pose_fit``.
"""

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.view_checks import BOARD_DISTANCES_M
from tronlab.calib.hand_eye.closed_forms import (
    HandEyeStart,
    check_motions,
    disagreements,
    distances,
    solve_closed_forms,
)
from tronlab.calib.hand_eye.contradictions import check_agreement
from tronlab.calib.hand_eye.held_out import rms
from tronlab.calib.hand_eye.least_determined import name_least_determined
from tronlab.calib.hand_eye.pose_fit import (
    NOISE,
    PoseFit,
    PosePairs,
    fit_pose_pairs,
    mean_correlation,
    one_more_unknown,
    refit,
    residuals,
)
from tronlab.calib.inputs import PosePairsInput
from tronlab.calib.results import HandEyeResult, Statistics
from tronlab.errors import CalibrationError, DegenerateGeometryError, FrameError
from tronlab.geometry.poses import (
    FloatArray,
    pose_from_xyz_quat,
    xyz_quat_from_pose,
)

_N_FOLDS = 5
_MIN_PAIRS_HELD_OUT = 8
_SCALE_SIGMAS = 3.0
"""Few, since a wrong scale raises the noise that is estimated, and sigma with it."""
_SCALE_TOLERANCE = 0.005
"""A scale nearer to 1 is no reason to doubt the board."""


def solve_pose_pairs(measured: PosePairsInput) -> HandEyeResult:
    """Find where the camera sits on the T-MAC from pairs of poses alone.

    Returns:
        ``tmac_from_cam`` (base_from_cam with ``eye_to_hand``), its covariance from the estimated
        noise, and statistics: outliers, noise, held-out errors, the closed forms, warnings.

    Raises:
        DegenerateGeometryError: Too few pairs, or their turns do not determine the transform.
        CalibrationError: The pairs contradict each other: other units, a mirrored frame, a pose the
            wrong way round, or most pairs disagree.
    """
    pairs = pose_pairs(measured)
    tmac, cam = pairs.trk_from_tmac, pairs.cam_from_board
    check_motions(tmac)
    check_agreement(tmac, cam)
    _check_distance(pairs)
    starts = solve_closed_forms(tmac, cam)
    fit = fit_pose_pairs(pairs, best_start(pairs, starts))
    correlation = mean_correlation(pairs, fit)
    covariance = correlation * fit.covariance[:6, :6]
    statistics = _statistics(pairs, fit, starts, covariance)
    return HandEyeResult(
        tmac_from_cam=fit.start.tmac_from_cam,
        covariance=covariance,
        statistics={**statistics, "correlated_pairs": correlation},
    )


def pose_pairs(measured: PosePairsInput) -> PosePairs:
    """Give the poses of the input.

    Raises:
        CalibrationError: No pairs, or a pose that is none; the message has its number.
    """
    if not measured.pairs:
        raise CalibrationError("hand-eye: no pairs of poses")
    tmac: list[RigidTransform] = []
    cam: list[RigidTransform] = []
    for i, pair in enumerate(measured.pairs):
        try:
            tmac.append(pose_from_xyz_quat(pair.trk_from_tmac))
            cam.append(pose_from_xyz_quat(pair.cam_from_board))
        except FrameError as error:
            raise CalibrationError(f"hand-eye: pair {i}: {error}") from error
    return PosePairs(RigidTransform.concatenate(tmac), RigidTransform.concatenate(cam))


def best_start(pairs: PosePairs, starts: Mapping[str, HandEyeStart]) -> HandEyeStart:
    """Give the closed form that half of the pairs fit best: a few wrong pairs do not choose it."""
    return min(starts.values(), key=lambda start: _median_misfit(pairs, start))


def _median_misfit(pairs: PosePairs, start: HandEyeStart) -> float:
    """Give the median distance from the board, its turn counted at the T-MAC's distance."""
    reach_m = float(np.median(np.linalg.norm(pairs.cam_from_board.translation, axis=1)))
    e = residuals(pairs, start)
    e = e - np.median(e, axis=0)
    return float(np.median((e[:, 3:] ** 2 + (reach_m * e[:, :3]) ** 2).sum(axis=1)))


def _check_distance(pairs: PosePairs) -> None:
    distance = float(np.median(np.linalg.norm(pairs.cam_from_board.translation, axis=1)))
    low, high = BOARD_DISTANCES_M
    if not low <= distance <= high:
        raise CalibrationError(
            f"hand-eye: the board is {distance:.3g} m from the camera, {low} to {high:.0f} m are"
            " possible; give all poses in metres, not millimetres"
        )


def _statistics(
    pairs: PosePairs, fit: PoseFit, starts: Mapping[str, HandEyeStart], covariance: FloatArray
) -> Statistics:
    e = residuals(pairs, fit.start)
    used = e[fit.is_used]
    found = fit.start.tmac_from_cam
    scatter = pairs.boards(found).translation
    distance_m = float(np.median(np.linalg.norm(pairs.cam_from_board.translation, axis=1)))
    sigmas = np.sqrt(fit.variances)
    return {
        "n_pairs": len(pairs),
        "outlier_pairs": np.flatnonzero(~fit.is_used).tolist(),
        "rms_rotation_rad": rms(used[:, :3]),
        "rms_translation_m": rms(used[:, 3:]),
        "target_scatter_m": float(
            np.median(np.linalg.norm(scatter - scatter.mean(axis=0), axis=1))
        ),
        "noise": {name: float(sigma) for name, sigma in zip(NOISE, sigmas, strict=True)},
        "held_out": _held_out(pairs, fit),
        "least_determined": name_least_determined(found, covariance, distance_m=distance_m),
        "closed_forms": distances(starts, found),
        "warnings": [*disagreements(starts), *_warnings(pairs, fit)],
        "trk_from_board": xyz_quat_from_pose(fit.start.trk_from_board).tolist(),
    }


def _held_out(pairs: PosePairs, fit: PoseFit) -> dict[str, float] | None:
    """Predict each fifth of the pairs by the others; None if these are too few for that.

    The fifths are runs of pairs: neighbours in a stream share their errors, and one would predict
    the other too well.
    """
    if fit.is_used.sum() < _MIN_PAIRS_HELD_OUT:
        return None
    errors: list[FloatArray] = []
    for held_out in np.array_split(np.flatnonzero(fit.is_used), _N_FOLDS):
        others = fit.is_used.copy()
        others[held_out] = False
        try:
            check_motions(pairs.trk_from_tmac[others])
        except DegenerateGeometryError:
            return None
        errors.append(residuals(pairs[held_out], refit(pairs, fit, others)))
    e = np.vstack(errors)
    return {"rotation_rms_rad": rms(e[:, :3]), "translation_rms_m": rms(e[:, 3:])}


def _warnings(pairs: PosePairs, fit: PoseFit) -> Iterator[str]:
    e = residuals(pairs, fit.start)
    outliers = np.flatnonzero(~fit.is_used)
    if len(outliers):
        worst = outliers[np.argmax(np.linalg.norm(e[outliers, 3:], axis=1))]
        yield (
            f"{len(outliers)} of {len(pairs)} pairs are left out: they do not fit the others; the"
            f" worst, pair {worst}, lies {1e3 * np.linalg.norm(e[worst, 3:]):.1f} mm and"
            f" {np.degrees(np.linalg.norm(e[worst, :3])):.2f} deg away"
        )
    scale, sigma = _camera_scale(pairs, fit)
    if abs(scale - 1.0) > max(_SCALE_TOLERANCE, _SCALE_SIGMAS * sigma):
        yield (
            f"the poses fit better if the camera's distances are multiplied by {scale:.4f} +-"
            f" {sigma:.4f}: check the size of the board's squares and the focal length"
        )


def _camera_scale(pairs: PosePairs, fit: PoseFit) -> tuple[float, float]:
    """Give by what the camera's distances must be multiplied to fit best, and its sigma."""
    by_scale = np.zeros((len(pairs), 6))
    trk_from_cam = pairs.trk_from_tmac.rotation * fit.start.tmac_from_cam.rotation
    by_scale[:, 3:] = trk_from_cam.apply(pairs.cam_from_board.translation)
    change, sigma = one_more_unknown(pairs, fit, by_scale)
    return 1.0 + change, sigma * float(np.sqrt(mean_correlation(pairs, fit)))
