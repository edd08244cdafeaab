"""Which direction of a hand-eye transform the stations determine least, in words."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.poses import FloatArray

_AXES = ("the image's x-axis", "the image's y-axis", "the optical axis")
_IS_AXIS = np.cos(np.radians(25.0))
"""A direction whose component along an axis is at least that is called by the axis."""


def name_least_determined(
    tmac_from_cam: RigidTransform, covariance: FloatArray, *, distance_m: float
) -> str:
    """Name the direction of translation or rotation that is least determined, and its sigma.

    Args:
        tmac_from_cam: The transform.
        covariance: Of (rotation vector, translation) in tmac, shape (6, 6), rad and m.
        distance_m: At which distance from the camera a rotation counts as much as the translation
            it makes there.
    """
    cam_from_tmac = tmac_from_cam.rotation.inv().as_matrix()
    sigma_rad, turn = _largest(cam_from_tmac @ covariance[:3, :3] @ cam_from_tmac.T)
    sigma_m, shift = _largest(cam_from_tmac @ covariance[3:, 3:] @ cam_from_tmac.T)
    if sigma_rad * distance_m > sigma_m:
        return f"rotation about {_direction(turn)}: {np.degrees(sigma_rad):.4f} deg"
    return f"translation along {_direction(shift)}: {1e3 * sigma_m:.3f} mm"


def _largest(covariance: FloatArray) -> tuple[float, FloatArray]:
    """Give the largest sigma and its direction."""
    values, axes = np.linalg.eigh(covariance)
    return float(np.sqrt(values[-1])), axes[:, -1]


def _direction(v: FloatArray) -> str:
    main = int(np.argmax(np.abs(v)))
    if abs(v[main]) >= _IS_AXIS:
        return _AXES[main]
    numbers = ", ".join(f"{value:.2f}" for value in v * np.sign(v[main]))
    return f"({numbers}) of cam"
