"""The laboratory as designed: where things are meant to be, as the rig file states it.

Nominal values drive the robot and start the calibration; they are never ground truth.
"""

from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.devices.mounting import Mounting
from tronlab.geometry.camera import CameraModel
from tronlab.yaml_models import Model

Vector = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
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
    """The marks on the model that define F_TRS, and the reflectors that are put on them."""

    bottom_left_m: Vector
    """Mark on the X-axis, by definition of the frame."""
    top_right_m: Vector
    """Mark in the X-Y plane, by definition of the frame."""
    more_m: Annotated[dict[str, Vector], Field(default_factory=dict)]
    """Further marks by name, in trs; with them the frame is a least-squares fit to all marks, and
    their places must be known as well as the tracker measures."""
    length_tolerance_m: Positive = 0.001
    """How much a measured distance between two reflectors may differ from the nominal one."""
    sphere_radius_m: NotNegative = 0.0
    """Radius of the reflectors' spheres: 0.01905 for 1.5 inch. The tracker reports the centre."""
    nest_offset_m: float = 0.0
    """Height of the sphere's lowest point above its mark, along Z of trs. With radius and offset 0
    the centres themselves define the frame, as in the paper."""
    nest_offsets_m: Annotated[dict[str, float], Field(default_factory=dict)]
    """The same by name, for reflectors whose nest is another one."""

    @property
    def points_m(self) -> dict[str, Vector]:
        """Get the nominal place of each mark by name."""
        return {
            "top_left": (0.0, 0.0, 0.0),
            "bottom_left": self.bottom_left_m,
            "top_right": self.top_right_m,
            **self.more_m,
        }

    @property
    def centre_heights_m(self) -> dict[str, float]:
        """Get the height of each reflector's centre above its mark, along Z of trs."""
        return {
            name: self.sphere_radius_m + self.nest_offsets_m.get(name, self.nest_offset_m)
            for name in self.points_m
        }

    @model_validator(mode="after")
    def _names_are_known(self) -> "ReflectorsSpec":
        own = {"top_left", "bottom_left", "top_right", "lamp"}
        if taken := sorted(own.intersection(self.more_m)):
            raise ValueError(f"more_m: {', '.join(taken)}: these names have a meaning already")
        if unknown := sorted(set(self.nest_offsets_m) - set(self.points_m)):
            raise ValueError(f"nest_offsets_m: no reflector {', '.join(unknown)}")
        return self


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

    @property
    def nominal(self) -> Mounting:
        """Get the mounting as it is meant to be."""
        return Mounting(
            trs_from_rail=self.trs_from_rail.pose,
            rail_axis=np.array([1.0, 0.0, 0.0]),
            flange_from_cam=self.flange_from_cam.pose,
            arm_forward_m=self.arm_forward_m,
        )


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


PatternKind: TypeAlias = Literal["charuco", "charuco_legacy", "chessboard"]


class PatternSpec(Model):
    """What is printed on a calibration board."""

    kind: PatternKind = "charuco"
    """``charuco_legacy`` is the layout OpenCV had before 4.6; it differs for even ``rows``."""
    columns: Annotated[int, Field(ge=3)]
    """Number of squares along x of board."""
    rows: Annotated[int, Field(ge=3)]
    """Number of squares along y of board."""
    square_m: Positive
    marker_m: Positive | None = None
    """Side of the markers of a ChArUco board; a chessboard has none."""
    dictionary: Literal["DICT_4X4_250", "DICT_5X5_250", "DICT_5X5_1000"] = "DICT_5X5_250"

    @model_validator(mode="after")
    def _marker_fits_its_square(self) -> "PatternSpec":
        if self.kind == "chessboard" and self.marker_m is not None:
            raise ValueError("marker_m: a chessboard has no markers")
        if self.kind != "chessboard" and self.marker_m is None:
            raise ValueError("marker_m: missing, a ChArUco board has markers")
        if self.marker_m is not None and self.marker_m >= self.square_m:
            raise ValueError("marker_m must be smaller than square_m")
        return self


class BoardSpec(PatternSpec):
    """A calibration board, and where it is put."""

    trs_from_board: PoseSpec
    """Board frame as OpenCV has it: origin at the top-left corner of the board, x to the right,
    y down, z into the board."""

    @property
    def pattern(self) -> PatternSpec:
        """Get what is printed on it."""
        return PatternSpec.model_validate(self.model_dump(exclude={"trs_from_board"}))


class ConeSpec(Model):
    """The cone that a spotlight lights: full inside the inner angle, dark outside the outer one."""

    axis_trs: Vector
    """Where the beam goes; of any length."""
    inner_half_angle_deg: Annotated[float, Field(ge=0, lt=90)]
    outer_half_angle_deg: Annotated[float, Field(gt=0, le=90)]

    @model_validator(mode="after")
    def _cone_is_one(self) -> "ConeSpec":
        if not any(self.axis_trs):
            raise ValueError("axis_trs: is zero, must have a direction")
        if self.inner_half_angle_deg > self.outer_half_angle_deg:
            raise ValueError("inner_half_angle_deg must not exceed outer_half_angle_deg")
        return self


class LampSpec(Model):
    """Where the lamp is meant to be, and what it is like."""

    p_trs_m: Vector
    light_from_reflector_m: Vector = (0.0, 0.0, 0.0)
    """From the reflector on the lamp's housing to the centre of the light, in trs."""
    light_sigma_m: NotNegative = 0.0
    """How well that is known: one sigma of each coordinate."""
    radius_m: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """Of the luminous sphere, which gives shadows their soft edges; 0: a point."""
    cone: ConeSpec | None = None
    """Of a spotlight; null: light in all directions."""


class LaboratorySpec(Model):
    """Everything of a rig that is not a device address."""

    reflectors: ReflectorsSpec
    mounting: MountingSpec
    camera: CameraSpec
    board: BoardSpec
    lamp: LampSpec
