"""The values a dataset holds: records of shots, and the reference views of the terrain."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.devices.readings import (
    Frame,
    PointReading,
    PoseReading,
    RobotReading,
    RoomReading,
)
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray


@dataclass(frozen=True, slots=True)
class Truth:
    """Ground truth of a shot, derived from raw readings by the calibration record."""

    trs_from_cam: RigidTransform
    covariance: FloatArray
    """Of (rotation vector, translation) in trs, (6, 6), rad and m; see geometry.uncertainty."""
    range_los_m: float
    """Distance from camera centre to terrain along the optical axis (paper, section 1.1)."""
    usable_fraction: float
    """Part of the image that shows the model: set pixels of the mask over all pixels, 0 to 1."""


QualityFlag: TypeAlias = Literal[
    "saturation",
    "contrast",
    "blur",
    "target",
    "tracker",
    "robot",
    "temperature",
    "brightness",
]
"""What a quality gate may hold against a shot."""

ErrorClass: TypeAlias = Literal[
    "tracking_lost",
    "not_settled",
    "incomplete_frame",
    "not_ready",
    "lost_connection",
    "unsafe",
    "quality",
]
"""Why an attempt at a shot came to nothing; ``unsafe`` is a door, ``quality`` the gate."""


@dataclass(frozen=True, slots=True)
class ShotQuality:
    """What was measured of how good a shot is; None where it could not be."""

    settle_shift_m: float
    """Between the last two looks at the T-MAC before the measurement: the dispersion at rest."""
    settle_turn_rad: float
    exposure_shift_m: float
    """Between the measurement before and the look after the exposure."""
    exposure_turn_rad: float
    tracker_sigma_m: float
    """Largest of three axes, as the tracker states it."""
    robot_shift_m: float
    """Measured camera against where the robot was to put it."""
    robot_turn_rad: float
    saturated_fraction: float
    """Of the pixels within the mask; of all pixels if the mask is empty. Likewise below."""
    contrast: float
    """Standard deviation over mean of the grey values."""
    sharpness: float
    """Energy of the grey values' second differences over their variance, without what noise adds:
    a number to compare shots of like range by."""
    brightness: float | None
    """Mean grey value over what a rendering predicts, per second of exposure and at no gain; None:
    none was predicted."""
    flags: tuple[QualityFlag, ...] = ()


@dataclass(frozen=True, slots=True)
class ShotTiming:
    """How long the parts of a shot took, by the laboratory's clock, seconds."""

    move_s: float
    settle_s: float
    tracker_s: float
    camera_s: float
    confirm_s: float
    read_s: float
    lost_s: float
    """Since the last shot was done: failed attempts, waiting, pauses; 0 if nothing went wrong."""


@dataclass(frozen=True, slots=True)
class ShotRecord:
    """Everything recorded of one shot; raw readings first, so that truth can be recomputed."""

    shot_id: int
    attempt: int
    """1 for the first try of this shot."""
    trs_from_cam_nominal: RigidTransform
    robot: RobotReading | None
    """None in a shot that was imported: no laboratory of ours took it. Likewise tracker and room,
    and then NaN stands for what is not known of exposure, gain, time and the truth's covariance."""
    tracker: PoseReading | None
    room: RoomReading | None
    frame: Frame
    mask: NDArray[np.bool_]
    """True where the flat outline of the model is seen, shape (rows, columns)."""
    truth: Truth
    quality: ShotQuality | None = None
    """None in datasets that were imported or are older than layout 2."""
    timing: ShotTiming | None = None
    """Likewise."""
    n_failures: Mapping[ErrorClass, int] = field(default_factory=dict[ErrorClass, int])
    """Attempts that came to nothing before this one, by why; classes of none are left out."""
    session: int = 1
    """Which session of the dataset took it: begun, resumed or retaken."""


SessionKind: TypeAlias = Literal["run", "resume", "retake", "import"]


@dataclass(frozen=True, slots=True)
class Session:
    """One time that somebody recorded into a dataset, and with what."""

    number: int
    """From 1."""
    kind: SessionKind
    start_utc: str
    """ISO 8601."""
    campaign_path: str
    """Where the campaign file was; likewise below."""
    rig_path: str
    calibration_path: str
    campaign_yaml: str
    rig_yaml: str
    calibration_json: str
    plan_sha256: str
    seed: int
    software: Mapping[str, str]
    devices: Mapping[str, str]
    host: str
    pid: int
    accepted: tuple[str, ...] = ()
    """What spoke against going on, and was accepted all the same, one line each."""


@dataclass(frozen=True, slots=True)
class DriftRecord:
    """The reflectors measured anew between shots, against where the calibration has them."""

    n_shots_before: int
    """How many shots were committed before."""
    time_s: float
    """Seconds since 1970 UTC."""
    readings: Mapping[str, PointReading]
    """Raw, by name of the reflector."""
    shift: FloatArray
    """How the model seems to have moved, in trs: (rotation vector, translation), shape (6,), rad
    and m. It is the error that truth has now."""
    max_shift_m: float
    """What that amounts to where it is largest on the model."""
    limit_m: float
    is_within: bool
    """Whether nothing moved beyond the limit."""
    session: int = 1
    """Which session of the dataset made it."""


@dataclass(frozen=True, slots=True)
class ReferenceView:
    """The terrain rendered at one nominal pose: what the navigation database is made from."""

    view_id: int
    trs_from_cam: RigidTransform
    image: NDArray[np.uint8]
    """Shape (rows, columns)."""
    depth_m: NDArray[np.float32]
    """Depth along the optical axis at each pixel centre; NaN where no terrain is seen."""
    mask: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Recomputation:
    """What a dataset was before its ground truth was recomputed."""

    time_utc: str
    """When, ISO 8601."""
    version: str
    """Of the tronlab that did it."""
    dataset_name: str
    """Name of the file it came from."""
    dataset_sha256: str
    calibration_sha256: str
    """Of the text of the calibration record that was replaced."""


@dataclass(frozen=True, slots=True)
class Provenance:
    """What is needed to know how a dataset came about, and to make it again."""

    campaign_name: str
    campaign_yaml: str
    rig_name: str
    rig_yaml: str
    calibration_json: str
    """The calibration record, whole."""
    seed: int
    software: dict[str, str]
    """Versions of tronlab, Python and the libraries that shape the numbers."""
    devices: dict[str, str]
    """Identity of each device, as ``maker model serial firmware``."""
    plan_sha256: str
    """Hash of the expanded shots."""
    n_shots_planned: int
    camera: CameraModel
    """Calibrated intrinsics of the images recorded."""
    accepted: tuple[str, ...] = ()
    """What spoke against the calibration record and was accepted all the same, one line each."""
    recomputation: Recomputation | None = None
    """Where truth comes from if it is not that of the recording."""
