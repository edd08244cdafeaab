"""What every renderer refuses."""

import math

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.render.renderer import Lamp, RenderError, SpotCone

_UNIT_TOLERANCE = 1e-6


def check_pose(trs_from_cam: RigidTransform) -> None:
    """Refuse a camera that is nowhere.

    Raises:
        RenderError: The pose is not finite.
    """
    if not np.isfinite(trs_from_cam.as_matrix()).all():
        raise RenderError(f"camera pose: is not finite: {trs_from_cam.as_matrix().tolist()}")


def check_lamp(lamp: Lamp) -> None:
    """Refuse a lamp that cannot be.

    Raises:
        RenderError: A number that is not finite, a negative intensity or radius, a cone whose axis
            is not a unit vector or whose angles are not 0 <= inner <= outer <= pi.
    """
    if not (np.isfinite(lamp.p_trs_m).all() and math.isfinite(lamp.intensity)):
        raise RenderError(f"lamp: is not finite: {lamp}")
    if lamp.intensity < 0:
        raise RenderError(f"lamp: intensity is {lamp.intensity}, must not be negative")
    if not 0 <= lamp.radius_m < math.inf:
        raise RenderError(f"lamp: radius_m is {lamp.radius_m}, must be 0 (a point) or more")
    if lamp.cone is not None:
        _check_cone(lamp.cone)


def _check_cone(cone: SpotCone) -> None:
    length = float(np.linalg.norm(cone.axis_trs))
    if not abs(length - 1) <= _UNIT_TOLERANCE:
        raise RenderError(
            f"lamp cone: axis_trs is {list(cone.axis_trs)} of length {length}, must have length 1"
        )
    inner, outer = cone.inner_half_angle_rad, cone.outer_half_angle_rad
    if not 0 <= inner <= outer <= math.pi:
        raise RenderError(
            f"lamp cone: half angles are {inner} (inner) and {outer} rad (outer),"
            " must be 0 <= inner <= outer <= pi"
        )
