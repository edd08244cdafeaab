import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.camera.board import corner_points
from tronlab.calib.camera.bow import bowed
from tronlab.devices.laboratory import BoardSpec, PatternSpec, PoseSpec
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.render.board import render_board
from tronlab.render.renderer import Lamp
from tronlab.twin.board import board_from_print, bow_of_print, light_on_board, print_board

BOARD = BoardSpec(
    columns=5,
    rows=4,
    square_m=0.05,
    marker_m=0.035,
    trs_from_board=PoseSpec(xyz_m=(0.0, 0.0, 0.0)),
)
FACING = RigidTransform.from_rotation(Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]]))
"""``trs_from_board`` of a board at the origin of trs, seen from +Z_TRS."""


@pytest.mark.opencv
def test_print_has_the_board_s_origin_one_square_in():
    texture, texel_m = print_board(BOARD)
    n = round(BOARD.square_m / texel_m)
    assert texture.shape == (6 * n, 7 * n)
    assert texture.dtype == np.uint8
    assert set(np.unique(texture)) == {0, 255}
    origin = board_from_print(BOARD).inv().apply([0.0, 0.0, 0.0]) / texel_m
    column, row, _ = np.rint(origin).astype(int)
    assert texture[row, column] == 0
    assert (texture[:row] == 255).all()
    assert (texture[:, :column] == 255).all()
    assert (texture[-row:] == 255).all()
    assert (texture[row : row + n, column : column + n] == 0).all()
    second_corner = texture[row + n - 1 : row + n + 1, column + n - 1 : column + n + 1]
    np.testing.assert_array_equal(second_corner, [[0, 255], [255, 0]])


@pytest.mark.opencv
def test_a_chessboard_and_the_old_layout_are_printed_as_opencv_knows_them():
    """Of the old layout with an even number of rows the square at the origin is white."""
    import cv2

    chessboard, texel_m = print_board(PatternSpec(kind="chessboard", columns=7, rows=5, square_m=1))
    n = round(1 / texel_m)
    assert chessboard.shape == (7 * n, 9 * n)
    assert [chessboard[row * n, n] for row in range(7)] == [255, 0, 255, 0, 255, 0, 255]
    found, corners = cv2.findChessboardCornersSB(chessboard, (6, 4))
    assert found
    seen = np.rint(corners.reshape(-1, 2) / n).astype(int)
    assert sorted(map(tuple, seen)) == [(x, y) for x in range(2, 8) for y in range(2, 6)]
    legacy, _ = print_board(
        PatternSpec(kind="charuco_legacy", columns=5, rows=4, square_m=0.05, marker_m=0.035)
    )
    assert legacy[n, n] == 255
    assert legacy[n, 2 * n] == 0


@pytest.mark.opencv
def test_corners_of_a_bowed_board_are_seen_where_the_calibration_expects_them():
    """Formula of the twin and formula of the calibration are one: corners within 0.05 px."""
    import cv2

    camera = CameraModel(640, 512, 480.0, 480.0, 320.0, 256.0)
    trs_from_cam = RigidTransform.from_components(
        [0.12, 0.05, 0.55], Rotation.from_rotvec([np.pi, 0.0, 0.0])
    ) * RigidTransform.from_rotation(Rotation.from_rotvec([0.2, -0.3, 0.1]))
    trs_from_board = RigidTransform.from_components(
        [0.0, 0.1, 0.0], Rotation.from_rotvec([np.pi, 0.0, 0.0])
    )
    bow_m = np.array([0.004, -0.003, 0.006])
    texture, texel_m = print_board(BOARD)
    albedo, _ = render_board(
        texture,
        texel_m,
        camera,
        trs_from_board * board_from_print(BOARD),
        trs_from_cam,
        4,
        bow=bow_of_print(BOARD, bow_m),
    )
    corners = corner_points(BOARD)
    cam_from_board = trs_from_cam.inv() * trs_from_board
    expected = camera.project(cam_from_board.apply(bowed(corners, BOARD, bow_m)))
    flat = camera.project(cam_from_board.apply(corners))
    assert np.linalg.norm(expected - flat, axis=1).max() > 1.0
    image = np.round(cv2.GaussianBlur(albedo, None, 1.2) * 250).astype(np.uint8)
    found = cv2.cornerSubPix(
        image,
        np.ascontiguousarray(flat, dtype=np.float32).reshape(-1, 1, 2),
        (6, 6),
        (-1, -1),
        (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4),
    )[:, 0]
    assert np.linalg.norm(found - expected, axis=1).max() < 0.05


def test_light_falls_with_the_square_of_distance_and_the_cosine():
    camera = CameraModel(3, 3, 10.0, 10.0, 1.0, 1.0)
    trs_from_cam = pose_along_boresight([0, 0, 1.0], boresight=[0, 0, -1], right=[0, 1, 0])
    ray = camera.rays([[1.0, 1.0]])
    lamps = {
        "ahead at 1 m": [0.0, 0.0, 1.0],
        "ahead at 2 m": [0.0, 0.0, 2.0],
        "60 deg at 2 m": [0.0, np.sqrt(3.0), 1.0],
        "behind": [0.0, 0.0, -1.0],
    }
    light = [
        light_on_board(ray, FACING, trs_from_cam, Lamp(np.array(p), 3.0))[0] for p in lamps.values()
    ]
    np.testing.assert_allclose(light, [3.0, 0.75, 0.375, 0.0], atol=1e-12)


def test_light_is_that_of_the_point_each_ray_meets():
    camera = CameraModel(9, 7, 8.0, 8.0, 4.0, 3.0, distortion=(-0.1, 0.0, 0.0, 0.0, 0.0))
    trs_from_cam = pose_along_boresight([0.1, -0.1, 0.8], boresight=[0.1, 0.2, -1], right=[0, 1, 0])
    trs_from_board = RigidTransform.from_rotation(Rotation.from_rotvec([0.1, 0.2, 0.0])) * FACING
    lamp = Lamp(np.array([-1.0, 0.5, 2.0]), 1.0)
    light = light_on_board(camera.ray_table(), trs_from_board, trs_from_cam, lamp)

    # Backwards: points on the board, projected, must land where their light was given.
    p_board = np.array([[0.0, 0.0, 0.0], [0.05, -0.1, 0.0], [-0.1, 0.08, 0.0]])
    p_trs = trs_from_board.apply(p_board)
    uv = camera.project(trs_from_cam.inv().apply(p_trs))
    to_lamp = lamp.p_trs_m - p_trs
    normal = -trs_from_board.rotation.as_matrix()[:, 2]
    expected = (to_lamp @ normal) / np.linalg.norm(to_lamp, axis=1) ** 3
    found = light_on_board(camera.rays(uv), trs_from_board, trs_from_cam, lamp)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert light.shape == camera.shape
