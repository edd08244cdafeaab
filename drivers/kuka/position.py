"""Where the robot stands, as the controller says it: axes, and Cartesian with angles A, B, C.

Inside, everything is in metres and radians; degrees and millimetres, the controller's units, are
in the names of what converts.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.poses import FloatArray
from tronlab.kinematics.kr16 import AXIS_NAMES

_GIMBAL = 1e-12
"""Cosine of B below which A and C cannot be told apart."""


@dataclass(frozen=True, slots=True)
class Axes:
    """The six axes of the arm, and the rail as the external axis E1 of the controller."""

    arm_rad: tuple[float, ...]
    """A1 to A6."""
    e1_m: float
    """The controller's own count; ``rail_m`` follows from it by the rail's zero and sign."""

    @classmethod
    def from_controller(cls, arm_deg: Sequence[float], e1_mm: float) -> "Axes":
        """Make them from the controller's degrees and millimetres."""
        return cls(tuple(float(a) for a in np.radians(arm_deg)), e1_mm * 1e-3)

    @property
    def arm_deg(self) -> tuple[float, ...]:
        """Get A1 to A6 in degrees."""
        return tuple(float(a) for a in np.degrees(self.arm_rad))

    @property
    def e1_mm(self) -> float:
        """Get E1 in millimetres."""
        return self.e1_m * 1e3

    def __str__(self) -> str:
        """Give them in degrees and millimetres."""
        arm = ", ".join(f"{n} {a:.4f}" for n, a in zip(AXIS_NAMES, self.arm_deg, strict=True))
        return f"{arm} deg, E1 {self.e1_mm:.3f} mm"


def abc_deg_from_rotation(rotation: Rotation) -> tuple[float, float, float]:
    """Give the angles A, B, C with R = Rz(A) Ry(B) Rx(C), degrees.

    Where B is 90 or -90 deg only A - C or A + C is determined: C is 0 then, but for rounding. B and
    C are those of what is left when A is undone: nearby, where A is badly determined, they make up
    for its error.
    """
    r: FloatArray = rotation.as_matrix()
    is_locked = np.hypot(r[0, 0], r[1, 0]) < _GIMBAL
    a = np.arctan2(-r[0, 1], r[1, 1]) if is_locked else np.arctan2(r[1, 0], r[0, 0])
    cos_a, sin_a = np.cos(a), np.sin(a)
    b = np.arctan2(-r[2, 0], cos_a * r[0, 0] + sin_a * r[1, 0])
    c = np.arctan2(sin_a * r[0, 2] - cos_a * r[1, 2], cos_a * r[1, 1] - sin_a * r[0, 1])
    return float(np.degrees(a)), float(np.degrees(b)), float(np.degrees(c))


def rotation_from_abc_deg(abc_deg: ArrayLike) -> Rotation:
    """Give the rotation Rz(A) Ry(B) Rx(C)."""
    return Rotation.from_euler("ZYX", np.asarray(abc_deg, dtype=np.float64), degrees=True)


def xyz_mm_abc_deg(base_from_flange: RigidTransform) -> tuple[float, ...]:
    """Give a pose as the controller writes it: X, Y, Z, A, B, C."""
    xyz_mm = (float(v) * 1e3 for v in base_from_flange.translation)
    return (*xyz_mm, *abc_deg_from_rotation(base_from_flange.rotation))


def pose_from_xyz_mm_abc_deg(values: Sequence[float]) -> RigidTransform:
    """Read a pose the controller wrote as X, Y, Z, A, B, C."""
    xyz_m = np.asarray(values[:3], dtype=np.float64) * 1e-3
    return RigidTransform.from_components(xyz_m, rotation_from_abc_deg(values[3:]))
