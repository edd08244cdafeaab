"""Where a camera sees points, and how that changes with its pose."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel, distortion_jacobian
from tronlab.geometry.poses import FloatArray
from tronlab.nav.pose.correspondences import Correspondences

RAYLEIGH_MEDIAN = 1.1774100225154747
"""Median length of a vector of two standard normal coordinates."""
MIN_SIGMA_PX = 1e-6
_N_PARAMETERS = 6


def residuals_px(
    trs_from_cam: RigidTransform, matches: Correspondences, camera: CameraModel
) -> FloatArray:
    """Give observed minus projected position, shape (n, 2), pixels; NaN behind the camera."""
    return matches.uv - camera.project(points_in_cam(trs_from_cam, matches))


def jacobian_px(
    trs_from_cam: RigidTransform, matches: Correspondences, camera: CameraModel
) -> FloatArray:
    """Give d(projected uv)/d(rotation vector, translation), shape (n, 2, 6), px per rad and m.

    The perturbation is that of ``geometry.uncertainty``: a left rotation in trs, and a translation.
    The last three columns are minus d(projected uv)/d(point in trs).
    """
    arm_m = matches.p_trs_m - trs_from_cam.translation
    return jacobian_of_arms_px(arm_m, trs_from_cam.rotation.as_matrix(), camera)


def jacobian_of_arms_px(arm_m: FloatArray, rotation: FloatArray, camera: CameraModel) -> FloatArray:
    """Do what ``jacobian_px`` does, for the vectors from camera to point.

    Args:
        arm_m: In trs, shape (n, 3), metres.
        rotation: Of ``trs_from_cam``, shape (3, 3).
        camera: Intrinsics.
    """
    p_cam = arm_m @ rotation
    z = p_cam[:, 2]
    rays = p_cam[:, :2] / z[:, None]
    x, y = rays.T
    focal_px = np.array([[camera.fx_px], [camera.fy_px]])
    by_x, by_y = focal_px * distortion_jacobian(rays, camera.distortion).T
    # Of u and v: towards the camera's centre, as 1 / z of it moves the image.
    inward = by_x * x + by_y * y
    by_turn = [by_y + inward * y, -by_x - inward * x, by_x * y - by_y * x]
    by_shift = [-by_x / z, -by_y / z, inward / z]
    by_motion_in_cam = np.array([by_turn, by_shift]).reshape(2, 3, -1)
    return (rotation @ by_motion_in_cam).reshape(_N_PARAMETERS, 2, -1).T


def points_in_cam(trs_from_cam: RigidTransform, matches: Correspondences) -> FloatArray:
    """Give the matched points in cam, shape (n, 3), metres."""
    return (matches.p_trs_m - trs_from_cam.translation) @ trs_from_cam.rotation.as_matrix()
