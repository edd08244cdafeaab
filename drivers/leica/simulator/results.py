"""Measurements as data packets, in the client's coordinates and units."""

from math import sqrt
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from drivers.leica.simulator import packets
from drivers.leica.simulator.codes import DataType, RotationStatus
from drivers.leica.simulator.getters import air_values
from drivers.leica.simulator.layout import Values
from drivers.leica.simulator.targets import PROBE_ID
from drivers.leica.simulator.tracker import Tracker
from tronlab.devices.readings import PointReading, PoseReading
from tronlab.geometry.poses import FloatArray

_TIP: Values = {"tip_status": 0, "tip_id": 0, "tip_interface": 0}
"""A T-MAC has no tip."""
_ZERO = (0.0, 0.0, 0.0)


def stationary_point(tracker: Tracker, reading: PointReading) -> bytes:
    """Make the result of a stationary 3-D measurement, standard or extended."""
    covariance = _covariance(tracker, reading)
    spread = _spread(covariance)
    values: dict[str, Any] = {
        **_head(tracker),
        "value": tracker.settings.presentation.point(reading.p_trk_m),
        "std": spread["std"],
        "std_total": spread["total"],
        "pointing_error": _ZERO,
        "apriori_std": spread["std"],
        "apriori_total": spread["total"],
        "air": air_values(tracker),
    }
    if not tracker.settings.statistics[0]:
        return packets.data(DataType.SINGLE, values)
    values |= {"covariance": spread["covariance"], "apriori_covariance": spread["covariance"]}
    return packets.data(DataType.SINGLE_EXTENDED, values)


def stationary_pose(tracker: Tracker, reading: PoseReading) -> bytes:
    """Make the result of a stationary 6-D measurement."""
    place = _spread(_pose_covariance(tracker, reading))
    turn = _spread(_rotation_covariance(tracker, reading))
    values = {
        **_head(tracker),
        **_TIP,
        **_pose(tracker, reading.trk_from_tmac),
        "trigger": 0,
        "rotation_status": rotation_status(tracker),
        "probe_id": PROBE_ID,
        "field": 1,
        "air": air_values(tracker),
        **{f"position_{name}": value for name, value in place.items()},
        **{f"apriori_position_{name}": value for name, value in place.items()},
        **{f"angles_{name}": value for name, value in turn.items()},
        **{f"apriori_angles_{name}": value for name, value in turn.items()},
    }
    return packets.data(DataType.PROBE_STATIONARY, values)


def point_sample(tracker: Tracker, reading: PointReading, time_s: float) -> Values:
    """Make one sample of a continuous 3-D measurement; ``time_s`` is of the tracker's clock."""
    sample: dict[str, Any] = {
        "status": 0,
        "time": _clock(time_s),
        "value": tracker.settings.presentation.point(reading.p_trk_m),
    }
    if not tracker.settings.statistics[1]:
        return sample
    spread = _spread(_covariance(tracker, reading))
    return sample | {f"apriori_{name}": value for name, value in spread.items()}


def pose_sample(tracker: Tracker, reading: PoseReading, time_s: float) -> Values:
    """Make one sample of a continuous 6-D measurement."""
    place = _spread(_pose_covariance(tracker, reading))
    turn = _spread(_rotation_covariance(tracker, reading))
    return {
        **_pose(tracker, reading.trk_from_tmac),
        "status": 0,
        "trigger": 0,
        "rotation_status": rotation_status(tracker),
        "time": _clock(time_s),
        **{f"position_{name}": value for name, value in place.items()},
        **{f"angles_{name}": value for name, value in turn.items()},
    }


def continuous(tracker: Tracker, samples: list[Values]) -> bytes:
    """Make the packet of some samples."""
    values = {**_head(tracker), "n": len(samples), "air": air_values(tracker)}
    if tracker.settings.mode.is_probe:
        values |= {**_TIP, "probe_id": PROBE_ID, "field": 1}
        return packets.data(DataType.PROBE_CONTINUOUS, values, samples)
    is_extended = bool(tracker.settings.statistics[1])
    kind = DataType.MULTI_EXTENDED if is_extended else DataType.MULTI
    return packets.data(kind, values, samples)


def live_position(tracker: Tracker) -> bytes:
    """Make the packet that says where the beam's target is now."""
    trk_from_tmac = tracker.scene.trk_from_tmac
    if not tracker.settings.mode.is_probe or trk_from_tmac is None:
        point = tracker.settings.presentation.point(tracker.p_beam_m)
        return packets.data(DataType.REFLECTOR_POSITION, {"value": point})
    values = {
        **_TIP,
        **_pose(tracker, trk_from_tmac),
        "rotation_status": rotation_status(tracker),
    }
    return packets.data(DataType.PROBE_POSITION, values)


def nivel(tracker: Tracker, tilt_rad: FloatArray) -> bytes:
    """Make the result of an inclination measurement."""
    units = tracker.settings.units
    values = {
        "state": 0,
        "tilt": tilt_rad / units.rad_per_angle,
        "temperature": units.temperature_of(tracker.scene.air.temperature_k),
    }
    return packets.data(DataType.NIVEL, values)


def rotation_status(tracker: Tracker) -> RotationStatus:
    """Give what a 6-D result says of its rotation."""
    bad = RotationStatus.ERROR | RotationStatus.NOT_ENOUGH_LEDS | RotationStatus.RESIDUAL_TOO_HIGH
    good = RotationStatus.GOOD_GAUGE
    return RotationStatus.PRESENT | (good if tracker.is_pose_valid else bad)


def _head(tracker: Tracker) -> dict[str, Any]:
    return {"mode": tracker.settings.mode, "try_mode": tracker.settings.try_mode}


def _clock(time_s: float) -> tuple[int, int]:
    """Give seconds and microseconds."""
    return divmod(round(1e6 * time_s), 1_000_000)


def _pose(tracker: Tracker, trk_from_tmac: RigidTransform) -> dict[str, Any]:
    presentation = tracker.settings.presentation
    rotation = presentation.rotation(trk_from_tmac.rotation)
    x, y, z, w = rotation.as_quat()
    angles = rotation.as_euler("xyz") / tracker.settings.units.rad_per_angle
    return {
        "position": presentation.point(trk_from_tmac.translation),
        "quaternion": (w, x, y, z),
        "angles": angles,
    }


def _covariance(tracker: Tracker, reading: PointReading) -> FloatArray:
    return tracker.settings.presentation.covariance(reading.p_trk_m, reading.covariance_m2)


def _pose_covariance(tracker: Tracker, reading: PoseReading) -> FloatArray:
    place = reading.trk_from_tmac.translation
    return tracker.settings.presentation.covariance(place, reading.covariance[3:, 3:])


def _rotation_covariance(tracker: Tracker, reading: PoseReading) -> FloatArray:
    return tracker.settings.presentation.rotation_covariance(reading.covariance[:3, :3])


def _spread(covariance: FloatArray) -> dict[str, Any]:
    """Give a covariance (3, 3) as the packets have it."""
    return {
        "std": np.sqrt(np.diag(covariance)),
        "total": sqrt(float(np.trace(covariance))),
        "covariance": (covariance[0, 1], covariance[0, 2], covariance[1, 2]),
    }
