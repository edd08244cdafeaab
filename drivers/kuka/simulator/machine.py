"""The robot's machine data, and its arm as the controller computes it.

Forward kinematics here is a product of exponentials from the public robot description
(ROS-Industrial ``kr16_2``), written apart from the driver's chain of links, so that a mistake in
one of them shows.
The inverse is the driver's.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from drivers.kuka.simulator.command import FREE, CartesianPosition
from tronlab.geometry.poses import FloatArray
from tronlab.kinematics import kr16

N_ARM: Final = 6
RAIL: Final = 6
"""Index of E1 among the axes."""

HOME: Final[FloatArray] = np.array([0.0, -90.0, 90.0, 0.0, 90.0, 0.0, 0.0])
ENCODER_STEP_MM: Final = 1e-4

_DIRECTIONS = np.array(
    [[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]], dtype=np.float64
)
"""Of each axis at zero, where the arm is stretched forward, in the frame of the base."""
_POINTS_M = np.array(
    [
        [0.0, 0.0, 0.675],
        [0.260, 0.0, 0.675],
        [0.940, 0.0, 0.675],
        [1.610, 0.0, 0.640],
        [1.610, 0.0, 0.640],
        [1.610, 0.0, 0.640],
    ]
)
"""A point on each axis at zero."""
_BASE_FROM_FLANGE_AT_ZERO = RigidTransform.from_components(
    [1.768, 0.0, 0.640], Rotation.from_euler("y", 90, degrees=True)
)


@dataclass(frozen=True)
class Machine:
    """What machine data say of a robot; by default a KR 16 on a rail of 11 m."""

    model: str = "#KR16 C2 FLR ZH16"
    serial: str = "830123"
    lowest_deg: tuple[float, ...] = (-185.0, -155.0, -130.0, -350.0, -130.0, -350.0)
    highest_deg: tuple[float, ...] = (185.0, 35.0, 154.0, 350.0, 130.0, 350.0)
    rail_range_mm: tuple[float, float] = (0.0, 11000.0)
    rail_zero_mm: float = 0.0
    """E1 where the laboratory counts 0 m."""
    rail_sign: int = 1
    """-1 if E1 counts down where the laboratory counts up."""
    axis_speed_deg_per_s: tuple[float, ...] = (156.0, 156.0, 156.0, 330.0, 330.0, 615.0)
    axis_ramp_s: float = 0.3
    """How long an axis takes to its full speed."""
    rail_speed_mm_per_s: float = 1000.0
    rail_acceleration_mm_per_s2: float = 500.0
    path_speed_mm_per_s: float = 2000.0
    path_acceleration_mm_per_s2: float = 2300.0
    path_turn_deg_per_s: float = 200.0

    def faster(self, factor: float) -> "Machine":
        """Give a robot that does every move in so much less time."""
        return replace(
            self,
            axis_speed_deg_per_s=tuple(factor * speed for speed in self.axis_speed_deg_per_s),
            axis_ramp_s=self.axis_ramp_s / factor,
            rail_speed_mm_per_s=self.rail_speed_mm_per_s * factor,
            rail_acceleration_mm_per_s2=self.rail_acceleration_mm_per_s2 * factor**2,
            path_speed_mm_per_s=self.path_speed_mm_per_s * factor,
            path_acceleration_mm_per_s2=self.path_acceleration_mm_per_s2 * factor**2,
            path_turn_deg_per_s=self.path_turn_deg_per_s * factor,
        )

    @property
    def lowest(self) -> FloatArray:
        """Get the lower software limits, shape (7,)."""
        return np.array([*self.lowest_deg, self.rail_range_mm[0]])

    @property
    def highest(self) -> FloatArray:
        """Get the upper software limits, shape (7,)."""
        return np.array([*self.highest_deg, self.rail_range_mm[1]])

    @property
    def speeds(self) -> FloatArray:
        """Get the highest speeds, shape (7,), degrees or mm per second."""
        return np.array([*self.axis_speed_deg_per_s, self.rail_speed_mm_per_s])

    @property
    def accelerations(self) -> FloatArray:
        """Get the highest accelerations, shape (7,), degrees or mm per second squared."""
        arm = np.array(self.axis_speed_deg_per_s) / self.axis_ramp_s
        return np.array([*arm, self.rail_acceleration_mm_per_s2])

    def is_allowed(self, axes: FloatArray) -> NDArray[np.bool_]:
        """Tell of each axis, shape (7,), whether it is within its limits."""
        return (self.lowest <= axes) & (axes <= self.highest)

    def rail_m(self, e1_mm: float) -> float:
        """Give where on the rail E1 is."""
        return self.rail_sign * (e1_mm - self.rail_zero_mm) / 1000.0

    def e1_mm(self, rail_m: float) -> float:
        """Give E1 of a place on the rail."""
        return self.rail_zero_mm + self.rail_sign * rail_m * 1000.0


KR16: Final = Machine()


def flange_of(axes: FloatArray) -> RigidTransform:
    """Give ``base_from_flange``, metres, of axes, shape (7,) or (6,), degrees."""
    turns = Rotation.from_rotvec(_DIRECTIONS * np.radians(axes[:N_ARM])[:, np.newaxis])
    offsets = _POINTS_M - turns.apply(_POINTS_M)
    pose = _BASE_FROM_FLANGE_AT_ZERO
    for i in reversed(range(N_ARM)):
        pose = RigidTransform.from_components(offsets[i], turns[i]) * pose
    return pose


def position_of(axes: FloatArray) -> CartesianPosition:
    """Give the position of axes, shape (7,), as the controller writes it."""
    pose = flange_of(axes)
    x, y, z = (float(v) for v in pose.translation * 1e3)
    a, b, c = _abc_deg(pose.rotation)
    status, turn = kr16.status_and_turn(np.radians(axes[:N_ARM]))
    return CartesianPosition(x, y, z, a, b, c, status, turn, float(axes[RAIL]))


def flange_at(position: CartesianPosition) -> RigidTransform:
    """Give ``base_from_flange``, metres, of a position: rotation Rz(A) Ry(B) Rx(C)."""
    p = position
    turn = Rotation.from_euler("ZYX", [p.a_deg, p.b_deg, p.c_deg], degrees=True)
    return RigidTransform.from_components(np.array([p.x_mm, p.y_mm, p.z_mm]) * 1e-3, turn)


def axes_at(
    base_from_flange: RigidTransform,
    near: FloatArray,
    machine: Machine,
    *,
    status: int = FREE,
    turn: int = FREE,
) -> FloatArray | None:
    """Give the arm's axes that hold the flange in a pose, the nearest of those asked for.

    Args:
        base_from_flange: The pose, metres.
        near: Axes it shall be near to, shape (6,) or (7,), degrees.
        machine: Whose limits count.
        status: S: the branch; its lowest three bits count.
        turn: T: the signs of the axes.

    Returns:
        Axes, shape (6,), degrees; None if there are none.
    """
    near_rad = np.radians(near[:N_ARM])
    limits = np.radians(np.stack([machine.lowest_deg, machine.highest_deg], axis=1))
    found = [
        axes
        for branch in kr16.inverse(base_from_flange, near_rad=near_rad).values()
        for axes in kr16.turned_within(branch, limits)
        if _is_asked_for(axes, status, turn)
    ]
    if not found:
        return None
    return np.degrees(min(found, key=lambda axes: float(np.abs(axes - near_rad).max())))


def has_axes(base_from_flange: RigidTransform) -> bool:
    """Look whether the arm is long enough for a pose, whatever the limits of its axes."""
    return bool(kr16.inverse(base_from_flange))


def _is_asked_for(axes_rad: FloatArray, status: int, turn: int) -> bool:
    found_status, found_turn = kr16.status_and_turn(axes_rad)
    return status in (FREE, found_status) and turn in (FREE, found_turn)


def _abc_deg(rotation: Rotation) -> tuple[float, float, float]:
    """Split a rotation into A, B, C.

    B and C are taken from what is left once A is undone, so that the three make up the rotation
    even where B is nearly ±90 deg and A alone means little.
    """
    r: FloatArray = rotation.as_matrix()
    a = np.arctan2(r[1, 0], r[0, 0])
    sine, cosine = np.sin(a), np.cos(a)
    b = np.arctan2(-r[2, 0], cosine * r[0, 0] + sine * r[1, 0])
    c = np.arctan2(sine * r[0, 2] - cosine * r[1, 2], cosine * r[1, 1] - sine * r[0, 1])
    return float(np.degrees(a)), float(np.degrees(b)), float(np.degrees(c))
