import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import RigidTransform

from tronlab.devices.laboratory import BoardSpec, CameraSpec, MountingSpec, PoseSpec
from tronlab.geometry.poses import pose_along_boresight

MOUNTING = MountingSpec(
    trs_from_rail=PoseSpec(xyz_m=(2.3, 2.1, 6.0), zyx_deg=(0.0, 90.0, 0.0)),
    flange_from_cam=PoseSpec(xyz_m=(0.05, 0.0, 0.1)),
    flange_from_tmac=PoseSpec(xyz_m=(-0.1, 0.0, 0.1)),
    rail_range_m=(0.0, 4.0),
    arm_forward_m=1.0,
)

CAMERA = {
    "model": "GC1380H",
    "sensor_width_px": 1360,
    "sensor_height_px": 1024,
    "left_px": 168,
    "top_px": 0,
    "width_px": 1024,
    "height_px": 1024,
    "pixel_pitch_m": 6.45e-6,
    "focal_length_m": 0.0048,
}


def test_the_target_puts_the_camera_where_it_was_asked():
    trs_from_cam = pose_along_boresight([1.1, 2.2, 3.0], boresight=[0, 0, -1], right=[0, 1, 0])
    target = MOUNTING.nominal.robot_target(trs_from_cam)
    reached = (
        MOUNTING.trs_from_rail.pose
        * RigidTransform.from_translation([target.rail_m, 0, 0])
        * target.base_from_flange
        * MOUNTING.flange_from_cam.pose
    )
    np.testing.assert_allclose(reached.as_matrix(), trs_from_cam.as_matrix(), atol=1e-12)
    assert target.base_from_flange.translation[0] == pytest.approx(MOUNTING.arm_forward_m)


def test_angles_are_kukas_a_b_c():
    pose = PoseSpec(xyz_m=(0, 0, 0), zyx_deg=(90.0, 0.0, 0.0)).pose
    np.testing.assert_allclose(pose.apply([1, 0, 0]), [0, 1, 0], atol=1e-12)


def test_the_nominal_camera_is_the_data_sheet():
    model = CameraSpec(**CAMERA).nominal_model
    assert model.fx_px == pytest.approx(744.19, abs=0.01)
    assert (model.cx_px, model.cy_px) == (511.5, 511.5)
    assert model.shape == (1024, 1024)


@pytest.mark.parametrize(("key", "value"), [("left_px", 400), ("height_px", 2000)])
def test_a_region_beyond_the_sensor_is_refused(key, value):
    with pytest.raises(ValidationError, match="exceeds sensor"):
        CameraSpec(**{**CAMERA, key: value})


def test_a_rail_range_the_wrong_way_round_is_refused():
    with pytest.raises(ValidationError, match="first value must be below"):
        MountingSpec(**{**MOUNTING.model_dump(), "rail_range_m": (4.0, 0.0)})


def test_a_marker_larger_than_its_square_is_refused():
    with pytest.raises(ValidationError, match="smaller than square_m"):
        BoardSpec(
            columns=9,
            rows=6,
            square_m=0.03,
            marker_m=0.03,
            trs_from_board=PoseSpec(xyz_m=(0, 0, 0)),
        )
