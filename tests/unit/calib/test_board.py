from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.camera.board import BoardView, charuco_board, corner_points, detect_board
from tronlab.devices.laboratory import PatternKind, PatternSpec
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.camera import CameraModel

pytestmark = pytest.mark.opencv
MOVEIT_IMAGE = (
    Path(__file__).parents[4] / "shared/data/moveit_handeye/test_charuco_board_detection.jpg"
)

CAMERA = CameraModel(
    width_px=640, height_px=560, fx_px=560.0, fy_px=560.0, cx_px=320.0, cy_px=279.5
)
N = 160
"""Texels of the print along a square."""


def print_of(spec: PatternSpec) -> np.ndarray:
    if spec.kind != "chessboard":
        return charuco_board(spec).generateImage((spec.columns * N, spec.rows * N))
    row, column = np.indices((spec.rows, spec.columns))
    return np.kron((row + column) % 2 * np.uint8(255), np.ones((N, N), np.uint8))


def picture(
    spec: PatternSpec, camera: CameraModel, cam_from_board: RigidTransform, *, fine: int = 2
) -> np.ndarray:
    """Look up the print along the ray of every point of a fine grid, then average to pixels."""
    size = (spec.columns * N, spec.rows * N)
    print_ = print_of(spec)
    steps = (np.arange(fine) + 0.5) / fine - 0.5
    rotation = cam_from_board.rotation.as_matrix()
    normal = rotation[:, 2]
    total = np.zeros(camera.shape)
    for du in steps:
        for dv in steps:
            rays = camera.ray_table(du_px=du, dv_px=dv)
            directions = np.concatenate([rays, np.ones((*camera.shape, 1))], axis=-1)
            depth = (cam_from_board.translation @ normal) / (directions @ normal)
            p_board = (depth[..., None] * directions - cam_from_board.translation) @ rotation
            column, row = np.floor(p_board[..., :2] / spec.square_m * N).astype(int).T
            inside = (column >= 0) & (column < size[0]) & (row >= 0) & (row < size[1])
            column, row = np.clip(column, 0, size[0] - 1), np.clip(row, 0, size[1] - 1)
            total += np.where(inside, 30 + 0.75 * print_[row, column], 200).T
    return cv2.GaussianBlur(total / fine**2, (0, 0), 0.6).round().astype(np.uint8)


def looking_at(spec: PatternSpec, *, roll_deg: float, distance_m: float = 0.8) -> RigidTransform:
    """Give cam_from_board of a board in the middle of the image, tilted and rolled."""
    turn = Rotation.from_euler("zyx", [roll_deg, 15.0, -20.0], degrees=True)
    centre = np.array([spec.columns, spec.rows, 0.0]) * spec.square_m / 2
    return RigidTransform.from_components([0.0, 0.0, distance_m] - turn.apply(centre), turn)


@pytest.fixture(scope="module")
def seen(bench: SimpleNamespace) -> tuple[np.ndarray, np.ndarray]:
    """An image of the board, and where its corners are in it."""
    pose = looking_at(bench.board, roll_deg=20.0)
    truth = CAMERA.project(pose.apply(corner_points(bench.board)))
    return picture(bench.board, CAMERA, pose, fine=4), truth


def test_corners_are_where_opencv_has_them(bench: SimpleNamespace) -> None:
    theirs = np.array(charuco_board(bench.board).getChessboardCorners())
    np.testing.assert_allclose(corner_points(bench.board), theirs, atol=1e-6)


def test_all_corners_are_found_to_a_small_part_of_a_pixel(
    seen: tuple[np.ndarray, np.ndarray], bench: SimpleNamespace
) -> None:
    image, truth = seen
    view = detect_board(image, bench.board)
    assert len(view) == len(truth) == 35
    errors = view.uv_px - truth[view.ids]
    assert np.sqrt((errors**2).mean()) < 0.08
    assert np.abs(errors.mean(axis=0)).max() < 0.02
    np.testing.assert_array_equal(view.p_board_m, corner_points(bench.board)[view.ids])


def test_twelve_bits_are_read_too(
    seen: tuple[np.ndarray, np.ndarray], bench: SimpleNamespace
) -> None:
    image, _ = seen
    deep = np.round(image * (4095 / 255)).astype(np.uint16)
    np.testing.assert_array_equal(
        detect_board(deep, bench.board).uv_px, detect_board(image, bench.board).uv_px
    )


def test_an_image_without_board_has_no_corners(bench: SimpleNamespace) -> None:
    view = detect_board(np.full((200, 200), 128, np.uint8), bench.board)
    assert len(view) == 0
    assert view.uv_px.shape == (0, 2)
    assert view.p_board_m.shape == (0, 3)


def charuco(kind: PatternKind) -> PatternSpec:
    return PatternSpec(kind=kind, columns=8, rows=6, square_m=0.08, marker_m=0.06)


@pytest.mark.parametrize(
    ("printed", "told"), [("charuco", "charuco_legacy"), ("charuco_legacy", "charuco")]
)
def test_each_layout_is_found_and_told_from_the_other(
    printed: PatternKind, told: PatternKind
) -> None:
    spec = charuco(printed)
    pose = looking_at(spec, roll_deg=20.0)
    image = picture(spec, CAMERA, pose)
    view = detect_board(image, spec)
    truth = CAMERA.project(pose.apply(corner_points(spec)))
    assert len(view) == 35
    assert np.sqrt(((view.uv_px - truth[view.ids]) ** 2).mean()) < 0.08
    with pytest.raises(CalibrationError, match=f"they would be with kind: {printed}"):
        detect_board(image, charuco(told))


def test_columns_and_rows_in_the_wrong_order_are_named(
    seen: tuple[np.ndarray, np.ndarray], bench: SimpleNamespace
) -> None:
    swapped = bench.board.pattern.model_copy(update={"columns": 6, "rows": 8})
    with pytest.raises(CalibrationError, match="they would be with columns: 8, rows: 6"):
        detect_board(seen[0], swapped)


def test_a_mirrored_image_is_named(
    seen: tuple[np.ndarray, np.ndarray], bench: SimpleNamespace
) -> None:
    with pytest.raises(DegenerateGeometryError, match="the image shows it mirrored"):
        detect_board(np.ascontiguousarray(seen[0][:, ::-1]), bench.board)


def test_an_unknown_corner_is_refused(bench: SimpleNamespace) -> None:
    message = "corner 35 does not exist, a board of 8 x 6 squares has corners 0 to 34"
    with pytest.raises(CalibrationError, match=message):
        BoardView.of([3, 35], [[1.0, 2.0], [3.0, 4.0]], bench.board)


def chessboard(columns: int, rows: int) -> PatternSpec:
    return PatternSpec(kind="chessboard", columns=columns, rows=rows, square_m=0.08)


@pytest.mark.parametrize(
    ("columns", "rows", "roll_deg"),
    [(8, 5, 0.0), (8, 5, 170.0), (5, 6, -120.0), (8, 6, -80.0), (6, 6, 80.0), (5, 5, 40.0)],
)
def test_chessboard_corners_are_counted_from_the_black_corner(
    columns: int, rows: int, roll_deg: float
) -> None:
    """At any roll where the print says where its top left is, else below 90 or 45 deg."""
    spec = chessboard(columns, rows)
    pose = looking_at(spec, roll_deg=roll_deg)
    view = detect_board(picture(spec, CAMERA, pose), spec)
    truth = CAMERA.project(pose.apply(corner_points(spec)))
    np.testing.assert_array_equal(view.ids, np.arange((columns - 1) * (rows - 1)))
    errors = view.uv_px - truth
    assert np.abs(errors).max() < 0.3
    assert np.sqrt((errors**2).mean()) < 0.08


def test_small_squares_do_not_pull_each_others_corners() -> None:
    spec = chessboard(10, 7)
    pose = looking_at(spec, roll_deg=30.0, distance_m=2.2)
    view = detect_board(picture(spec, CAMERA, pose), spec)
    truth = CAMERA.project(pose.apply(corner_points(spec)))
    assert np.sqrt(((view.uv_px - truth) ** 2).mean()) < 0.06


def test_a_chessboard_not_wholly_in_the_image_is_not_found() -> None:
    spec = chessboard(8, 5)
    image = picture(spec, CAMERA, looking_at(spec, roll_deg=0.0))
    assert len(detect_board(image[:, :320], spec)) == 0


@pytest.mark.skipif(not MOVEIT_IMAGE.exists(), reason=f"needs {MOVEIT_IMAGE}")
def test_a_real_charuco_board_is_where_others_found_it() -> None:
    """MoveIt's test: its board frame stands at the bottom left, and its tolerance is 1 %."""
    spec = PatternSpec(
        kind="charuco_legacy", columns=5, rows=7, square_m=0.1971 / 7, marker_m=0.0176
    )
    view = detect_board(cv2.imread(str(MOVEIT_IMAGE), cv2.IMREAD_GRAYSCALE), spec)
    camera = CameraModel(
        width_px=640,
        height_px=480,
        fx_px=590.697,
        fy_px=592.847,
        cx_px=322.331,
        cy_px=247.400,
        distortion=(0.15405, -0.24917, 0.00351, -0.00110),
    )
    _, rvec, tvec = cv2.solvePnP(
        view.p_board_m, view.uv_px, camera.matrix, np.array(camera.distortion)
    )
    bottom_left = np.array([0.0, 7 * spec.square_m, 0.0])
    found = Rotation.from_rotvec(rvec.ravel()).apply(bottom_left) + tvec.ravel()
    np.testing.assert_allclose(found, [0.09752, 0.102848, 0.325596], rtol=0.01)
