"""Whether the tracker still stands where a calibration has it: its reflectors measured anew."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.calib.inputs import FrameInput, point_readings
from tronlab.calib.reflectors.frame import (
    check_reading,
    check_weight,
    moved_by_frame,
    nominal_centres,
)
from tronlab.calib.reflectors.rigid_body import RigidBody
from tronlab.calib.results import FrameResult
from tronlab.devices.readings import PointReading
from tronlab.errors import CalibrationError
from tronlab.geometry.alignment import align_points_weighted
from tronlab.geometry.poses import FloatArray
from tronlab.geometry.uncertainty import inverse_covariance, pose_difference

MIN_REFLECTORS = 3
_CERTAIN = 5.0
"""A length that changed by more sigmas than this did change."""


@dataclass(frozen=True, slots=True)
class DriftCheck:
    """What reflectors measured anew say about the calibration they are compared with."""

    readings: Mapping[str, PointReading]
    """The reflectors as measured now, by name."""
    time_s: float
    """When the last of them was measured, seconds since 1970 UTC."""
    shift: FloatArray
    """How the model seems to have moved: (rotation vector, translation) in trs of the motion from
    where it was to where it is seen with the calibrated frame, shape (6,), rad and m. It is the
    error that all ground truth has now."""
    covariance: FloatArray
    """Of ``shift``, from both measurements; shape (6, 6)."""
    moved_m: Mapping[str, float]
    """How far each reflector seems to have moved."""
    loose: tuple[str, ...]
    """Reflectors that moved against the others; they have no part in ``shift`` if it can be found
    without them."""
    max_shift_m: float
    """What the shift amounts to where it is largest on the model."""
    max_shift_sigma_m: float
    limit_m: float
    is_within: bool
    """Whether the calibration still holds: the shift is within the limit, and enough reflectors
    agree on that."""

    @property
    def text(self) -> str:
        """Get the same in a line for people."""
        shift = (
            f"{self.max_shift_m * 1e3:.3f} mm +-{self.max_shift_sigma_m * 1e3:.3f} mm on the model"
            f" (allowed {self.limit_m * 1e3:g} mm)"
        )
        if not self.loose:
            turn_deg = float(np.degrees(np.linalg.norm(self.shift[:3])))
            who = "nothing moved" if self.is_within else "the tracker moved against the model"
            return f"{who}: by up to {shift}, turned by {turn_deg:.4f} deg"
        moved = ", ".join(f"{name} by {self.moved_m[name] * 1e3:.3f} mm" for name in self.loose)
        others = len(self.readings) - len(self.loose)
        if others < MIN_REFLECTORS:
            return (
                f"reflectors moved against each other: {moved}; without them too few are left to"
                " tell whether the tracker moved"
            )
        return f"reflectors moved against the others: {moved}; the others by up to {shift}"


def compare_reflectors(
    readings: Mapping[str, PointReading],
    frame_input: FrameInput,
    frame: FrameResult,
    *,
    limit_m: float,
) -> DriftCheck:
    """Compare reflectors measured now with those a frame was found from.

    Distances between reflectors tell who moved: if they are the same the tracker did (or the model
    as a whole, which is the same); if they are not, single reflectors did. Only with more than
    three can the frame be judged by the reflectors that stayed.

    Args:
        readings: Measured now, at least three of those in ``frame_input``.
        frame_input: What the frame was found from.
        frame: The frame.
        limit_m: How much shift on the model is allowed.

    Raises:
        CalibrationError: Fewer than three reflectors, one that the calibration has not, or a limit
            that is none.
    """
    if not limit_m > 0.0:
        raise CalibrationError(f"drift check: the limit is {limit_m} m, it must be more than 0")
    then = point_readings(frame_input.points)
    _check_names(readings, then)
    body, covariances = _in_trs(readings, then, frame, limit_m=limit_m)
    loose = _loose(body)
    is_known = not loose or len(body.names) - len(loose) >= MIN_REFLECTORS
    left_out = [body.names.index(name) for name in loose] if is_known else []
    shift, covariance = _shift(body.without(left_out), np.delete(covariances, left_out, axis=0))
    max_shift_m, sigma_m = _largest(shift, covariance, frame_input)
    moved_m = np.linalg.norm(body.measured_m - body.nominal_m, axis=1).tolist()
    return DriftCheck(
        readings=readings,
        time_s=max(reading.time_s for reading in readings.values()),
        shift=pose_difference(RigidTransform.identity(), shift),
        covariance=covariance,
        moved_m=dict(zip(body.names, moved_m, strict=True)),
        loose=loose,
        max_shift_m=max_shift_m,
        max_shift_sigma_m=sigma_m,
        limit_m=limit_m,
        is_within=is_known and max_shift_m <= limit_m,
    )


def _check_names(readings: Mapping[str, PointReading], then: Mapping[str, PointReading]) -> None:
    if unknown := [name for name in readings if name not in then]:
        raise CalibrationError(
            f"drift check: reflector {', '.join(unknown)} has no part in the calibration; it has:"
            f" {', '.join(then)}"
        )
    if len(readings) < MIN_REFLECTORS:
        raise CalibrationError(
            f"drift check: {len(readings)} reflectors measured ({', '.join(readings) or 'none'}),"
            f" at least {MIN_REFLECTORS} needed of: {', '.join(then)}"
        )


def _in_trs(
    readings: Mapping[str, PointReading],
    then: Mapping[str, PointReading],
    frame: FrameResult,
    *,
    limit_m: float,
) -> tuple[RigidBody, FloatArray]:
    """Give the points then and now, both by the calibrated frame, and covariances (n, 3, 3)."""
    for name, reading in readings.items():
        check_reading(reading, f"drift check: reflector {name}")
    r = frame.trs_from_trk.rotation.as_matrix()
    covariances = np.array(
        [r @ (readings[n].covariance_m2 + then[n].covariance_m2) @ r.T for n in readings]
    )
    for name, covariance in zip(readings, covariances, strict=True):
        check_weight(covariance, f"drift check: reflector {name}")
    largest_m = float(np.sqrt(np.linalg.eigvalsh(covariances).max()))
    body = RigidBody.of(
        {name: frame.trs_from_trk.apply(then[name].p_trk_m) for name in readings},
        {name: frame.trs_from_trk.apply(reading.p_trk_m) for name, reading in readings.items()},
        tolerance_m=max(limit_m, _CERTAIN * np.sqrt(2.0) * largest_m),
    )
    return body, covariances


def _loose(body: RigidBody) -> tuple[str, ...]:
    """Name the reflectors that moved against the others; all that are in doubt."""
    if body.fits:
        return ()
    suspects = {i for culprits in body.culprits() for i in culprits}
    return tuple(name for i, name in enumerate(body.names) if not suspects or i in suspects)


def _shift(body: RigidBody, covariances: FloatArray) -> tuple[RigidTransform, FloatArray]:
    """Give the motion from where the reflectors were to where they are seen, and its covariance."""
    then_from_now = align_points_weighted(body.nominal_m, body.measured_m, covariances)
    back = then_from_now.a_from_b
    return back.inv(), inverse_covariance(back, then_from_now.covariance)


def _largest(
    shift: RigidTransform, covariance: FloatArray, frame_input: FrameInput
) -> tuple[float, float]:
    """Give the shift where it is largest on the model, and its sigma there."""
    centres = np.array(list(nominal_centres(frame_input.reflectors).values()))
    corners = np.array(list(product(*zip(centres.min(axis=0), centres.max(axis=0), strict=True))))
    moved = shift.apply(corners) - corners
    sizes_m = np.linalg.norm(moved, axis=1)
    i = int(sizes_m.argmax())
    jacobian = moved_by_frame(shift.rotation.apply(corners[i]))
    at_corner = jacobian @ covariance @ jacobian.T
    return float(sizes_m[i]), float(np.sqrt(np.linalg.eigvalsh(at_corner)[-1]))
