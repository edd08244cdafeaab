"""How good a pose any unbiased estimate can find: the Cramer-Rao bound."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.nav.pose.correspondences import Correspondences, NoPoseError
from tronlab.nav.pose.projection import jacobian_px

_MAX_CONDITION = 1e12


def cramer_rao_bound(
    trs_from_cam: RigidTransform,
    matches: Correspondences,
    camera: CameraModel,
    *,
    sigma_px: float,
    landmark_covariance_m2: FloatArray | None = None,
) -> FloatArray:
    """Give the least covariance an unbiased estimate from these matches can have.

    The inverse of the Fisher information ``sum J^T S^-1 J`` for independent Gaussian noise (Hartley
    and Zisserman, Multiple View Geometry, 2nd ed., ch. 5), where ``S`` is that of the image
    position plus that of the landmark, projected.

    Args:
        trs_from_cam: The pose.
        matches: Right ones only.
        camera: Intrinsics.
        sigma_px: Standard deviation of one coordinate of a position with ``scale`` 1.
        landmark_covariance_m2: Of each landmark, or one for all, shape (n, 3, 3) or (3, 3), square
            metres in trs, independent of each other; None: the landmarks are exact.

    Returns:
        Covariance of (rotation vector, translation) in trs, shape (6, 6), rad and m.

    Raises:
        NoPoseError: The matches do not determine the pose.
    """
    jacobian = jacobian_px(trs_from_cam, matches, camera)
    if landmark_covariance_m2 is None:
        weighted = jacobian / (sigma_px * matches.scale[:, None, None])
        return invert_information(np.einsum("nij,nik->jk", weighted, weighted))
    by_point = jacobian[:, :, 3:]
    noise = (sigma_px * matches.scale[:, None, None]) ** 2 * np.eye(2)
    noise = noise + by_point @ landmark_covariance_m2 @ by_point.swapaxes(1, 2)
    return invert_information(np.einsum("nij,nik->jk", jacobian, np.linalg.solve(noise, jacobian)))


def invert_information(information: FloatArray) -> FloatArray:
    """Invert an information matrix (6, 6) of mixed units.

    Raises:
        NoPoseError: It is singular.
    """
    size = np.sqrt(np.diag(information))
    if not (np.isfinite(information).all() and size.min() > 0):
        raise NoPoseError("the matches do not determine the pose")
    scaled = information / np.outer(size, size)
    eigenvalues = np.linalg.eigvalsh(scaled)
    if eigenvalues[-1] > _MAX_CONDITION * eigenvalues[0]:
        raise NoPoseError("the matches do not determine the pose: the points are degenerate")
    return np.linalg.inv(scaled) / np.outer(size, size)
