"""The other pose: from far away a plane looks the same tilted to either side."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.nav.pose.bound import invert_information
from tronlab.nav.pose.correspondences import Correspondences, NoPoseError
from tronlab.nav.pose.projection import jacobian_px, points_in_cam, residuals_px

_MAX_ITERATIONS = 10
_CONVERGED = 1e-5
"""Radians and metres."""
_HOPELESS = 20.0
"""Times the sum of squares that is allowed: no later step makes up for it."""
_N_POINTS = 200
"""So many tell what all would: the views in question have few."""


def other_pose(
    trs_from_cam: RigidTransform,
    matches: Correspondences,
    camera: CameraModel,
    *,
    max_excess_px2: float,
) -> RigidTransform | None:
    """Find the second pose that explains points near a plane, if there is one.

    Of the points only the depth is reversed, about their middle (Schweighofer and Pinz, TPAMI 28,
    2006, section 3); from there least squares goes down into the second minimum.

    Args:
        trs_from_cam: The pose adjusted to the matches.
        matches: The ones that agree with it.
        camera: Intrinsics.
        max_excess_px2: By how much its sum of squared residuals, in parts of ``scale``, may be
            larger, pixels squared.

    Returns:
        The other pose, maybe hardly another one; None if there is none that fits so well.
    """
    step = -(-len(matches) // _N_POINTS)
    some = matches.take(slice(None, None, step))
    limit_px2 = _squared(_residuals(trs_from_cam, some, camera)) + max_excess_px2 / step
    pose = _reversed(trs_from_cam, points_in_cam(trs_from_cam, some))
    for _ in range(_MAX_ITERATIONS):
        if not (points_in_cam(pose, some)[:, 2] > 0).all():
            return None
        residuals = _residuals(pose, some, camera)
        try:
            change, left_px2 = _step(pose, residuals, some, camera)
        except NoPoseError:
            return None
        if left_px2 > _HOPELESS * limit_px2:
            return None
        if np.abs(change).max() < _CONVERGED:
            return pose if _squared(residuals) <= limit_px2 else None
        turned = Rotation.from_rotvec(change[:3]) * pose.rotation
        pose = RigidTransform.from_components(pose.translation + change[3:], turned)
    return None


def _reversed(trs_from_cam: RigidTransform, p_cam: FloatArray) -> RigidTransform:
    """Turn the points so that those of a plane change depth for its reverse, and move no further.

    Reflecting a plane in itself changes nothing; with a second reflection it is a rotation.
    """
    middle = p_cam.mean(axis=0)
    normal = np.linalg.svd(p_cam - middle, full_matrices=False)[2][2]
    turn = _reflection(middle / np.linalg.norm(middle)) @ _reflection(normal)
    new_from_old = RigidTransform.from_components(
        middle - turn @ middle, Rotation.from_matrix(turn)
    )
    return trs_from_cam * new_from_old.inv()


def _reflection(axis: FloatArray) -> FloatArray:
    return np.eye(3) - 2.0 * np.outer(axis, axis)


def _step(
    pose: RigidTransform, residuals: FloatArray, matches: Correspondences, camera: CameraModel
) -> tuple[FloatArray, float]:
    """Give the step of Gauss and Newton, and the sum of squares it should leave."""
    jacobian = (jacobian_px(pose, matches, camera) / matches.scale[:, None, None]).reshape(-1, 6)
    downhill = jacobian.T @ residuals
    change = invert_information(jacobian.T @ jacobian) @ downhill
    return change, _squared(residuals) - float(downhill @ change)


def _residuals(pose: RigidTransform, matches: Correspondences, camera: CameraModel) -> FloatArray:
    return (residuals_px(pose, matches, camera) / matches.scale[:, None]).ravel()


def _squared(residuals: FloatArray) -> float:
    return float(residuals @ residuals)
