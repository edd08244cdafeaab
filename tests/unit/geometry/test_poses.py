import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import FrameError
from tronlab.geometry.poses import (
    CAM_FROM_BLENDER_CAM,
    pose_along_boresight,
    pose_from_matrix,
    pose_from_rotation,
    pose_from_xyz_quat,
    rotation_angle_rad,
    unit,
    xyz_quat_from_pose,
)

coordinates = st.floats(-100, 100, allow_nan=False)
angles = st.floats(-3.1, 3.1, allow_nan=False)


@st.composite
def poses(draw):
    t = [draw(coordinates) for _ in range(3)]
    rotation = Rotation.from_rotvec([draw(angles) for _ in range(3)])
    return RigidTransform.from_components(t, rotation)


@given(poses())
def test_a_pose_survives_both_forms_it_is_stored_in(pose):
    for again in (pose_from_xyz_quat(xyz_quat_from_pose(pose)), pose_from_matrix(pose.as_matrix())):
        np.testing.assert_allclose(again.as_matrix(), pose.as_matrix(), atol=1e-9)


@given(poses())
def test_stored_quaternions_have_one_sign(pose):
    assert xyz_quat_from_pose(pose)[6] >= 0


@given(poses(), angles)
def test_rotation_angle_is_the_angle_turned(pose, angle):
    turned = pose * RigidTransform.from_rotation(Rotation.from_rotvec([0, 0, angle]))
    assert rotation_angle_rad(pose, turned) == pytest.approx(abs(angle), abs=1e-9)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.eye(3), r"shape is \(3, 3\), expected \(4, 4\)"),
        (np.diag([2.0, 2.0, 2.0, 1.0]), "not orthonormal"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "left-handed"),
        (np.diag([1.0, 1.0, 1.0, 2.0]), "last row"),
        (np.full((4, 4), np.nan), "not finite"),
    ],
)
def test_a_matrix_that_is_no_pose_is_refused(matrix, message):
    with pytest.raises(FrameError, match=message):
        pose_from_matrix(matrix)


def test_a_quaternion_that_is_not_of_length_one_is_refused():
    with pytest.raises(FrameError, match="norm is 2, expected 1"):
        pose_from_xyz_quat([0, 0, 0, 0, 0, 0, 2])


def test_a_translation_of_the_wrong_shape_is_refused():
    with pytest.raises(FrameError, match=r"translation: shape is \(2,\)"):
        pose_from_rotation(np.eye(3), [0, 0])


def test_the_blender_camera_looks_backward_and_has_y_up():
    rotation = CAM_FROM_BLENDER_CAM.rotation.as_matrix()
    np.testing.assert_allclose(rotation, np.diag([1.0, -1.0, -1.0]), atol=1e-15)
    np.testing.assert_allclose(CAM_FROM_BLENDER_CAM.apply([0, 0, -1]), [0, 0, 1], atol=1e-15)


def test_a_camera_facing_the_model_has_right_along_y_and_down_along_x():
    trs_from_cam = pose_along_boresight([1, 2, 4], boresight=[0, 0, -2], right=[0, 3, 1])
    np.testing.assert_allclose(
        trs_from_cam.apply(np.eye(3)), [[1, 3, 4], [2, 2, 4], [1, 2, 3]], atol=1e-12
    )


def test_a_right_along_the_boresight_leaves_the_roll_open():
    with pytest.raises(FrameError, match="parallel to the boresight"):
        pose_along_boresight([0, 0, 0], boresight=[0, 0, 1], right=[0, 0, -5])


def test_the_direction_of_nothing_is_refused():
    with pytest.raises(FrameError, match="boresight: is zero"):
        unit([0, 0, 0], what="boresight")
