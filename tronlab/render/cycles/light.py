"""What Cycles does not do itself: the lamp's cone, the light from everywhere, and who is lit."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.render.cycles.scene import Passes
from tronlab.render.renderer import Lamp, SpotCone


def offsets_to_lamp(
    depth_m: NDArray[np.float32], pinhole: CameraModel, trs_from_cam: RigidTransform, lamp: Lamp
) -> NDArray[np.float32]:
    """Give the way from the points that are seen to the lamp, trs, shape (rows, columns, 3)."""
    x, y, z = trs_from_cam.rotation.as_matrix().T.astype(np.float32)
    rays = pinhole.ray_table().astype(np.float32)
    directions = rays[..., :1] * x + rays[..., 1:] * y + z
    eye_to_lamp = np.asarray(lamp.p_trs_m, dtype=np.float64) - trs_from_cam.translation
    return eye_to_lamp.astype(np.float32) - depth_m[..., None] * directions


def radiance(
    passes: Passes, to_lamp: NDArray[np.float32], lamp: Lamp, *, ambient: float
) -> NDArray[np.float32]:
    """Give what the lamp in its cone and the light from everywhere make of Cycles' image.

    Args:
        passes: Of the image.
        to_lamp: From the points at the pixels' centres, as ``offsets_to_lamp`` gives them.
        lamp: The lamp.
        ambient: See ``RenderSettings``.
    """
    direct = passes.radiance * _through_cone(lamp.cone, to_lamp)
    light = lamp.intensity * (direct + ambient * passes.albedo)
    return light.astype(np.float32)


def sees_half_the_lamp(passes: Passes, to_lamp: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Tell where a point faces the lamp and has at least half the light of one without shadow."""
    slope_x, slope_y = np.moveaxis(passes.slope, -1, 0)
    x, y, z = np.moveaxis(to_lamp, -1, 0)
    distance = np.sqrt(x**2 + y**2 + z**2)
    cos_incidence = (
        (z - slope_x * x - slope_y * y) / np.sqrt(1 + slope_x**2 + slope_y**2) / distance
    )
    unshadowed = passes.albedo * cos_incidence / distance**2
    return (unshadowed > 0) & (passes.radiance >= 0.5 * unshadowed)


def _through_cone(cone: SpotCone | None, to_lamp: NDArray[np.float32]) -> NDArray[np.float32]:
    """Give the part of the lamp's intensity that reaches points, 0 where there is none."""
    if cone is None:
        return np.ones(to_lamp.shape[:2], dtype=np.float32)
    cos_off = -to_lamp @ np.asarray(cone.axis_trs, dtype=np.float32)
    cos_off /= np.linalg.norm(to_lamp, axis=-1)
    inner, outer = math.cos(cone.inner_half_angle_rad), math.cos(cone.outer_half_angle_rad)
    if inner == outer:
        return (cos_off >= outer).astype(np.float32)
    step = np.nan_to_num((cos_off - outer) / (inner - outer)).clip(0, 1)
    return step**2 * (3 - 2 * step)
