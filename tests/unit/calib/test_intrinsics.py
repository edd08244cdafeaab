from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tronlab.calib.camera.board import BoardView, corner_points, detect_board
from tronlab.calib.camera.bow import bowed
from tronlab.calib.camera.fit import covariance_of_common, fit_camera
from tronlab.calib.camera.intrinsics import IntrinsicsSolution, solve_intrinsics
from tronlab.calib.camera.projection import DISTORTION_MODELS, free_intrinsics, intrinsics_of
from tronlab.calib.camera.state import CameraFit, CameraKind, Corners
from tronlab.calib.camera.view_checks import check_coverage, start_poses
from tronlab.devices.laboratory import PatternSpec
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

pytestmark = pytest.mark.opencv
OPENCV_IMAGES = Path(__file__).parents[4] / "shared/data/opencv_calib"

CINEGON_4_8 = CameraModel(
    1024, 1024, 764.2, 764.9, 515.3, 506.8, distortion=(-0.1, 0.09, 4e-4, -3e-4)
)
CINEGON_10 = CameraModel(
    1024, 1024, 1551.0, 1550.2, 508.1, 514.4, distortion=(-0.16, 0.3, -4e-4, 5e-4)
)
"""The paper's lenses, 67 and 35 deg, at 6.45 um."""
BOW_M = np.array([3e-4, -2e-4, 1e-4])
LENSES = pytest.mark.parametrize("lens", [CINEGON_4_8, CINEGON_10], ids=["4.8 mm", "10 mm"])


def nominal_of(lens: CameraModel) -> CameraModel:
    focal_px = 744.0 if lens is CINEGON_4_8 else 1550.0
    centred = replace(lens, cx_px=511.5, cy_px=511.5, distortion=())
    return replace(centred, fx_px=focal_px, fy_px=focal_px)


def see(
    bench: SimpleNamespace,
    lens: CameraModel,
    seed: int,
    *,
    n: int = 20,
    sigma_px: float = 0.05,
    bow_m: FloatArray | None = None,
) -> list[BoardView]:
    """Give views of a board, perhaps bowed, with a lens."""
    rng = np.random.default_rng(seed)
    flat = corner_points(bench.board)
    board = flat if bow_m is None else bowed(flat, bench.board, bow_m)
    views: list[BoardView] = []
    while len(views) < n:
        pose = bench.look_at_board(rng, zoom=lens.fx_px / CINEGON_4_8.fx_px)
        uv = lens.project(pose.apply(board)) + sigma_px * rng.normal(size=(len(flat), 2))
        ids = np.flatnonzero(((uv > 0) & (uv < 1023)).all(axis=1))
        if len(ids) >= 12:
            views.append(BoardView.of(ids, uv[ids], bench.board))
    return views


def moved(view: BoardView, by_px: FloatArray) -> BoardView:
    return BoardView(view.ids, view.p_board_m, view.uv_px + by_px)


def nees(solution: IntrinsicsSolution, truth: CameraModel, free: FloatArray) -> float:
    error = (intrinsics_of(solution.camera) - intrinsics_of(truth))[free]
    return float(error @ np.linalg.solve(solution.covariance[np.ix_(free, free)], error))


@LENSES
def test_exact_corners_give_the_exact_camera_and_bow(
    bench: SimpleNamespace, lens: CameraModel
) -> None:
    bow_m = np.array([6e-4, -3e-4, 2e-4])
    views = see(bench, lens, 1, n=12, sigma_px=0.0, bow_m=bow_m)
    solution = solve_intrinsics(views, nominal_of(lens), bench.board, model="brown")
    edges = [[0, 0], [1023, 0], [0, 1023], [1023, 1023], [511, 0], [700, 300]]
    np.testing.assert_allclose(solution.camera.rays(edges), lens.rays(edges), atol=1e-7)
    np.testing.assert_allclose(solution.bow_m, bow_m, atol=1e-8)
    assert solution.sigma_px < 1e-4


@LENSES
def test_errors_of_the_fit_agree_with_its_covariance(
    bench: SimpleNamespace, lens: CameraModel
) -> None:
    """Camera and bow together, 100 draws of the two lenses."""
    kind = CameraKind("brown", is_bow_free=True)
    truth = np.concatenate([intrinsics_of(lens), BOW_M])[kind.free]
    total, n_draws, nominal = 0.0, 50, nominal_of(lens)
    for seed in range(n_draws):
        views = see(bench, lens, seed, n=8, bow_m=BOW_M)
        corners = Corners.of(views, bench.board)
        start = CameraFit.at(nominal, start_poses(views, nominal))
        fit = fit_camera(corners, start, kind, sigma_px=0.05)
        covariance = covariance_of_common(corners, fit, kind, sigma_px=0.05)
        error = fit.common[kind.free] - truth
        total += error @ np.linalg.solve(covariance[np.ix_(kind.free, kind.free)], error)
    low, high = chi2.ppf([0.005, 0.995], len(truth) * n_draws)
    assert low < total < high


@LENSES
def test_errors_of_the_solution_agree_with_its_covariance(
    bench: SimpleNamespace, lens: CameraModel
) -> None:
    """Outliers sought, model chosen, sigma from the residuals."""
    of_camera, of_bow, n_free, n_draws = [], [], 0, 4
    for seed in range(n_draws):
        views = see(bench, lens, seed, n=12, bow_m=BOW_M)
        solution = solve_intrinsics(views, nominal_of(lens), bench.board)
        assert solution.is_bow_free
        assert solution.model in ("tangential", "brown")
        free = free_intrinsics(solution.model)
        n_free += len(free)
        assert not np.delete(solution.covariance, free, axis=0).any()
        assert 0.043 < solution.sigma_px < 0.057
        of_camera.append(nees(solution, lens, free))
        error = solution.bow_m - BOW_M
        of_bow.append(error @ np.linalg.solve(solution.bow_covariance_m2, error))
    for sums, n in ((of_camera, n_free), (of_bow, 3 * n_draws)):
        low, high = chi2.ppf([0.005, 0.995], n)
        assert low < sum(sums) < high


@LENSES
def test_a_lens_without_distortion_is_a_pinhole(bench: SimpleNamespace, lens: CameraModel) -> None:
    ideal = replace(lens, distortion=())
    for seed in range(2):
        solution = solve_intrinsics(see(bench, ideal, seed), nominal_of(lens), bench.board)
        assert solution.model == "pinhole"
        assert solution.camera.distortion == (0.0,) * 8


def test_a_small_tangential_distortion_is_not_overlooked(bench: SimpleNamespace) -> None:
    """A shifted principal point hides it from the held-out error, and is then off by many sigma."""
    lens = replace(CINEGON_4_8, distortion=(-0.1, 0.09, 1.2e-4, -1e-4))
    for seed in range(3):
        solution = solve_intrinsics(see(bench, lens, seed), nominal_of(lens), bench.board)
        assert solution.model == "tangential"
        assert nees(solution, lens, free_intrinsics("tangential")) < chi2.ppf(0.999, 8)


def test_a_lens_that_needs_it_gets_the_rational_model(bench: SimpleNamespace) -> None:
    strong = replace(CINEGON_4_8, distortion=(0.5, 0.0, 4e-4, -3e-4, 0.0, 1.5))
    solution = solve_intrinsics(see(bench, strong, 1), nominal_of(CINEGON_4_8), bench.board)
    assert solution.model == "rational"
    assert solution.sigma_px == pytest.approx(0.05, rel=0.1)


def test_the_table_of_models_says_how_each_did(bench: SimpleNamespace) -> None:
    solution = solve_intrinsics(see(bench, CINEGON_4_8, 4), nominal_of(CINEGON_4_8), bench.board)
    table = solution.result.statistics["models"]
    assert [row["model"] for row in table[:-1]] == list(DISTORTION_MODELS)
    assert table[-1]["model"] == solution.model
    assert not table[-1]["is_bow_free"]
    for row in table:
        assert row["rms_px"] < row["held_out_rms_px"]
    assert min(row["standard_errors_above_best"] for row in table) == 0.0
    assert table[0]["standard_errors_above_best"] > 3
    assert table[1]["p_values"]["tangential"] < 0.05 < table[3]["p_values"]["rational"]


def test_a_model_that_folds_the_image_is_not_taken(bench: SimpleNamespace) -> None:
    """Corners in the middle alone, as of a board never shown in the image's corners."""
    middle = []
    for view in see(bench, CINEGON_10, 3, n=12, sigma_px=1.0):
        ids = view.ids[np.linalg.norm(view.uv_px - 512, axis=1) < 480]
        if len(ids) >= 12:
            uv = dict(zip(view.ids.tolist(), view.uv_px, strict=True))
            middle.append(BoardView.of(ids, [uv[i] for i in ids.tolist()], bench.board))
    solution = solve_intrinsics(middle, nominal_of(CINEGON_10), bench.board)
    left_out = solution.statistics["models_left_out"]
    assert "folds the image where no corners were seen" in left_out["rational"]
    assert np.isfinite(solution.camera.rays([[0, 0], [1023, 0], [1023, 1023]])).all()


def test_one_wrong_corner_is_left_out_and_its_view_kept(bench: SimpleNamespace) -> None:
    views = see(bench, CINEGON_4_8, 5)
    clean = solve_intrinsics(views, nominal_of(CINEGON_4_8), bench.board, model="brown")
    by_px = np.zeros((len(views[3]), 2))
    by_px[7] = 25.0, -40.0
    views[3] = moved(views[3], by_px)
    solution = solve_intrinsics(views, nominal_of(CINEGON_4_8), bench.board, model="brown")
    assert solution.outlier_corners == ((3, views[3].ids[7]),)
    assert solution.outlier_views == ()
    assert_within_sigmas(solution, clean, 0.2)


def test_a_view_far_worse_than_the_others_is_left_out(bench: SimpleNamespace) -> None:
    views = see(bench, CINEGON_4_8, 6)
    clean = solve_intrinsics(views, nominal_of(CINEGON_4_8), bench.board, model="brown")
    rng = np.random.default_rng(1)
    views[12] = moved(views[12], rng.normal(scale=0.3, size=(len(views[12]), 2)))
    solution = solve_intrinsics(views, nominal_of(CINEGON_4_8), bench.board, model="brown")
    assert solution.outlier_views == (12,)
    assert solution.outlier_corners == ()
    assert len(solution.cam_from_board) == len(solution.view_rms_px) == 20
    assert solution.view_rms_px[12] == pytest.approx(0.3 * np.sqrt(2), rel=0.3)
    assert solution.result.statistics["n_views"] == 19
    assert_within_sigmas(solution, clean, 1.0)


def assert_within_sigmas(
    solution: IntrinsicsSolution, other: IntrinsicsSolution, limit: float
) -> None:
    free = free_intrinsics("brown")
    difference = intrinsics_of(solution.camera) - intrinsics_of(other.camera)
    assert (np.abs(difference) < limit * np.sqrt(np.diag(other.covariance)))[free].all()


def test_a_nominal_focal_length_far_off_does_no_harm(bench: SimpleNamespace) -> None:
    views = see(bench, CINEGON_4_8, 7)
    rough = replace(nominal_of(CINEGON_4_8), fx_px=1200.0, fy_px=1200.0)
    far, near = (
        solve_intrinsics(views, nominal, bench.board)
        for nominal in (rough, nominal_of(CINEGON_4_8))
    )
    assert far.camera.fx_px == pytest.approx(near.camera.fx_px, abs=0.01)


def test_too_few_views_are_refused(bench: SimpleNamespace) -> None:
    with pytest.raises(DegenerateGeometryError, match="3 views of the board, at least 6"):
        solve_intrinsics(see(bench, CINEGON_4_8, 1, n=3), CINEGON_4_8, bench.board)


def test_a_view_of_few_corners_is_refused(bench: SimpleNamespace) -> None:
    views = see(bench, CINEGON_4_8, 1, n=8)
    views[5] = BoardView(views[5].ids[:5], views[5].p_board_m[:5], views[5].uv_px[:5])
    with pytest.raises(DegenerateGeometryError, match="view 5 has 5 corners, at least 12"):
        solve_intrinsics(views, CINEGON_4_8, bench.board)


def test_missing_coverage_is_shown(bench: SimpleNamespace) -> None:
    left_half = []
    for view in see(bench, CINEGON_4_8, 1, n=12):
        is_left = view.uv_px[:, 0] < 500
        if is_left.sum() >= 12:
            left_half.append(
                BoardView(view.ids[is_left], view.p_board_m[is_left], view.uv_px[is_left])
            )
    with pytest.raises(DegenerateGeometryError, match=r"there is a dot:\n  xxx\.\.") as caught:
        check_coverage(left_half, CINEGON_4_8)
    assert "60% of the image" in str(caught.value)


def test_square_on_views_at_one_distance_are_refused(
    scene: Callable, bench: SimpleNamespace
) -> None:
    turns = [Rotation.from_euler("z", angle) for angle in np.linspace(-1.5, 1.5, 12)]
    square_on = scene(3, n=12, turns=turns, noise=0.0).views
    with pytest.raises(DegenerateGeometryError, match="0 views see the board tilted by 10 deg"):
        solve_intrinsics(square_on, bench.camera, bench.board)
    centre = np.array([4, 3, 0]) * bench.board.square_m
    one_distance = []
    for x, y in np.stack(np.meshgrid([-0.2, 0, 0.2], [-0.2, 0, 0.2]), -1).reshape(-1, 2):
        uv = CINEGON_4_8.project(corner_points(bench.board) - centre + [x, y, 0.6])
        ids = np.flatnonzero(((uv > 0) & (uv < 1023)).all(axis=1))
        one_distance.append(BoardView.of(ids, uv[ids], bench.board))
    with pytest.raises(DegenerateGeometryError, match=r"all at one distance of 0\.6. m"):
        solve_intrinsics(one_distance, replace(CINEGON_4_8, distortion=()), bench.board)


def test_views_that_leave_the_focal_length_open_are_refused(
    scene: Callable, bench: SimpleNamespace
) -> None:
    """Enough tilts to pass for tilted, all the same, and much noise."""
    turns = [Rotation.from_euler("xz", [0.18, angle]) for angle in np.linspace(-0.1, 0.1, 12)]
    views = scene(3, n=12, turns=turns, sigma_px=1.0).views
    with pytest.raises(DegenerateGeometryError, match="leave the focal length open"):
        solve_intrinsics(views, bench.nominal, bench.board)


@pytest.mark.parametrize("which", ["image", "print"])
def test_a_mirrored_board_is_refused(bench: SimpleNamespace, which: str) -> None:
    views = see(bench, CINEGON_4_8, 1, n=8)
    if which == "image":
        views = [BoardView(v.ids, v.p_board_m, [1023, 0] + v.uv_px * [-1, 1]) for v in views]
    else:
        views = [BoardView(v.ids, v.p_board_m * [-1, 1, 1], v.uv_px) for v in views]
    with pytest.raises(DegenerateGeometryError, match="view 0 shows the board mirrored"):
        solve_intrinsics(views, CINEGON_4_8, bench.board)


def test_a_square_in_millimetres_is_refused(bench: SimpleNamespace) -> None:
    pattern = bench.board.pattern.model_copy(update={"square_m": 80.0, "marker_m": 60.0})
    views = [BoardView.of(v.ids, v.uv_px, pattern) for v in see(bench, CINEGON_4_8, 1, n=8)]
    with pytest.raises(CalibrationError, match=r"would be \d+ m from the camera.* in metres"):
        solve_intrinsics(views, CINEGON_4_8, pattern)


def test_an_absurd_focal_length_is_refused(bench: SimpleNamespace) -> None:
    nominal = replace(CINEGON_4_8, fx_px=4.8e3, fy_px=4.8e3)
    with pytest.raises(CalibrationError, match="comes out as 764 px, nominal are 4800 px"):
        solve_intrinsics(see(bench, CINEGON_4_8, 1), nominal, bench.board)


def test_corners_of_another_board_or_image_are_refused(bench: SimpleNamespace) -> None:
    views = see(bench, CINEGON_4_8, 1, n=8)
    small = bench.board.pattern.model_copy(update={"rows": 5})
    with pytest.raises(CalibrationError, match=r"has corner \d+; a board of 8 x 5 .* has 0 to 27"):
        solve_intrinsics(views, CINEGON_4_8, small)
    with pytest.raises(CalibrationError, match="outside an image of 640 x 1024"):
        solve_intrinsics(views, replace(CINEGON_4_8, width_px=640), bench.board)
    twice = BoardView.of([*views[2].ids, 0, 0], [*views[2].uv_px, [5, 5], [5, 5]], bench.board)
    with pytest.raises(CalibrationError, match="view 2 has a corner twice"):
        solve_intrinsics([*views[:2], twice, *views[3:]], CINEGON_4_8, bench.board)


OPENCV_BOARD = PatternSpec(kind="chessboard", columns=10, rows=7, square_m=0.025)
OPENCV_NOMINAL = CameraModel(640, 480, 550.0, 550.0, 319.5, 239.5)


@pytest.fixture(scope="module")
def opencv_images() -> list[FloatArray]:
    if not OPENCV_IMAGES.exists():
        pytest.skip(f"needs {OPENCV_IMAGES}")
    paths = sorted(OPENCV_IMAGES.glob("left*.jpg"))
    return [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths]


@pytest.fixture(scope="module")
def opencv_views(opencv_images: list[FloatArray]) -> list[BoardView]:
    """Corners as in OpenCV's sample, refined in windows of 23 px.

    The squares of ``left02.jpg``, the second image, are 22 px wide: the windows reach to the next
    corners, and a whole column is off.
    """
    views = []
    for image in opencv_images:
        _, corners = cv2.findChessboardCorners(image, (9, 6))
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
        corners = cv2.cornerSubPix(image, corners, (11, 11), (-1, -1), stop)
        views.append(BoardView.of(range(54), corners, OPENCV_BOARD))
    return views


def test_with_every_corner_opencvs_camera_is_the_published_one(
    opencv_views: list[BoardView],
) -> None:
    corners = Corners.of(opencv_views, OPENCV_BOARD)
    start = CameraFit.at(OPENCV_NOMINAL, start_poses(opencv_views, OPENCV_NOMINAL))
    fit = fit_camera(corners, start, CameraKind("brown", False), sigma_px=1.0)
    np.testing.assert_allclose(intrinsics_of(fit.camera)[:4], [535.9, 535.9, 342.3, 235.6], atol=1)


def test_opencvs_bad_view_is_left_out(opencv_views: list[BoardView]) -> None:
    solution = solve_intrinsics(opencv_views, OPENCV_NOMINAL, OPENCV_BOARD)
    assert solution.outlier_views == (1,)
    assert solution.view_rms_px.argmax() == 1


def test_without_it_opencvs_camera_is_that_of_well_found_corners(
    opencv_views: list[BoardView], opencv_images: list[FloatArray]
) -> None:
    """The published focal length is 3 px too long, by the bad corners alone."""
    solution = solve_intrinsics(opencv_views, OPENCV_NOMINAL, OPENCV_BOARD)
    well_found = [detect_board(image, OPENCV_BOARD) for image in opencv_images]
    better = solve_intrinsics(well_found, OPENCV_NOMINAL, OPENCV_BOARD)
    assert better.outlier_views == ()
    assert better.sigma_px < 0.14
    sigma_px = np.sqrt(better.covariance[0, 0])
    assert abs(solution.camera.fx_px - better.camera.fx_px) < 2 * sigma_px
