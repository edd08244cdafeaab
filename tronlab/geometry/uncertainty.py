"""First-order propagation of pose covariance.

A pose ``a_from_b`` = (R, t) with covariance means R_true = exp([dw]x) R and t_true = t + dt: a
small rotation vector dw and a small translation dt, both in the parent frame a. Covariances are of
(dw, dt), shape (6, 6), rad and metres, rotation first.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.poses import FloatArray, skew


def compose_covariance(
    a_from_b: RigidTransform,
    cov_a_from_b: FloatArray,
    b_from_c: RigidTransform,
    cov_b_from_c: FloatArray,
) -> FloatArray:
    """Give the covariance (6, 6) of ``a_from_b * b_from_c`` for independent errors of the two."""
    r = a_from_b.rotation.as_matrix()
    lever = skew(r @ b_from_c.translation)
    left = np.block([[np.eye(3), np.zeros((3, 3))], [-lever, np.eye(3)]])
    right = np.block([[r, np.zeros((3, 3))], [np.zeros((3, 3)), r]])
    return left @ cov_a_from_b @ left.T + right @ cov_b_from_c @ right.T


def inverse_covariance(a_from_b: RigidTransform, cov_a_from_b: FloatArray) -> FloatArray:
    """Give the covariance (6, 6) of ``a_from_b.inv()``."""
    r_inv = a_from_b.rotation.as_matrix().T
    jacobian = -np.block([[r_inv, np.zeros((3, 3))], [r_inv @ skew(a_from_b.translation), r_inv]])
    return jacobian @ cov_a_from_b @ jacobian.T


def pose_difference(estimate: RigidTransform, truth: RigidTransform) -> FloatArray:
    """Give (dw, dt), shape (6,), that leads from ``estimate`` to ``truth``; rad and metres."""
    dw = (truth.rotation * estimate.rotation.inv()).as_rotvec()
    return np.concatenate([dw, truth.translation - estimate.translation])


def perturb(pose: RigidTransform, difference: FloatArray) -> RigidTransform:
    """Apply (dw, dt), shape (6,), to a pose: the inverse of ``pose_difference``."""
    rotation = Rotation.from_rotvec(difference[:3]) * pose.rotation
    return RigidTransform.from_components(pose.translation + difference[3:], rotation)
