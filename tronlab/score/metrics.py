"""The errors of one navigation solution."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.poses import FloatArray, rotation_angle_rad


@dataclass(frozen=True, slots=True)
class PoseErrors:
    """How far an estimated camera pose is from the true one.

    Vectors follow the paper (section 4.1): the real vector minus the navigation solution.
    """

    error_trs_m: FloatArray
    """Real minus estimated camera position, shape (3,), in trs."""
    error_cam_m: FloatArray
    """The same vector in the true camera frame, shape (3,)."""
    axis_errors_rad: FloatArray
    """Angle between the true and the estimated camera axis x, y and z, shape (3,)."""
    rotation_error_rad: float
    """Angle of the rotation between the two."""

    @property
    def position_error_m(self) -> float:
        """Get the distance between the true and the estimated camera position."""
        return float(np.linalg.norm(self.error_trs_m))


def pose_errors(estimate: RigidTransform, truth: RigidTransform) -> PoseErrors:
    """Compare two ``trs_from_cam``."""
    error_trs_m = truth.translation - estimate.translation
    axes_true = truth.rotation.as_matrix().T
    axes_estimated = estimate.rotation.as_matrix().T
    # The sine and the cosine together keep angles of microradians exact.
    sines = np.linalg.norm(np.cross(axes_true, axes_estimated), axis=1)
    cosines = (axes_true * axes_estimated).sum(axis=1)
    return PoseErrors(
        error_trs_m=error_trs_m,
        error_cam_m=axes_true @ error_trs_m,
        axis_errors_rad=np.arctan2(sines, cosines),
        rotation_error_rad=rotation_angle_rad(estimate, truth),
    )


def position_sigma_m(covariance: FloatArray | None) -> float:
    """Give the root of the trace of a pose covariance's position part: one sigma of the distance.

    Args:
        covariance: Of (rotation vector, translation), shape (6, 6), rad and m; None if not known.

    Returns:
        Metres; NaN if it is not known, or the variances do not add up to a positive number.
    """
    trace = np.nan if covariance is None else float(np.trace(np.asarray(covariance)[3:, 3:]))
    return float(np.sqrt(trace)) if trace >= 0.0 else np.nan


def position_nees(
    error_trs_m: FloatArray, covariance: FloatArray | None, truth_covariance: FloatArray
) -> float:
    """Give the normalised estimation error squared of a position.

    With honest covariances its mean is 3, and it follows chi-square with 3 degrees of freedom:
    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001),
    section 5.4.2. The error is of estimate and truth together, hence the sum of the two.

    Args:
        error_trs_m: Real minus estimated position, shape (3,), in trs.
        covariance: What the core states, shape (6, 6), rad and m; None if it states nothing.
        truth_covariance: Of the truth, shape (6, 6).

    Returns:
        NaN if one is not known, or their sum is not positive definite.
    """
    if covariance is None:
        return np.nan
    total = np.asarray(covariance)[3:, 3:] + truth_covariance[3:, 3:]
    try:
        whitened = np.linalg.solve(np.linalg.cholesky(total), error_trs_m)
    except np.linalg.LinAlgError:
        return np.nan
    return float(whitened @ whitened)
