"""How well a tracker measures the T-MAC, told by the covariances of its own readings."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from tronlab.calib.inputs import StationsInput
from tronlab.calib.record import CalibrationRecord
from tronlab.devices.readings import PoseReading
from tronlab.errors import CalibrationError
from tronlab.geometry.poses import FloatArray


@dataclass(frozen=True, slots=True)
class TrackerAccuracy:
    """One sigma of a reading, the same along all axes; of a coordinate it grows with distance."""

    sigma_m: float
    """Of a coordinate, at no distance."""
    sigma_m_per_m: float
    """What each metre of distance adds to that."""
    sigma_rad: float
    """Of a turn about one axis."""
    n_readings: int
    distances_m: tuple[float, float]
    """Of the nearest and of the farthest reading that it follows from."""

    def covariance(self, distance_m: float) -> FloatArray:
        """Give the covariance (6, 6) of a reading at that distance; see geometry.uncertainty."""
        sigma_m = self.sigma_m + self.sigma_m_per_m * distance_m
        return np.diag([self.sigma_rad**2] * 3 + [sigma_m**2] * 3)

    def __str__(self) -> str:
        """Give it as data sheets do."""
        near, far = self.distances_m
        return (
            f"{self.sigma_m * 1e6:.1f} um + {self.sigma_m_per_m * 1e6:.1f} um/m a coordinate,"
            f" {np.degrees(self.sigma_rad) * 1e3:.2f} mdeg an axis"
            f" (by {self.n_readings} readings at {near:.2f} to {far:.2f} m)"
        )


def tracker_accuracy(record: CalibrationRecord) -> TrackerAccuracy:
    """Fit sigma = a + b distance, neither below 0, to the readings of the T-MAC in a record.

    Raises:
        CalibrationError: The record has no such reading.
    """
    readings = list(_readings(record))
    if not readings:
        raise CalibrationError(
            f"calibration record {record.source}: has no reading of the T-MAC, which would tell how"
            " well the tracker measures;"
            f"\nmeasure: tronlab calibrate hand-eye --rig RIG.yaml --record {record.source}"
        )
    distances = np.array([np.linalg.norm(r.trk_from_tmac.translation) for r in readings])
    covariances = np.array([reading.covariance for reading in readings])
    variances = np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2) / 3
    (constant, slope), _ = nnls(
        np.column_stack([np.ones_like(distances), distances]), np.sqrt(variances)
    )
    turns = np.trace(covariances[:, :3, :3], axis1=1, axis2=2) / 3
    return TrackerAccuracy(
        sigma_m=float(constant),
        sigma_m_per_m=float(slope),
        sigma_rad=float(np.sqrt(turns.mean())),
        n_readings=len(readings),
        distances_m=(float(distances.min()), float(distances.max())),
    )


def _readings(record: CalibrationRecord) -> Iterator[PoseReading]:
    if isinstance(record.inputs.hand_eye, StationsInput):
        for station in record.inputs.hand_eye.stations:
            yield station.reading.reading
    if record.inputs.robot is not None:
        for station in record.inputs.robot.stations:
            yield station.reading.reading
