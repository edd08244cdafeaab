"""Where the camera sits on the T-MAC, by least squares over pixels and the tracker's poses.

Closed forms start it; where they disagree there is a warning. Stations whose reading contradicts
the others are left out and listed. What remains uncertain comes out as covariance, and stations
held out of the solution tell whether to believe it.
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.board import BoardView
from tronlab.calib.camera.bow import BOW_TERMS
from tronlab.calib.camera.intrinsics import IntrinsicsSolution
from tronlab.calib.camera.projection import N_INTRINSICS
from tronlab.calib.camera.state import CameraKind
from tronlab.calib.hand_eye.bundle import (
    BundleProblem,
    BundleSolution,
    BundleState,
    Station,
    make_problem,
)
from tronlab.calib.hand_eye.closed_forms import HandEyeStart, check_motions, solve_closed_forms
from tronlab.calib.hand_eye.contradictions import check_units_and_hands, explain
from tronlab.calib.hand_eye.good_views import GoodViews
from tronlab.calib.hand_eye.starts import best_start, misfit, sampled_starts
from tronlab.calib.hand_eye.station_outliers import solve_without_outliers
from tronlab.calib.hand_eye.statistics import hand_eye_statistics, lengths
from tronlab.calib.results import CameraResult, HandEyeResult
from tronlab.devices.laboratory import PatternSpec
from tronlab.errors import CalibrationError
from tronlab.geometry.poses import FloatArray

MAX_CHI_SQUARE_RATIO = 3.0
"""Pose corrections that many times larger (squared) than the tracker's covariance allows are no
noise: readings and images contradict each other."""

LEAST_SIGMA_PX = 1e-4
"""Corners are kept to so many pixels; less scatter than that is made up."""
FAR_BETTER = 0.1
"""A start from few stations is tried if most of the others are nearer to it by this factor."""

_Solved = tuple[BundleProblem, BundleSolution]
"""With trust 1 in the readings that count, 0 in the outliers."""


@dataclass(frozen=True, slots=True)
class HandEyeSolution:
    """Camera and hand-eye transform, and what they rest on."""

    camera: CameraResult
    hand_eye: HandEyeResult
    bundle: BundleSolution
    stations: tuple[int, ...]
    """Number of each station in ``bundle``; missing are those whose image is an outlier."""

    @property
    def residuals_px(self) -> tuple[FloatArray, ...]:
        """Get projected minus detected corners of each of ``stations``, shape (n, 2)."""
        return self.bundle.residuals_px[: len(self.stations)]


def solve_hand_eye(
    stations: Sequence[Station],
    intrinsics: IntrinsicsSolution,
    pattern: PatternSpec,
    *,
    free_views: Sequence[BoardView] = (),
    is_camera_free: bool = True,
) -> HandEyeSolution:
    """Solve for camera, board and hand-eye transform together.

    Args:
        stations: T-MAC readings with the view of the board at each.
        intrinsics: The camera by the views alone, those of the stations first, then the free ones.
        pattern: The board.
        free_views: Views of the same board without a reading.
        is_camera_free: Whether the intrinsics are solved for; else they stay, and the covariance
            is that for an exactly known camera.

    Raises:
        DegenerateGeometryError: Too few stations, turns about one axis only, or a left-handed
            frame.
        CalibrationError: Readings and images contradict each other or look like millimetres, or a
            reading has no usable covariance.
    """
    good = GoodViews.of(stations, free_views, intrinsics)
    check_motions(good.poses()[0])
    problem = make_problem(
        good.stations,
        good.free_views,
        pattern,
        free=_free(intrinsics, is_camera_free=is_camera_free),
        sigma_px=max(intrinsics.sigma_px, LEAST_SIGMA_PX),
    )
    check_units_and_hands(*good.poses())
    closed_forms = solve_closed_forms(*good.poses())
    problem, bundle = _solve(problem, good, intrinsics, closed_forms.values())
    if not problem.trust.all():
        check_motions(good.poses(problem.trust > 0)[0])
        closed_forms = solve_closed_forms(*good.poses(problem.trust > 0))
    statistics = hand_eye_statistics(problem, bundle, good, closed_forms)
    statistics["corner_sigma_px"] = intrinsics.sigma_px
    covariance = bundle.tmac_from_cam_covariance
    return HandEyeSolution(
        camera=_camera_result(bundle, intrinsics) if is_camera_free else intrinsics.result,
        hand_eye=HandEyeResult(bundle.state.tmac_from_cam, covariance, statistics),
        bundle=bundle,
        stations=tuple(good.numbers),
    )


def _free(intrinsics: IntrinsicsSolution, *, is_camera_free: bool) -> NDArray[np.intp]:
    free = CameraKind(intrinsics.model, intrinsics.is_bow_free).free
    return free if is_camera_free else free[free >= N_INTRINSICS]


def _solve(
    problem: BundleProblem,
    good: GoodViews,
    intrinsics: IntrinsicsSolution,
    starts: Iterable[HandEyeStart],
) -> _Solved:
    """Start from all stations; if that leads to a contradiction, from few that agree."""
    cam_from_board = RigidTransform.concatenate(list(good.cam_from_board))

    def state_of(start: HandEyeStart) -> BundleState:
        return BundleState(
            camera=intrinsics.camera,
            bow_m=intrinsics.bow_m,
            tmac_from_cam=start.tmac_from_cam,
            trk_from_board=start.trk_from_board,
            cam_from_board=cam_from_board,
        )

    first = best_start(problem, map(state_of, starts))
    try:
        return _agreed(problem, first, good)
    except CalibrationError as error:
        samples = map(state_of, sampled_starts(*good.poses()))
        second = best_start(problem, [first, *samples])
        with suppress(CalibrationError):
            if misfit(problem, second) < FAR_BETTER * misfit(problem, first):
                return _agreed(problem, second, good)
        lines = [f"hand-eye: {error}", explain(*good.poses())]
        raise CalibrationError("\n".join(filter(None, lines))) from None


def _agreed(problem: BundleProblem, start: BundleState, good: GoodViews) -> _Solved:
    """Solve by the stations that agree, and refuse the solution if even they do not fit."""
    problem, bundle = solve_without_outliers(problem, start)
    ratio = bundle.chi_square_poses / bundle.dof_poses
    if ratio > MAX_CHI_SQUARE_RATIO:
        shifts_m, turns_rad = lengths(problem.trust[:, None] * bundle.pose_corrections)
        worst = int(np.argmax(shifts_m))
        raise CalibrationError(
            "tracker and camera contradict each other: the T-MAC's readings would have"
            f" to be wrong by {np.sqrt(ratio):.1f} times their stated accuracy; most at station"
            f" {good.numbers[worst]}, by {shifts_m[worst] * 1e3:.3f} mm and"
            f" {np.degrees(turns_rad[worst]):.4f} deg;\ncheck that board, camera and T-MAC are"
            " fastened and stand still, and that the board's square_m is right, then calibrate"
            " again"
        )
    return problem, bundle


def _camera_result(bundle: BundleSolution, intrinsics: IntrinsicsSolution) -> CameraResult:
    before = intrinsics.result
    bow_sigma_m = np.sqrt(np.diag(bundle.bow_covariance_m2)).tolist()
    bow_statistics = {"bow_sigma_m": dict(zip(BOW_TERMS, bow_sigma_m, strict=True))}
    return replace(
        before,
        camera=bundle.state.camera,
        covariance=bundle.camera_covariance,
        bow_m=bundle.state.bow_m,
        statistics={**before.statistics, **bow_statistics},
    )
