"""How well a laser tracker measures by its data sheet, which no reading can show by itself."""

import numpy as np

from tronlab.devices.laboratory import NotNegative
from tronlab.geometry.poses import FloatArray
from tronlab.yaml_models import Model


class StatedAccuracy(Model):
    """Stated accuracy of points and T-MAC, as one sigma of a stationary measurement.

    It covers air, levelling and the target's own calibration: errors that stay the same while a
    target is looked at, so that a longer window does not average them away. The default takes the
    largest permissible error of Leica's data sheets, 15 um + 6 um/m, as one sigma; typical errors
    are half of it.
    """

    coordinate_sigma_m: NotNegative = 15e-6
    """Of each coordinate, at no distance; points and T-MAC alike."""
    coordinate_sigma_m_per_m: NotNegative = 6e-6
    """Added per metre of distance."""
    rotation_sigma_deg: NotNegative = 0.01
    """Of the T-MAC's rotation in all: each component of the rotation vector has 1/sqrt(3) of it."""

    def point_covariance(self, p_trk_m: FloatArray) -> FloatArray:
        """Give the covariance of a point there, shape (3, 3), m2.

        Args:
            p_trk_m: Shape (3,), frame trk.
        """
        distance_m = float(np.linalg.norm(p_trk_m))
        sigma_m = self.coordinate_sigma_m + self.coordinate_sigma_m_per_m * distance_m
        return sigma_m**2 * np.eye(3)

    def pose_covariance(self, p_trk_m: FloatArray) -> FloatArray:
        """Give the covariance of (rotation vector, translation) of a T-MAC there, shape (6, 6)."""
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = np.radians(self.rotation_sigma_deg) ** 2 / 3.0 * np.eye(3)
        covariance[3:, 3:] = self.point_covariance(p_trk_m)
        return covariance
