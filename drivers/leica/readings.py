"""From results to readings: SI units, tronlab's order of covariances, sound values only.

Units are those the driver sets: metres, radians, degrees Celsius, millibar, per cent. The
covariance of a reading is that of its scatter, which the tracker reports, and of the stated
accuracy, which it does not.
"""

from dataclasses import astuple, dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from drivers.leica.replies import Environment
from drivers.leica.results import ExtendedPointResult, PointResult, PoseResult, StreamedPose
from tronlab.devices.accuracy import StatedAccuracy
from tronlab.devices.readings import AirReading, PointReading, PoseReading
from tronlab.geometry.poses import FloatArray

CELSIUS_ZERO_K: Final = 273.15
PA_PER_MBAR: Final = 100.0
_LARGEST: Final = 1e6
"""Of any length, angle, temperature or pressure, in the tracker's units."""
_NORM_TOLERANCE: Final = 1e-3
"""Farther from 1, the norm of a quaternion is no rounding."""

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class StreamedPoseReading:
    """One pose of a stream, measured in motion."""

    trk_from_tmac: RigidTransform
    covariance: FloatArray
    """As of ``PoseReading``."""
    tracker_time_s: float
    """By the tracker's clock, whose zero is anywhere."""
    received_s: float
    """When its packet was read, seconds since 1970 UTC: later than the measurement."""


def air_reading(environment: Environment) -> AirReading:
    """Convert the air to SI units.

    Raises:
        ValueError: A value is none that could be measured.
    """
    temperature_c, pressure_mbar, humidity_pct = _sound("air", astuple(environment))
    return AirReading(
        temperature_k=float(temperature_c) + CELSIUS_ZERO_K,
        pressure_pa=float(pressure_mbar) * PA_PER_MBAR,
        relative_humidity=float(humidity_pct) / 100.0,
    )


def environment_of(air: AirReading) -> Environment:
    """Convert the air to the tracker's units."""
    return Environment(
        temperature_c=air.temperature_k - CELSIUS_ZERO_K,
        pressure_mbar=air.pressure_pa / PA_PER_MBAR,
        humidity_pct=air.relative_humidity * 100.0,
    )


def point_reading(
    result: PointResult | ExtendedPointResult,
    accuracy: StatedAccuracy,
    *,
    target: str,
    time_s: float,
) -> PointReading:
    """Make the reading of a reflector.

    Raises:
        ValueError: A value is none that could be measured, or the covariance is not positive.
    """
    p_trk_m = _sound("position", result.position)
    scatter = _covariance("position", result.std, result.covariance)
    return PointReading(
        target=target,
        p_trk_m=p_trk_m,
        covariance_m2=scatter + accuracy.point_covariance(p_trk_m),
        time_s=time_s,
    )


def pose_reading(result: PoseResult, accuracy: StatedAccuracy, *, time_s: float) -> PoseReading:
    """Make the reading of a T-MAC; its rotation status must have been found good.

    Raises:
        ValueError: A value is none that could be measured, the quaternion no rotation, or the
            covariance not positive.
    """
    return PoseReading(
        trk_from_tmac=_pose(result),
        covariance=_pose_covariance(result, accuracy),
        time_s=time_s,
        air=air_reading(result.environment),
    )


def streamed_pose_reading(
    result: StreamedPose, accuracy: StatedAccuracy, *, received_s: float
) -> StreamedPoseReading:
    """Make the reading of one pose of a stream; its rotation status must have been found good.

    Raises:
        ValueError: As ``pose_reading``.
    """
    return StreamedPoseReading(
        trk_from_tmac=_pose(result),
        covariance=_pose_covariance(result, accuracy),
        tracker_time_s=result.time_s + result.time_us * 1e-6,
        received_s=received_s,
    )


def _pose(result: PoseResult | StreamedPose) -> RigidTransform:
    w, x, y, z = _sound("quaternion", result.quaternion)
    norm = float(np.linalg.norm([w, x, y, z]))
    if abs(norm - 1.0) > _NORM_TOLERANCE:
        raise ValueError(f"the quaternion's norm is {norm:.9g}, expected 1")
    return RigidTransform.from_components(
        _sound("position", result.position), Rotation.from_quat([x, y, z, w])
    )


def _pose_covariance(result: PoseResult | StreamedPose, accuracy: StatedAccuracy) -> FloatArray:
    """Give the covariance (6, 6) of rotation vector and translation, independent of each other.

    The scatter of the angles X, Y, Z are taken as a small rotation about the tracker's axes: the
    order in which the angles turn matters for the angles, but not for what is this small.
    """
    covariance = accuracy.pose_covariance(_sound("position", result.position))
    covariance[:3, :3] += _covariance("rotation", result.angle_std, result.angle_covariance)
    covariance[3:, 3:] += _covariance("position", result.std, result.covariance)
    return covariance


def _covariance(what: str, std: Triple, covariance: Triple) -> FloatArray:
    """Put a covariance (3, 3) together from standard deviations and xy, xz, yz."""
    xy, xz, yz = _sound(f"covariance of {what}", covariance)
    matrix = np.diag(np.square(_sound(f"standard deviation of {what}", std)))
    matrix += np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])
    if np.linalg.eigvalsh(matrix)[0] <= 0.0:
        raise ValueError(
            f"the covariance of {what} is not positive: standard deviations {list(std)},"
            f" covariances {list(covariance)}"
        )
    return matrix


def _sound(what: str, values: tuple[float, ...]) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if not (np.abs(array) <= _LARGEST).all():  # NaN is not, either
        raise ValueError(f"{what} has values that no tracker measures: {list(values)}")
    return array
