"""How results are given to a client: its place of the tracker, coordinate system and units.

Not stated by the header, and assumed here: the rotation parameters of station orientation and
transformation turn about the fixed X, then Y, then Z axis; a transformation gives the pose of the
client's system in that of the oriented station, and its scale multiplies the coordinates. Cylinder
coordinates are angle, radius, height; spherical ones Hz, Vt (from Z), distance. Clockwise angles
count from +Y, as those of the commands that end in HVD; counter-clockwise ones from +X.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import acos, atan2, cos, hypot, sin
from typing import Final

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from drivers.leica.simulator.units import Units
from tronlab.geometry.poses import FloatArray

N_COORDINATE_SYSTEMS: Final = 8
_FLIPS: Final = ((1, 1, 1), (-1, 1, 1), (1, -1, 1), (1, 1, -1))
"""Signs of the Cartesian systems: right-handed, and left-handed with X, Y or Z flipped."""
_CYLINDERS: Final = (4, 5)
_CLOCKWISE: Final = (4, 6)
_IS_ANGLE: Final = {
    **dict.fromkeys((4, 5), (True, False, False)),
    **dict.fromkeys((6, 7), (True, True, False)),
}


def rigid(parameters: Sequence[float]) -> RigidTransform:
    """Make the pose that three translations (m) and three rotations (rad) say."""
    return RigidTransform.from_components(
        parameters[:3], Rotation.from_euler("xyz", parameters[3:6])
    )


def hvd_of(p: FloatArray) -> tuple[float, float, float]:
    """Give Hz (clockwise from +Y), Vt (from +Z) and distance of a point, rad and m."""
    distance = float(np.linalg.norm(p))
    vt = acos(max(-1.0, min(1.0, p[2] / distance))) if distance > 0.0 else 0.0
    return atan2(p[0], p[1]), vt, distance


def point_of_hvd(hz: float, vt: float, distance: float) -> FloatArray:
    """Give the point, the inverse of ``hvd_of``."""
    return distance * np.array([sin(vt) * sin(hz), sin(vt) * cos(hz), cos(vt)])


@dataclass(frozen=True)
class Presentation:
    """The client's way to see coordinates.

    Args:
        units: Of everything.
        coordinate_system: By the header, 0 to 7.
        user_from_trk: Station and transformation, as far as the client wants them applied.
        scale: Of the transformation.
    """

    units: Units
    coordinate_system: int
    user_from_trk: RigidTransform
    scale: float

    def point(self, p_trk: FloatArray) -> FloatArray:
        """Give a point (3,), frame trk, metres, in the client's coordinates and units."""
        return self._coordinates(p_trk) / self._units_si

    def point_trk(self, values: Sequence[float]) -> FloatArray:
        """Give a point of the client in frame trk, metres; the inverse of ``point``."""
        p_user = self._cartesian(np.array(values) * self._units_si) / self.scale
        return self.user_from_trk.inv().apply(p_user)

    def covariance(self, p_trk: FloatArray, covariance_m2: FloatArray) -> FloatArray:
        """Give the covariance (3, 3) of ``point``, in products of its units."""
        jacobian = self._jacobian(p_trk) / self._units_si[:, None]
        return jacobian @ covariance_m2 @ jacobian.T

    def rotation(self, trk_from_body: Rotation) -> Rotation:
        """Give a rotation in the client's system, before any axis is flipped."""
        return self.user_from_trk.rotation * trk_from_body

    def rotation_covariance(self, covariance_rad2: FloatArray) -> FloatArray:
        """Give the covariance (3, 3) of rotations about the client's axes, squared angle units."""
        r, _ = self._rotation_and_offset
        return r @ covariance_rad2 @ r.T / self.units.rad_per_angle**2

    @cached_property
    def _rotation_and_offset(self) -> tuple[FloatArray, FloatArray]:
        return self.user_from_trk.rotation.as_matrix(), self.user_from_trk.translation

    @cached_property
    def _units_si(self) -> FloatArray:
        is_angle = _IS_ANGLE.get(self.coordinate_system, (False, False, False))
        return np.where(is_angle, self.units.rad_per_angle, self.units.m_per_length)

    def _jacobian(self, p_trk: FloatArray) -> FloatArray:
        """Give the derivative (3, 3) of coordinates in metres and radians by ``p_trk``."""
        r, offset = self._rotation_and_offset
        kind = self.coordinate_system
        if kind < len(_FLIPS):
            return self.scale * np.array(_FLIPS[kind])[:, None] * r
        x, y, z = self.scale * (r @ p_trk + offset)
        radius, distance = hypot(x, y), hypot(x, y, z)
        turn = np.array([-y, x, 0.0]) / radius**2
        angle = -turn if kind in _CLOCKWISE else turn
        outward = np.array([x, y, 0.0]) / radius
        if kind in _CYLINDERS:
            rows = [angle, outward, np.array([0.0, 0.0, 1.0])]
        else:
            radial = np.array([x, y, z]) / distance
            rows = [angle, (z * outward - [0.0, 0.0, radius]) / distance**2, radial]
        return self.scale * np.array(rows) @ r

    def _coordinates(self, p_trk: FloatArray) -> FloatArray:
        """Give the client's coordinates in metres and radians."""
        r, offset = self._rotation_and_offset
        p = self.scale * (r @ p_trk + offset)
        kind = self.coordinate_system
        if kind < len(_FLIPS):
            return p * _FLIPS[kind]
        angle = atan2(p[0], p[1]) if kind in _CLOCKWISE else atan2(p[1], p[0])
        if kind in _CYLINDERS:
            return np.array([angle, hypot(p[0], p[1]), p[2]])
        return np.array([angle, *hvd_of(p)[1:]])

    def _cartesian(self, coordinates: FloatArray) -> FloatArray:
        kind = self.coordinate_system
        if kind < len(_FLIPS):
            return coordinates * _FLIPS[kind]
        angle, second, third = coordinates
        radius, height = (
            (second, third) if kind in _CYLINDERS else (third * sin(second), third * cos(second))
        )
        if kind in _CLOCKWISE:
            return np.array([radius * sin(angle), radius * cos(angle), height])
        return np.array([radius * cos(angle), radius * sin(angle), height])
