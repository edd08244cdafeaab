from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from tronlab.calib import bundle
from tronlab.calib.bundle import BundleSolution, Station, solve_bundle
from tronlab.calib.hand_eye import HandEyeStart, solve_closed_form
from tronlab.calib.intrinsics import solve_intrinsics
from tronlab.calib.projection import intrinsics_of
from tronlab.errors import CalibrationError
from tronlab.geometry.uncertainty import perturb, pose_difference


def solve(truth: SimpleNamespace, camera: object, sigma_px: float = 0.05) -> BundleSolution:
    start = solve_closed_form(truth.readings, truth.cam_from_board)
    return solve_bundle(truth.stations, camera=camera, start=start, sigma_px=sigma_px)


def test_derivatives_are_those_of_finite_differences(
    scene: Callable, bench: SimpleNamespace
) -> None:
    truth = scene(1, n=3)
    start = HandEyeStart(truth.tmac_from_cam, truth.trk_from_board)
    problem = bundle._make_problem(truth.stations, bench.camera, start, 0.05)
    rng = np.random.default_rng(1)
    x = np.concatenate([intrinsics_of(bench.camera), 0.05 * rng.normal(size=12 + 18)])
    jacobian = bundle._jacobian(problem, x)
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = 1e-6
        ahead, behind = (bundle._residuals(problem, x + sign * step) for sign in (1, -1))
        slope = (ahead - behind) / 2e-6
        np.testing.assert_allclose(jacobian[:, i], slope, atol=1e-5 * np.abs(slope).max() + 1e-3)


def test_exact_data_give_the_exact_answer_from_a_rough_start(
    scene: Callable, bench: SimpleNamespace
) -> None:
    truth = scene(2, n=8, noise=0.0)
    rng = np.random.default_rng(2)
    start = HandEyeStart(
        perturb(truth.tmac_from_cam, 0.01 * rng.normal(size=6)),
        perturb(truth.trk_from_board, 0.01 * rng.normal(size=6)),
    )
    rough = replace(bench.camera, fx_px=750.0, cx_px=511.5, distortion=(0.0,) * 5)
    solution = solve_bundle(truth.stations, camera=rough, start=start, sigma_px=0.05)
    np.testing.assert_allclose(
        pose_difference(solution.tmac_from_cam, truth.tmac_from_cam), 0.0, atol=1e-9
    )
    np.testing.assert_allclose(
        pose_difference(solution.trk_from_board, truth.trk_from_board), 0.0, atol=1e-9
    )
    np.testing.assert_allclose(
        intrinsics_of(solution.camera), intrinsics_of(bench.camera), atol=1e-6
    )
    assert solution.chi_square_pixels + solution.chi_square_poses < 1e-9


def test_errors_and_residuals_agree_with_what_is_predicted(
    scene: Callable, bench: SimpleNamespace
) -> None:
    hand_eye, intrinsics, pixels, poses = [], [], [], []
    dof_pixels = dof_poses = 0.0
    for seed in range(100, 160):
        truth = scene(seed, n=6, every=2)
        solution = solve(truth, bench.camera)
        error = pose_difference(solution.tmac_from_cam, truth.tmac_from_cam)
        hand_eye.append(error @ np.linalg.solve(solution.tmac_from_cam_covariance, error))
        error = intrinsics_of(solution.camera) - intrinsics_of(bench.camera)
        intrinsics.append(error @ np.linalg.solve(solution.camera_covariance, error))
        pixels.append(solution.chi_square_pixels)
        poses.append(solution.chi_square_poses)
        dof_pixels += solution.dof_pixels
        dof_poses += solution.dof_poses
    for values, dof in (
        (hand_eye, 6 * len(hand_eye)),
        (intrinsics, 9 * len(intrinsics)),
        (pixels, dof_pixels),
        (poses, dof_poses),
    ):
        low, high = chi2.ppf([0.005, 0.995], dof)
        assert low < sum(values) < high


@pytest.mark.opencv
def test_the_bundle_beats_its_start(scene: Callable, bench: SimpleNamespace) -> None:
    gains = []
    for seed in range(8):
        truth = scene(seed, n=10)
        intrinsics = solve_intrinsics(truth.views, bench.nominal)
        start = solve_closed_form(truth.readings, intrinsics.cam_from_board)
        solution = solve_bundle(
            truth.stations, camera=intrinsics.camera, start=start, sigma_px=intrinsics.sigma_px
        )
        before, after = (
            np.linalg.norm(pose_difference(found, truth.tmac_from_cam)[3:])
            for found in (start.tmac_from_cam, solution.tmac_from_cam)
        )
        gains.append(after / before)
    assert np.median(gains) < 0.8


def test_a_displaced_reading_shows_in_the_pose_chi_square(
    scene: Callable, bench: SimpleNamespace
) -> None:
    truth = scene(3, n=12)
    stations = list(truth.stations)
    moved = perturb(stations[4].reading.trk_from_tmac, np.array([0, 0, 0, 0.002, 0, 0]))
    stations[4] = Station(replace(stations[4].reading, trk_from_tmac=moved), stations[4].view)
    start = solve_closed_form(truth.readings, truth.cam_from_board)
    solution = solve_bundle(stations, camera=bench.camera, start=start, sigma_px=0.05)
    assert solution.chi_square_poses > chi2.ppf(0.999, solution.dof_poses)
    worst = np.argmax(np.linalg.norm(solution.pose_corrections[:, 3:], axis=1))
    assert worst == 4


def test_a_reading_without_covariance_is_refused(scene: Callable, bench: SimpleNamespace) -> None:
    truth = scene(3, n=4)
    stations = list(truth.stations)
    stations[2] = Station(
        replace(stations[2].reading, covariance=np.zeros((6, 6))), stations[2].view
    )
    start = solve_closed_form(truth.readings, truth.cam_from_board)
    with pytest.raises(CalibrationError, match="station 2 is not positive definite"):
        solve_bundle(stations, camera=bench.camera, start=start, sigma_px=0.05)
