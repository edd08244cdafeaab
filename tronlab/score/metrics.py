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
