"""What devices report: immutable values in SI units, each with the time it was taken."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.poses import FloatArray


@dataclass(frozen=True, slots=True)
class DeviceIdentity:
    """Which device answers; calibration records and datasets name it."""

    maker: str
    model: str
    serial: str
    firmware: str

    def is_same_device(self, other: "DeviceIdentity") -> bool:
        """Tell whether both name one device: by serial number, or by model if neither has one."""
        if self.serial or other.serial:
            return self.serial == other.serial
        return self.model == other.model

    def __str__(self) -> str:
        """Give ``maker model serial firmware``; what the device does not say is left out."""
        return " ".join(filter(None, (self.maker, self.model, self.serial, self.firmware)))


@dataclass(frozen=True, slots=True)
class AirReading:
    """The air a device measures through."""

    temperature_k: float
    pressure_pa: float
    relative_humidity: float
    """0 to 1."""


@dataclass(frozen=True, slots=True)
class PointReading:
    """One stationary measurement of a reflector."""

    target: str
    """Name of the reflector."""
    p_trk_m: FloatArray
    """Centre of the reflector, shape (3,), frame trk."""
    covariance_m2: FloatArray
    """Covariance of ``p_trk_m``, shape (3, 3)."""
    time_s: float
    """Middle of the measurement, seconds since 1970 UTC."""


@dataclass(frozen=True, slots=True)
class PoseReading:
    """One stationary measurement of the T-MAC."""

    trk_from_tmac: RigidTransform
    covariance: FloatArray
    """Of (rotation vector, translation) in trk, (6, 6), rad and m; see geometry.uncertainty."""
    time_s: float
    """Middle of the measurement, seconds since 1970 UTC."""
    air: AirReading | None = None
    """The air the tracker corrected its distance for; None if it does not say."""


@dataclass(frozen=True, slots=True)
class RobotTarget:
    """Where the robot shall stand: the rail, and the flange relative to the base upon it."""

    rail_m: float
    base_from_flange: RigidTransform


@dataclass(frozen=True, slots=True)
class Posture:
    """How rail and arm stand at a target: one of the ways to stand there."""

    rail_m: float
    axes_rad: FloatArray
    """A1 to A6 of the arm, shape (6,)."""


@dataclass(frozen=True, slots=True)
class RobotReading:
    """Where the robot's own encoders say it stands."""

    rail_m: float
    base_from_flange: RigidTransform
    time_s: float


@dataclass(frozen=True, slots=True)
class Frame:
    """One image and how it was taken."""

    image: NDArray[np.uint8] | NDArray[np.uint16]
    """Grey values, shape (rows, columns); Mono8 as uint8, Mono12 as uint16 of 0 to 4095."""
    pixel_format: str
    """``Mono8`` or ``Mono12``."""
    exposure_s: float
    gain_db: float
    frame_id: int
    """The camera's own count of frames; never used to pair images with poses."""
    time_s: float
    """Middle of the exposure, seconds since 1970 UTC."""
    device_time_s: float | None = None
    """Time stamp of the camera's own clock, whose zero is anywhere; None if it has none."""


@dataclass(frozen=True, slots=True)
class RoomReading:
    """State of the room."""

    air_temperature_k: float
    air_pressure_pa: float
    relative_humidity: float
    """0 to 1."""
    is_door_closed: bool
    is_lamp_on: bool
    time_s: float
