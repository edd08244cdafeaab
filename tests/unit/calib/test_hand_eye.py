from collections.abc import Callable

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.hand_eye import solve_closed_form
from tronlab.errors import DegenerateGeometryError
from tronlab.geometry.uncertainty import pose_difference


def test_exact_poses_give_the_exact_answer(scene: Callable) -> None:
    for seed in range(5):
        truth = scene(seed, n=4, noise=0.0)
        start = solve_closed_form(truth.readings, truth.cam_from_board)
        for found, true in (
            (start.tmac_from_cam, truth.tmac_from_cam),
            (start.trk_from_board, truth.trk_from_board),
        ):
            np.testing.assert_allclose(pose_difference(found, true), 0.0, atol=1e-10)


@pytest.mark.opencv
@pytest.mark.skipif(not hasattr(cv2, "calibrateHandEye"), reason="this OpenCV has no hand-eye")
def test_the_rotation_is_opencvs_park(scene: Callable) -> None:
    truth = scene(1, n=6)
    start = solve_closed_form(truth.readings, truth.cam_from_board)
    rotation, translation = cv2.calibrateHandEye(
        [pose.rotation.as_matrix() for pose in truth.readings],
        [pose.translation for pose in truth.readings],
        [pose.rotation.as_matrix() for pose in truth.cam_from_board],
        [pose.translation for pose in truth.cam_from_board],
        method=cv2.CALIB_HAND_EYE_PARK,
    )
    difference = (Rotation.from_matrix(rotation).inv() * start.tmac_from_cam.rotation).magnitude()
    assert difference < 2e-4
    np.testing.assert_allclose(translation.ravel(), start.tmac_from_cam.translation, atol=1e-3)


def test_two_stations_are_refused(scene: Callable) -> None:
    truth = scene(1, n=2)
    with pytest.raises(DegenerateGeometryError, match="2 stations, at least 3"):
        solve_closed_form(truth.readings, truth.cam_from_board)


def test_turns_about_one_axis_are_refused(scene: Callable) -> None:
    turns = [Rotation.from_euler("z", angle) for angle in np.linspace(-1, 1, 8)]
    truth = scene(2, n=8, turns=turns)
    axis = np.round(np.abs(truth.tmac_from_cam.rotation.apply([0.0, 0.0, 1.0])), 2)
    with pytest.raises(DegenerateGeometryError, match="same axis") as caught:
        solve_closed_form(truth.readings, truth.cam_from_board)
    assert f"{axis[0]:.2f}" in str(caught.value)


def test_translation_only_is_refused(scene: Callable) -> None:
    truth = scene(3, n=8, turns=[Rotation.identity()] * 8)
    with pytest.raises(DegenerateGeometryError, match=r"turned by 0\.0\d deg"):
        solve_closed_form(truth.readings, truth.cam_from_board)


def test_half_turns_alone_are_refused() -> None:
    poses = [RigidTransform.from_rotation(Rotation.from_rotvec(np.pi * axis)) for axis in np.eye(3)]
    with pytest.raises(DegenerateGeometryError, match="half a turn"):
        solve_closed_form(poses, poses)
