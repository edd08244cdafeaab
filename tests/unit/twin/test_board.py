import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.devices.laboratory import BoardSpec, PoseSpec
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.render.renderer import Lamp
from tronlab.twin.board import board_from_print, light_on_board, print_board

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
