"""How well the hand-eye solution fits, as plain values, and what a person should be warned of."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict

import numpy as np
from scipy.stats import chi2

from tronlab.calib.hand_eye.bundle import BundleProblem, BundleSolution
from tronlab.calib.hand_eye.closed_forms import HandEyeStart, disagreements, distances
from tronlab.calib.hand_eye.good_views import GoodViews
from tronlab.calib.hand_eye.held_out import hold_out, rms
from tronlab.calib.hand_eye.least_determined import name_least_determined
from tronlab.calib.results import Statistics
from tronlab.geometry.poses import FloatArray, xyz_quat_from_pose

MIN_P_VALUE = 1e-3
"""Less likely pose corrections deserve a warning."""


def hand_eye_statistics(
    problem: BundleProblem,
    bundle: BundleSolution,
    good: GoodViews,
    closed_forms: Mapping[str, HandEyeStart],
) -> Statistics:
    """Give what the record keeps beside the transform.

    Args:
        problem: With trust 1 in the readings that count, 0 in the outliers.
        bundle: Its solution.
        good: The stations in it.
        closed_forms: Solutions from the poses of the readings that count.
    """
    used, state = np.flatnonzero(problem.trust), bundle.state
    residuals = [bundle.residuals_px[i] for i in used]
    corrections = bundle.pose_corrections[used]
    held_out = hold_out(problem, state)
    distance_m = float(state.cam_from_board[used].translation[:, 2].mean())
    stations = [good.numbers[i] for i in used]
    return {
        "n_stations": len(stations),
        "stations": stations,
        "outlier_stations": sorted({*good.numbers, *good.bad_stations} - {*stations}),
        "n_free_views": len(good.free_views),
        "n_corners": sum(map(len, residuals)),
        "rms_px": rms(np.vstack(residuals)),
        "station_rms_px": [rms(station) for station in residuals],
        "chi_square_pixels": bundle.chi_square_pixels,
        "dof_pixels": bundle.dof_pixels,
        "chi_square_poses": bundle.chi_square_poses,
        "dof_poses": bundle.dof_poses,
        "p_value_poses": _p_value(bundle),
        "pose_correction_rms_m": rms(corrections[:, 3:]),
        "pose_correction_rms_rad": rms(corrections[:, :3]),
        "held_out": None if held_out is None else asdict(held_out),
        "least_determined": name_least_determined(
            state.tmac_from_cam, bundle.tmac_from_cam_covariance, distance_m=distance_m
        ),
        "closed_forms": distances(closed_forms, state.tmac_from_cam),
        "warnings": [*disagreements(closed_forms), *_warnings(problem, bundle, good)],
        "board_bow_m": state.bow_m.tolist(),
        "trk_from_board": xyz_quat_from_pose(state.trk_from_board).tolist(),
    }


def _warnings(problem: BundleProblem, bundle: BundleSolution, good: GoodViews) -> Iterator[str]:
    for number in good.bad_stations:
        yield f"station {number} is left out: its image does not fit the others"
    shifts_m, turns_rad = lengths(bundle.pose_corrections)
    for i in np.flatnonzero(problem.trust == 0.0):
        yield (
            f"station {good.numbers[i]} is left out: the T-MAC's reading lies"
            f" {1e3 * shifts_m[i]:.2f} mm and {np.degrees(turns_rad[i]):.3f} deg from what the"
            " others say"
        )
    if (p_value := _p_value(bundle)) < MIN_P_VALUE:
        yield (
            "readings and images agree worse than the tracker's stated accuracy allows"
            f" (p = {p_value:.2g})"
        )


def _p_value(bundle: BundleSolution) -> float:
    return float(chi2.sf(bundle.chi_square_poses, bundle.dof_poses))


def lengths(differences: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Give the lengths of the translations and of the rotation vectors, shape (n,), m and rad."""
    return np.linalg.norm(differences[:, 3:], axis=1), np.linalg.norm(differences[:, :3], axis=1)
