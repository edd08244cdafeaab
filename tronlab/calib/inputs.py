"""What a calibration follows from, as the record keeps it: raw readings, corners, nominal values.

Each part stands alone: it has everything its result follows from, so that one part can be measured
anew while the others keep theirs. Lamp and robot therefore have the reflectors with them, measured
in the same set-up of the tracker: after the tracker moved, their own frame still fits them.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.board import BoardView
from tronlab.devices.laboratory import LampSpec, MountingSpec, PatternSpec, ReflectorsSpec, Vector
from tronlab.devices.readings import PointReading, PoseReading, RobotReading
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_from_xyz_quat, xyz_quat_from_pose
from tronlab.yaml_models import Model

UV_DECIMALS = 4
"""Corners are rounded to this before anything is solved, so that the record has all there was."""

Seven: TypeAlias = Annotated[tuple[float, ...], Field(min_length=7, max_length=7)]
"""A pose: x y z qx qy qz qw, metres."""
Matrix: TypeAlias = tuple[tuple[float, ...], ...]
Pixel: TypeAlias = tuple[float, float]
Setup: TypeAlias = Literal["eye_in_hand", "eye_to_hand"]
"""``eye_to_hand``: the board is on the hand; then what is called T-MAC is the robot's base seen
from its hand, and the result is base_from_cam."""
PartName: TypeAlias = Literal["frame", "intrinsics", "hand_eye", "lamp", "robot", "photometry"]


class PointInput(Model):
    """A measured reflector."""

    p_trk_m: Vector
    covariance_m2: Matrix
    """Shape (3, 3)."""
    time_s: float
    readings_trk_m: tuple[Vector, ...] = ()
    """The single readings, if this is their mean."""

    @classmethod
    def of(cls, reading: PointReading, singles: Sequence[PointReading] = ()) -> "PointInput":
        """Keep a reading; ``singles`` are those it is the mean of."""
        return cls.model_validate(
            {
                "p_trk_m": reading.p_trk_m.tolist(),
                "covariance_m2": reading.covariance_m2.tolist(),
                "time_s": reading.time_s,
                "readings_trk_m": [single.p_trk_m.tolist() for single in singles],
            }
        )

    def reading(self, name: str) -> PointReading:
        """Give the reading of the reflector of that name."""
        return PointReading(
            target=name,
            p_trk_m=np.array(self.p_trk_m),
            covariance_m2=np.array(self.covariance_m2),
            time_s=self.time_s,
        )


Points: TypeAlias = dict[str, PointInput]


def points_of(readings: Mapping[str, PointReading]) -> Points:
    """Keep the readings of several reflectors, by name."""
    return {name: PointInput.of(reading) for name, reading in readings.items()}


def point_readings(points: Points) -> dict[str, PointReading]:
    """Give back what ``points_of`` kept."""
    return {name: point.reading(name) for name, point in points.items()}


class PoseInput(Model):
    """A measured pose of the T-MAC."""

    trk_from_tmac_xyz_m_quat_xyzw: Seven
    covariance_rad_m: Matrix
    """Of (rotation vector, translation) in trk, shape (6, 6)."""
    time_s: float

    @classmethod
    def of(cls, reading: PoseReading) -> "PoseInput":
        """Keep a reading."""
        return cls.model_validate(
            {
                "trk_from_tmac_xyz_m_quat_xyzw": numbers_of(reading.trk_from_tmac),
                "covariance_rad_m": reading.covariance.tolist(),
                "time_s": reading.time_s,
            }
        )

    @property
    def reading(self) -> PoseReading:
        """Get the reading."""
        return PoseReading(
            trk_from_tmac=pose_from_xyz_quat(self.trk_from_tmac_xyz_m_quat_xyzw),
            covariance=np.array(self.covariance_rad_m),
            time_s=self.time_s,
        )


class ViewInput(Model):
    """The corners found in one image."""

    corner_ids: tuple[int, ...]
    uv_px: tuple[Pixel, ...]
    image: str = ""
    """Name of the image file, if there is one."""
    image_sha256: str = ""
    """Hash of the image file."""

    @classmethod
    def of(cls, view: BoardView, *, image: str = "", image_sha256: str = "") -> "ViewInput":
        """Keep a view, rounded to ``UV_DECIMALS``."""
        return cls.model_validate(
            {
                "corner_ids": view.ids.tolist(),
                "uv_px": np.round(view.uv_px, UV_DECIMALS).tolist(),
                "image": image,
                "image_sha256": image_sha256,
            }
        )

    def view(self, pattern: PatternSpec) -> BoardView:
        """Give the view of a board with that pattern.

        Raises:
            CalibrationError: The board has no corner of such a number.
        """
        uv_px = np.array(self.uv_px, dtype=np.float64).reshape(-1, 2)
        return BoardView.of(np.array(self.corner_ids, dtype=np.int64), uv_px, pattern)


class StationInput(Model):
    """What was measured while the robot stood still: T-MAC and board."""

    reading: PoseInput
    view: ViewInput


class CameraValues(Model):
    """A camera model as plain values; see ``CameraModel``."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()

    @classmethod
    def of(cls, camera: CameraModel) -> "CameraValues":
        """Keep a camera model."""
        return cls.model_validate(camera.to_dict())

    @property
    def model(self) -> CameraModel:
        """Get the camera model."""
        return CameraModel.from_dict(self.model_dump())


class FrameInput(Model):
    """The reflectors that define F_TRS."""

    measured_utc: str
    reflectors: ReflectorsSpec
    points: Points


class IntrinsicsInput(Model):
    """Views of a board, without the tracker."""

    measured_utc: str
    pattern: PatternSpec
    nominal: CameraValues
    views: tuple[ViewInput, ...]
    skipped: tuple[str, ...] = ()
    """What was left out, and why, one line each."""


class StationsInput(Model):
    """Views of a board from stations where the T-MAC was measured."""

    kind: Literal["stations"] = "stations"
    measured_utc: str
    pattern: PatternSpec
    nominal: CameraValues
    stations: tuple[StationInput, ...]
    is_camera_known: bool = False
    """Whether ``nominal`` is a calibrated camera, to be taken as it is."""
    setup: Setup = "eye_in_hand"
    skipped: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    """What was assumed, one line each."""


class PosePairInput(Model):
    """Two poses taken at the same time."""

    trk_from_tmac: Seven
    cam_from_board: Seven


class PosePairsInput(Model):
    """Pose pairs from files, for a hand-eye transform alone.

    Streams without common time are paired before; ``notes`` say how.
    """

    kind: Literal["pose_pairs"] = "pose_pairs"
    measured_utc: str
    pairs: tuple[PosePairInput, ...]
    setup: Setup = "eye_in_hand"
    files_sha256: Annotated[dict[str, str], Field(default_factory=dict)]
    """Hash of each file by name."""
    notes: tuple[str, ...] = ()


class RobotStationInput(Model):
    """Where the robot's encoders say it stood, and where the T-MAC was measured."""

    rail_m: float
    base_from_flange_xyz_m_quat_xyzw: Seven
    reading: PoseInput

    @classmethod
    def of(cls, robot: RobotReading, reading: PoseReading) -> "RobotStationInput":
        """Keep two readings."""
        return cls.model_validate(
            {
                "rail_m": robot.rail_m,
                "base_from_flange_xyz_m_quat_xyzw": numbers_of(robot.base_from_flange),
                "reading": PoseInput.of(reading),
            }
        )

    @property
    def base_from_flange(self) -> RigidTransform:
        """Get the pose of the flange."""
        return pose_from_xyz_quat(self.base_from_flange_xyz_m_quat_xyzw)


class RobotInput(Model):
    """The T-MAC measured at many places of arm and rail."""

    measured_utc: str
    mounting: MountingSpec
    reflectors: ReflectorsSpec
    points: Points
    """The reflectors, measured in the same set-up of the tracker."""
    stations: tuple[RobotStationInput, ...]
    skipped: tuple[str, ...] = ()


class LampInput(Model):
    """The reflector on the lamp's housing."""

    measured_utc: str
    lamp: LampSpec
    reflectors: ReflectorsSpec
    points: Points
    """The reflectors, measured in the same set-up of the tracker."""
    point: PointInput


class PatchesInput(Model):
    """Mean grey of patches of one image, and what renderings of the same view have there.

    Each column has one value a patch.
    """

    shot_id: int
    exposure_s: float
    gain_db: float
    grey: tuple[float, ...]
    """Part of full scale."""
    cos_axis: tuple[float, ...]
    """Cosine of the angle between the ray and the optical axis."""
    lambert: tuple[float, ...]
    """Radiance of a white Lambert surface, from a lamp of intensity 1."""
    lommel_seeliger: tuple[float, ...]
    """Likewise."""
    phase_deg: tuple[float, ...]
    """Phase angle in the middle of the patch."""

    @model_validator(mode="after")
    def _columns_are_equally_long(self) -> "PatchesInput":
        columns = self.grey, self.cos_axis, self.lambert, self.lommel_seeliger, self.phase_deg
        if len({len(column) for column in columns}) > 1:
            raise ValueError(f"shot {self.shot_id}: its columns have different lengths")
        return self


class PhotometryInput(Model):
    """Recorded images of the model against renderings of it, from poses that are known."""

    measured_utc: str
    """When the images were recorded."""
    dataset_name: str
    dataset_uuid: str
    """Of the dataset the images are from; empty if it has none."""
    patch_px: int
    """Side of a patch."""
    images: tuple[PatchesInput, ...]


HandEyeInput: TypeAlias = Annotated[StationsInput | PosePairsInput, Field(discriminator="kind")]


class Inputs(Model):
    """Everything measured for a record; a part that is missing was not measured."""

    frame: FrameInput | None = None
    intrinsics: IntrinsicsInput | None = None
    hand_eye: HandEyeInput | None = None
    lamp: LampInput | None = None
    robot: RobotInput | None = None
    photometry: PhotometryInput | None = None

    def with_parts(self, **parts: Any) -> "Inputs":
        """Give the inputs with some parts measured anew."""
        return self.model_copy(update=parts)

    @property
    def measured_utc(self) -> dict[str, str]:
        """Get when each part was measured, by name."""
        parts = {name: getattr(self, name) for name in Inputs.model_fields}
        return {name: part.measured_utc for name, part in parts.items() if part is not None}

    @property
    def measured_at_rig_utc(self) -> dict[str, str]:
        """Get the same of the parts that can move; paint stays as it is."""
        return {name: utc for name, utc in self.measured_utc.items() if name != "photometry"}


def numbers_of(pose: RigidTransform) -> list[float]:
    """Give a pose as x y z qx qy qz qw."""
    return xyz_quat_from_pose(pose).tolist()


def views_of(inputs: Sequence[ViewInput], pattern: PatternSpec) -> tuple[BoardView, ...]:
    """Give back the views that were kept."""
    return tuple(view.view(pattern) for view in inputs)
