"""How long a motion takes in which all axes start and stop together (KUKA: PTP)."""

import numpy as np

from tronlab.geometry.poses import FloatArray


def ptp_duration_s(travel: FloatArray, *, speed: FloatArray, acceleration: FloatArray) -> float:
    """Give the duration of a synchronous motion whose speed rises and falls as a trapezoid.

    The axis that would take longest alone sets the time, and the slowest of them to speed up the
    ramps; where there is no room for full speed, the trapezoid is a triangle.

    Args:
        travel: How far each axis goes, shape (n,), any unit, any sign.
        speed: Highest speed of each axis, shape (n,), the same units per second.
        acceleration: Highest acceleration, shape (n,), the same units per second squared.
    """
    distance = np.abs(travel)
    is_moving = distance > 0.0
    if not is_moving.any():
        return 0.0
    progress_speed = float((speed[is_moving] / distance[is_moving]).min())
    progress_ramp = float((acceleration[is_moving] / distance[is_moving]).min())
    top = min(progress_speed, float(np.sqrt(progress_ramp)))
    return 1.0 / top + top / progress_ramp
