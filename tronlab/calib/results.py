"""What a calibration finds, part by part, each with its covariance."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.projection import DistortionModel
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.render.photometry import Lambert, LommelSeeliger, LunarLambert, Photometry

Statistics = dict[str, Any]
"""How well a solution fits what was measured; plain values."""


def no_bow() -> FloatArray:
    """Give the bow of a flat board."""
    return np.zeros(3)


@dataclass(frozen=True, slots=True)
class FrameResult:
    """Where the model frame lies in the tracker's frame."""

    trs_from_trk: RigidTransform
    covariance: FloatArray
    """Of (rotation vector, translation) in trs, shape (6, 6), rad and m; geometry.uncertainty."""
    statistics: Statistics = field(default_factory=dict[str, Any])


@dataclass(frozen=True, slots=True)
class CameraResult:
    """The camera's intrinsics."""

    camera: CameraModel
    covariance: FloatArray
    """Of ``INTRINSICS``, shape (12, 12); zero for those the distortion model fixes."""
    model: DistortionModel
    bow_m: FloatArray = field(default_factory=no_bow)
    """Bow of the board, shape (3,); see ``bow``."""
    statistics: Statistics = field(default_factory=dict[str, Any])


@dataclass(frozen=True, slots=True)
class HandEyeResult:
    """Where the camera sits on the T-MAC."""

    tmac_from_cam: RigidTransform
    covariance: FloatArray
    """Of (rotation vector, translation) in tmac, shape (6, 6), rad and m."""
    statistics: Statistics = field(default_factory=dict[str, Any])


@dataclass(frozen=True, slots=True)
class LampResult:
    """Where the light is."""

    p_trs_m: FloatArray
    """Shape (3,)."""
    covariance_m2: FloatArray
    """Shape (3, 3)."""
    statistics: Statistics = field(default_factory=dict[str, Any])


@dataclass(frozen=True, slots=True)
class RobotResult:
    """How robot and rail stand, so that a pose of the camera can be driven to."""

    trs_from_rail: RigidTransform
    """Rail at 0."""
    rail_axis: FloatArray
    """How far the base moves for one metre of the rail's encoder, shape (3,), frame rail."""
    flange_from_tmac: RigidTransform
    covariance: FloatArray
    """Of (rotation vector, translation) of trs_from_rail in trs, rail_axis, (rotation vector,
    translation) of flange_from_tmac in flange; shape (15, 15), rad and m."""
    statistics: Statistics = field(default_factory=dict[str, Any])


@dataclass(frozen=True, slots=True)
class PhotometryResult:
    """How the paint reflects light."""

    photometry: Photometry
    """The lunar-Lambert function that fits best, or the pure function it has become."""
    weight_sigma: float
    """One sigma of the share of Lommel-Seeliger."""
    statistics: Statistics = field(default_factory=dict[str, Any])

    @property
    def weight(self) -> float:
        """Get the share of Lommel-Seeliger, L.

        Raises:
            CalibrationError: The function has none.
        """
        match self.photometry:
            case Lambert():
                return 0.0
            case LommelSeeliger():
                return 1.0
            case LunarLambert(weight=float(weight)):
                return weight
            case _:
                raise CalibrationError(f"{self.photometry.kind} has no fixed weight")


@dataclass(frozen=True, slots=True)
class Results:
    """The parts that were found; a part not measured is None."""

    frame: FrameResult | None = None
    camera: CameraResult | None = None
    hand_eye: HandEyeResult | None = None
    lamp: LampResult | None = None
    robot: RobotResult | None = None
    photometry: PhotometryResult | None = None
