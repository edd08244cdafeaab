from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tronlab.calib.board import BoardView
from tronlab.calib.intrinsics import check_coverage, solve_intrinsics
from tronlab.calib.projection import intrinsics_of, project_with_jacobian, with_intrinsics
from tronlab.errors import DegenerateGeometryError
from tronlab.geometry.camera import CameraModel

OPENCV_IMAGES = Path(__file__).parents[4] / "shared/data/opencv_calib"


def test_projection_derivatives_are_those_of_finite_differences(bench: SimpleNamespace) -> None:
    rng = np.random.default_rng(1)
    camera = with_intrinsics(bench.camera, intrinsics_of(bench.camera) + 1e-3)
    points = rng.uniform([-0.4, -0.4, 0.8], [0.4, 0.4, 1.2], (20, 3))
    uv, by_point, by_intrinsics = project_with_jacobian(camera, points)
    np.testing.assert_allclose(uv, camera.project(points), atol=1e-10)
    for i, step in enumerate(1e-6 * np.eye(3)):
        slope = (camera.project(points + step) - camera.project(points - step)) / 2e-6
        np.testing.assert_allclose(by_point[:, :, i], slope, rtol=1e-6, atol=1e-4)
    for i, step in enumerate(1e-5 * np.eye(9)):
        ahead, behind = (
            with_intrinsics(camera, intrinsics_of(camera) + sign * step) for sign in (1, -1)
        )
        slope = (ahead.project(points) - behind.project(points)) / 2e-5
        np.testing.assert_allclose(by_intrinsics[:, :, i], slope, rtol=1e-6, atol=1e-5)


@pytest.mark.opencv
def test_exact_corners_give_the_exact_camera(scene: Callable, bench: SimpleNamespace) -> None:
    truth = scene(1, n=12, noise=0.0)
    solution = solve_intrinsics(truth.views, bench.nominal)
    np.testing.assert_allclose(
        solution.camera.ray_table(), bench.camera.ray_table(), atol=2e-6
    )  # float32 inside OpenCV
    assert solution.sigma_px < 1e-4


@pytest.mark.opencv
def test_errors_agree_with_the_predicted_covariance(
    scene: Callable, bench: SimpleNamespace
) -> None:
    nees = []
    for seed in range(40):
        truth = scene(seed, n=10, sigma_px=0.1)
        solution = solve_intrinsics(truth.views, bench.nominal)
        assert 0.09 < solution.sigma_px < 0.11
        error = intrinsics_of(solution.camera) - intrinsics_of(bench.camera)
        nees.append(error @ np.linalg.solve(solution.covariance, error))
    low, high = chi2.ppf([0.005, 0.995], 9 * len(nees))
    assert low < sum(nees) < high


@pytest.mark.opencv
def test_too_few_views_are_refused(scene: Callable, bench: SimpleNamespace) -> None:
    with pytest.raises(DegenerateGeometryError, match="3 views of the board, at least 6"):
        solve_intrinsics(scene(1, n=3).views, bench.nominal)


@pytest.mark.opencv
def test_a_view_of_few_corners_is_refused(scene: Callable, bench: SimpleNamespace) -> None:
    views = scene(1, n=8).views
    views[5] = BoardView(views[5].ids[:5], views[5].p_board_m[:5], views[5].uv_px[:5])
    with pytest.raises(DegenerateGeometryError, match="view 5 has 5 corners, at least 12"):
        solve_intrinsics(views, bench.nominal)


def test_missing_coverage_is_shown(scene: Callable, bench: SimpleNamespace) -> None:
    left_half = []
    for view in scene(1, n=12).views:
        is_left = view.uv_px[:, 0] < 500
        if is_left.sum() >= 12:
            left_half.append(
                BoardView(view.ids[is_left], view.p_board_m[is_left], view.uv_px[is_left])
            )
    with pytest.raises(DegenerateGeometryError, match=r"there is a dot:\n  xxx\.\.") as caught:
        check_coverage(left_half, bench.nominal)
    assert "60% of the image" in str(caught.value)


@pytest.mark.opencv
def test_square_on_views_are_refused(scene: Callable, bench: SimpleNamespace) -> None:
    turns = [Rotation.from_euler("z", angle) for angle in np.linspace(-1.5, 1.5, 12)]
    with pytest.raises(DegenerateGeometryError, match="0 views see the board tilted by 10 deg"):
        solve_intrinsics(scene(3, n=12, turns=turns, noise=0.0).views, bench.camera)


@pytest.mark.opencv
@pytest.mark.skipif(not OPENCV_IMAGES.exists(), reason=f"needs {OPENCV_IMAGES}")
def test_real_chessboard_views_give_the_known_focal_length() -> None:
    views = []
    points = np.zeros((54, 3))
    points[:, :2] = np.mgrid[0:9, 0:6].T.reshape(-1, 2) * 0.025
    for path in sorted(OPENCV_IMAGES.glob("left*.jpg")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        found, corners = cv2.findChessboardCorners(image, (9, 6))
        if found:
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
            corners = cv2.cornerSubPix(image, corners, (11, 11), (-1, -1), stop)
            views.append(BoardView(np.arange(54), points, corners.reshape(-1, 2).astype(float)))
    nominal = CameraModel(
        width_px=640, height_px=480, fx_px=550.0, fy_px=550.0, cx_px=319.5, cy_px=239.5
    )
    solution = solve_intrinsics(views, nominal)
    assert abs(solution.camera.fx_px - 535.9) < 1.0
    assert np.argmax(solution.view_rms_px) == 1  # left02 has a wrong corner
