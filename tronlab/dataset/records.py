"""The values a dataset holds: records of shots, and the reference views of the terrain."""

from collections.abc import Mapping
from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True)
class ShotRecord:
    """Everything recorded of one shot; raw readings first, so that truth can be recomputed."""

    shot_id: int
    attempt: int
    """1 for the first try of this shot."""
    trs_from_cam_nominal: RigidTransform
    robot: RobotReading
    tracker: PoseReading
    room: RoomReading
    frame: Frame
    mask: NDArray[np.bool_]
    """True where the flat outline of the model is seen, shape (rows, columns)."""
    truth: Truth


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
