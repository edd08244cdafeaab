from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.board import charuco_board, corner_points, detect_board
from tronlab.devices.laboratory import BoardSpec
from tronlab.geometry.camera import CameraModel

CAMERA = CameraModel(
    width_px=640, height_px=560, fx_px=560.0, fy_px=560.0, cx_px=320.0, cy_px=279.5
)
N = 160
"""Texels of the print along a square."""


def picture(spec: BoardSpec, camera: CameraModel, cam_from_board: RigidTransform) -> np.ndarray:
    """Look up the print along the ray of every point of a fine grid, then average to pixels."""
    size = (spec.columns * N, spec.rows * N)
    print_ = charuco_board(spec).generateImage(size)
    fine, steps = 4, (np.arange(4) + 0.5) / 4 - 0.5
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


@pytest.fixture(scope="module")
def seen(bench: SimpleNamespace) -> tuple[np.ndarray, np.ndarray]:
    """An image of the board, and where its corners are in it."""
    turn = Rotation.from_euler("zyx", [20.0, 15.0, -20.0], degrees=True)
    centre = np.array([bench.board.columns, bench.board.rows, 0.0]) * bench.board.square_m / 2
    pose = RigidTransform.from_components(np.array([0.0, 0.0, 0.8]) - turn.apply(centre), turn)
    truth = CAMERA.project(pose.apply(corner_points(bench.board)))
    return picture(bench.board, CAMERA, pose), truth


@pytest.mark.opencv
def test_corners_are_where_opencv_has_them(bench: SimpleNamespace) -> None:
    theirs = np.array(charuco_board(bench.board).getChessboardCorners())
    np.testing.assert_allclose(corner_points(bench.board), theirs, atol=1e-6)


@pytest.mark.opencv
def test_all_corners_are_found_to_a_small_part_of_a_pixel(
    seen: tuple[np.ndarray, np.ndarray], bench: SimpleNamespace
) -> None:
    image, truth = seen
    view = detect_board(image, bench.board)
    assert len(view) == len(truth) == 35
    errors = view.uv_px - truth[view.ids]
    assert np.sqrt((errors**2).mean()) < 0.05
    assert np.abs(errors.mean(axis=0)).max() < 0.02
    np.testing.assert_array_equal(view.p_board_m, corner_points(bench.board)[view.ids])


@pytest.mark.opencv
def test_twelve_bits_are_read_too(
    seen: tuple[np.ndarray, np.ndarray], bench: SimpleNamespace
) -> None:
    image, _ = seen
    deep = np.round(image * (4095 / 255)).astype(np.uint16)
    np.testing.assert_array_equal(
        detect_board(deep, bench.board).uv_px, detect_board(image, bench.board).uv_px
    )


@pytest.mark.opencv
def test_an_image_without_board_has_no_corners(bench: SimpleNamespace) -> None:
    view = detect_board(np.full((200, 200), 128, np.uint8), bench.board)
    assert len(view) == 0
    assert view.uv_px.shape == (0, 2)
    assert view.p_board_m.shape == (0, 3)
