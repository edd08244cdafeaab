"""The laboratory as designed: where things are meant to be, as the rig file states it.

Nominal values drive the robot and start the calibration; they are never ground truth.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.devices.readings import RobotTarget
from tronlab.geometry.camera import CameraModel
from tronlab.yaml_models import Model

Vector = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(gt=0)]


class PoseSpec(Model):
    """A pose as people write it down."""

    xyz_m: Vector
    """Origin of the child frame in the parent frame."""
    zyx_deg: Vector = (0.0, 0.0, 0.0)
    """Rotation Rz(A) Ry(B) Rx(C) as angles A, B, C: KUKA's convention."""

    @property
    def pose(self) -> RigidTransform:
        """Get ``parent_from_child``."""
        rotation = Rotation.from_euler("ZYX", self.zyx_deg, degrees=True)
        return RigidTransform.from_components(np.array(self.xyz_m), rotation)


class ReflectorsSpec(Model):
    """Where the three reflectors that define F_TRS are meant to be, in trs."""

    bottom_left_m: Vector
    """On the X-axis, by definition of the frame."""
    top_right_m: Vector
    """In the X-Y plane, by definition of the frame."""
    length_tolerance_m: Positive = 0.001
    """How much a measured distance between two reflectors may differ from the nominal one."""

    @property
    def points_m(self) -> dict[str, Vector]:
        """Get the nominal place of each reflector by name."""
        return {
            "top_left": (0.0, 0.0, 0.0),
            "bottom_left": self.bottom_left_m,
            "top_right": self.top_right_m,
        }


class MountingSpec(Model):
    """How rail, robot, camera and T-MAC are meant to be mounted."""

    trs_from_rail: PoseSpec
    """The rail runs along its own x-axis; the base stands at (rail_m, 0, 0), parallel to it."""
    flange_from_cam: PoseSpec
    flange_from_tmac: PoseSpec
    rail_range_m: tuple[float, float]
    """Lowest and highest rail position."""
    arm_forward_m: float
    """How far ahead of the base the flange is held, along x of base; the rail does the rest."""

    @model_validator(mode="after")
    def _range_is_ordered(self) -> "MountingSpec":
        if self.rail_range_m[0] >= self.rail_range_m[1]:
            raise ValueError("rail_range_m: the first value must be below the second")
        return self

    def robot_target(self, trs_from_cam: RigidTransform) -> RobotTarget:
        """Give where the robot must stand so that the camera nominally has this pose."""
        rail_from_flange = (
            self.trs_from_rail.pose.inv() * trs_from_cam * self.flange_from_cam.pose.inv()
        )
        rail_m = float(rail_from_flange.translation[0]) - self.arm_forward_m
        base_from_rail = RigidTransform.from_translation([-rail_m, 0.0, 0.0])
        return RobotTarget(rail_m=rail_m, base_from_flange=base_from_rail * rail_from_flange)


class CameraSpec(Model):
    """Camera and lens by their data sheets, and the region of the sensor that is read out."""

    model: str
    sensor_width_px: Count
    sensor_height_px: Count
    left_px: Annotated[int, Field(ge=0)]
    """First column read out."""
    top_px: Annotated[int, Field(ge=0)]
    """First row read out."""
    width_px: Count
    """Columns read out."""
    height_px: Count
    """Rows read out."""
    pixel_pitch_m: Positive
    focal_length_m: Positive

    @model_validator(mode="after")
    def _region_is_on_the_sensor(self) -> "CameraSpec":
        if self.left_px + self.width_px > self.sensor_width_px:
            raise ValueError(f"left_px + width_px exceeds sensor_width_px {self.sensor_width_px}")
        if self.top_px + self.height_px > self.sensor_height_px:
            raise ValueError(f"top_px + height_px exceeds sensor_height_px {self.sensor_height_px}")
        return self

    @property
    def nominal_model(self) -> CameraModel:
        """Get the camera model of the data sheets: centred, square pixels, no distortion."""
        focal_px = self.focal_length_m / self.pixel_pitch_m
        sensor = CameraModel(
            width_px=self.sensor_width_px,
            height_px=self.sensor_height_px,
            fx_px=focal_px,
            fy_px=focal_px,
            cx_px=(self.sensor_width_px - 1) / 2,
            cy_px=(self.sensor_height_px - 1) / 2,
        )
        return sensor.cropped(
            left_px=self.left_px,
            top_px=self.top_px,
            width_px=self.width_px,
            height_px=self.height_px,
        )


class BoardSpec(Model):
    """A ChArUco board, and where it is put for calibration."""

    columns: Annotated[int, Field(ge=3)]
    """Number of squares along x of board."""
    rows: Annotated[int, Field(ge=3)]
    """Number of squares along y of board."""
    square_m: Positive
    marker_m: Positive
    dictionary: Literal["DICT_4X4_250", "DICT_5X5_250", "DICT_5X5_1000"] = "DICT_5X5_250"
    trs_from_board: PoseSpec
    """Board frame as OpenCV has it: origin at the top-left corner of the board, x to the right,
    y down, z into the board."""

    @model_validator(mode="after")
    def _marker_fits_its_square(self) -> "BoardSpec":
        if self.marker_m >= self.square_m:
            raise ValueError("marker_m must be smaller than square_m")
        return self


class LampSpec(Model):
    """Where the lamp is meant to be."""

    p_trs_m: Vector


class LaboratorySpec(Model):
    """Everything of a rig that is not a device address."""

    reflectors: ReflectorsSpec
    mounting: MountingSpec
    camera: CameraSpec
    board: BoardSpec
    lamp: LampSpec
