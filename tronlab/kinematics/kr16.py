"""Kinematics of the KUKA KR 16-2: from axes to the flange, and back.

``base`` is the controller's $ROBROOT, ``flange`` the frame tool0 of the public robot description
(ROS-Industrial ``kr16_2``): origin at the centre of the flange, z out of it. Angles are the
controller's own A1 to A6, with its signs and zeros, in radians; at zero the arm is stretched
forward. The rail is no part of this: it carries ``base``.

Third-party facts (lengths, signs, limits, speeds): ROS-Industrial ``kuka_kr16_support``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import LimitError
from tronlab.geometry.poses import FloatArray

AXIS_NAMES: Final = ("A1", "A2", "A3", "A4", "A5", "A6")

Limits: TypeAlias = FloatArray
"""Lowest and highest angle of each axis, shape (6, 2), radians."""

SHOULDER_UP_M: Final = 0.675
SHOULDER_OUT_M: Final = 0.260
UPPER_ARM_M: Final = 0.680
FOREARM_M: Final = 0.670
FOREARM_DROP_M: Final = 0.035
"""The axis of the forearm, A4, passes so far below the elbow, A3, while the arm is stretched."""
FLANGE_OUT_M: Final = 0.158

KR16_LIMITS_RAD: Final[Limits] = np.radians(
    [[-185, 185], [-155, 35], [-130, 154], [-350, 350], [-130, 130], [-350, 350]]
)
KR16_SPEED_RAD_PER_S: Final[FloatArray] = np.radians([156.0, 156, 156, 330, 330, 615])
UPRIGHT_RAD: Final[FloatArray] = np.radians([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
"""Upper arm up, forearm and flange level and ahead: near to how poses in front of it are held."""

SINGULAR_RAD: Final = float(np.radians(1.0))
"""Nearer than this to where an axis is singular is near."""
SINGULAR_M: Final = 0.02
"""A wrist centre nearer than this to the first axis is near."""

_ELBOW_TO_WRIST_M = float(np.hypot(FOREARM_M, FOREARM_DROP_M))
ELBOW_STRETCHED_RAD: Final = -float(np.arctan2(FOREARM_DROP_M, FOREARM_M))
"""A3 where elbow and wrist centre are in line with the upper arm: the arm is stretched."""

_TURN = 2 * np.pi
_FREE = 1e-9
"""Sine of A5, or metres off the first axis, below which an angle is undetermined."""
_ROUNDING_M = 1e-9
"""A wrist centre so far beyond the stretched arm is rounding, not out of reach."""
_LIMIT_ROUNDING_RAD = 1e-9
_UNTURNED = (0.0,) * 6
_AXIS_6_FROM_FLANGE = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""A turn of 90 deg about y."""


@dataclass(frozen=True, slots=True)
class Branch:
    """One of the eight ways to hold the flange in one pose."""

    is_overhead: bool
    """The wrist centre is behind the first axis: the arm reaches back over its own shoulder."""
    is_elbow_up: bool
    """A3 is above the angle at which the arm is stretched."""
    is_wrist_flipped: bool
    """A5 is negative."""

    @classmethod
    def of(cls, axes_rad: ArrayLike) -> "Branch":
        """Tell the branch of axes, shape (6,)."""
        a = np.asarray(axes_rad, dtype=np.float64)
        return cls(
            is_overhead=_wrist_out_m(a) < 0.0,
            is_elbow_up=bool(a[2] > ELBOW_STRETCHED_RAD),
            is_wrist_flipped=bool(a[4] < 0.0),
        )


BRANCHES: Final = tuple(Branch(*flags) for flags in product((False, True), repeat=3))


def forward(axes_rad: ArrayLike) -> RigidTransform:
    """Give ``base_from_flange`` of axes A1 to A6, shape (6,), radians; metres."""
    p_base, hand = _place_and_hand(axes_rad)
    base_from_flange = Rotation.from_matrix(hand @ _AXIS_6_FROM_FLANGE)
    return RigidTransform.from_components(p_base, base_from_flange)


def flange_place_m(axes_rad: ArrayLike) -> FloatArray:
    """Give the origin of the flange in base, shape (3,): as ``forward``, and much faster."""
    return _place_and_hand(axes_rad)[0]


def inverse(
    base_from_flange: RigidTransform, *, near_rad: Sequence[float] | FloatArray = _UNTURNED
) -> dict[Branch, FloatArray]:
    """Give the axes of every branch that reaches a pose, whatever their limits.

    Args:
        base_from_flange: The pose.
        near_rad: Axes that say what to do in singular poses: A1 keeps its angle where the wrist
            centre is on the first axis, A4 where A4 and A6 turn about one line.

    Returns:
        Axes, shape (6,), each from -pi to pi. Branches that meet in a singular pose have equal
        axes, or equal but for the free angle; empty if the pose is out of reach.
    """
    near = np.asarray(near_rad, dtype=np.float64)
    p_wrist = base_from_flange.apply([0.0, 0.0, -FLANGE_OUT_M])
    hand: FloatArray = base_from_flange.rotation.as_matrix() @ _AXIS_6_FROM_FLANGE.T
    solutions: dict[Branch, FloatArray] = {}
    for branch in BRANCHES:
        a1 = _column_rad(p_wrist, branch, near[0])
        arm = _arm_rad(p_wrist, branch)
        if arm is not None:
            wrist = _wrist_rad(hand, (a1, *arm), branch, near[3])
            solutions[branch] = _wrapped(np.array([a1, *arm, *wrist]))
    return solutions


def axes_for(
    base_from_flange: RigidTransform,
    current_rad: Sequence[float] | FloatArray,
    *,
    limits_rad: Limits = KR16_LIMITS_RAD,
    device: str = "robot",
    call: str = "axes_for",
) -> FloatArray:
    """Choose the axes, shape (6,), that reach a pose with the least motion within the limits.

    The least motion is the least sum of squares of the time each axis would take alone, so that
    axes go on from ``current_rad`` without a jump wherever that is possible.

    Args:
        base_from_flange: The pose.
        current_rad: Where the axes stand, shape (6,).
        limits_rad: Lowest and highest angle of each axis.
        device: Name of the device for the error.
        call: Name of the call for the error.

    Raises:
        LimitError: The arm does not reach so far, or only with an axis beyond its limits; the
            message names it.
    """
    current = np.asarray(current_rad, dtype=np.float64)
    solutions = inverse(base_from_flange, near_rad=current)
    if not solutions:
        raise LimitError(f"{call}: {_out_of_reach(base_from_flange)}", device=device)
    reachable = [axes for found in solutions.values() for axes in turned_within(found, limits_rad)]
    if not reachable:
        raise LimitError(f"{call}: {_beyond_limits(solutions, limits_rad)}", device=device)
    return min(reachable, key=lambda axes: _effort(axes, current))


def turned_within(axes_rad: FloatArray, limits_rad: Limits = KR16_LIMITS_RAD) -> list[FloatArray]:
    """Give the same pose with whole turns added to single axes, as far as the limits allow."""
    turns = [
        list(_turns_within(angle, low, high))
        for angle, (low, high) in zip(axes_rad, limits_rad, strict=True)
    ]
    return [np.array(axes) for axes in product(*turns)]


def excesses(axes_rad: ArrayLike, limits_rad: Limits = KR16_LIMITS_RAD) -> list[str]:
    """Say which axes are beyond their limits: name, value and what is allowed."""
    axes = np.asarray(axes_rad, dtype=np.float64)
    return [
        f"{name} is {np.degrees(a):.4f} deg, allowed {np.degrees(low):g} to {np.degrees(high):g}"
        for name, a, (low, high) in zip(AXIS_NAMES, axes, limits_rad, strict=True)
        if not low - _LIMIT_ROUNDING_RAD <= a <= high + _LIMIT_ROUNDING_RAD
    ]


def status_and_turn(axes_rad: ArrayLike) -> tuple[int, int]:
    """Give the controller's S and T: which branch it is, and which axes are negative.

    Of S bit 0 is overhead, bit 1 elbow up, bit 2 A5 not positive; higher bits are not about the
    branch. Of T bit i - 1 is set if axis i is negative.
    """
    a = np.asarray(axes_rad, dtype=np.float64)
    branch = Branch.of(a)
    status = branch.is_overhead | branch.is_elbow_up << 1 | branch.is_wrist_flipped << 2
    turn = sum(1 << i for i, angle in enumerate(a) if angle < 0.0)
    return status, turn


def singularities_near(axes_rad: ArrayLike) -> list[str]:
    """Name the singularities near axes, shape (6,): there a straight motion needs endless speed."""
    a = np.asarray(axes_rad, dtype=np.float64)
    near: list[str] = []
    if abs(np.sin(a[4])) < np.sin(SINGULAR_RAD):
        near.append(f"wrist (A5 is {np.degrees(a[4]):.2f} deg: A4 and A6 turn about one line)")
    if abs(np.sin(a[2] - ELBOW_STRETCHED_RAD)) < np.sin(SINGULAR_RAD):
        near.append(f"elbow (A3 is {np.degrees(a[2]):.2f} deg: the arm is stretched)")
    if abs(_wrist_out_m(a)) < SINGULAR_M:
        near.append("overhead (the wrist centre is above A1)")
    return near


def _place_and_hand(axes_rad: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Give the origin of the flange, shape (3,), and the attitude of A6, shape (3, 3), in base."""
    a1, a2, a3, a4, a5, a6 = np.asarray(axes_rad, dtype=np.float64)
    column = _about_z(-a1)
    forearm = column @ _about_y(a2 + a3)
    hand = forearm @ _about_x(-a4) @ _about_y(a5) @ _about_x(-a6)
    p_base = (
        np.array([0.0, 0.0, SHOULDER_UP_M])
        + column @ np.array([SHOULDER_OUT_M, 0.0, 0.0])
        + column @ _about_y(a2) @ np.array([UPPER_ARM_M, 0.0, 0.0])
        + forearm @ np.array([FOREARM_M, 0.0, -FOREARM_DROP_M])
        + hand @ np.array([FLANGE_OUT_M, 0.0, 0.0])
    )
    return p_base, hand


def _wrist_out_m(axes: FloatArray) -> float:
    """Give how far ahead of the first axis the wrist centre is, in the plane of the arm."""
    forearm = axes[1] + axes[2] - ELBOW_STRETCHED_RAD
    return float(
        SHOULDER_OUT_M + UPPER_ARM_M * np.cos(axes[1]) + _ELBOW_TO_WRIST_M * np.cos(forearm)
    )


def _column_rad(p_wrist: FloatArray, branch: Branch, near_rad: float) -> float:
    if np.hypot(p_wrist[0], p_wrist[1]) < _FREE:
        return near_rad
    ahead = -float(np.arctan2(p_wrist[1], p_wrist[0]))
    return ahead + np.pi if branch.is_overhead else ahead


def _shoulder_to_wrist_m(p_wrist: FloatArray, branch: Branch) -> tuple[float, float]:
    """Give out and up from the shoulder to the wrist centre, in the plane of the arm."""
    out_m = float(np.hypot(p_wrist[0], p_wrist[1]))
    return (-out_m if branch.is_overhead else out_m) - SHOULDER_OUT_M, p_wrist[2] - SHOULDER_UP_M


def _arm_rad(p_wrist: FloatArray, branch: Branch) -> tuple[float, float] | None:
    """Solve the triangle of shoulder, elbow and wrist centre; None if it does not close."""
    out_m, up_m = _shoulder_to_wrist_m(p_wrist, branch)
    distance_m = float(np.hypot(out_m, up_m))
    nearest_m, farthest_m = _span_m()
    if not nearest_m - _ROUNDING_M <= distance_m <= farthest_m + _ROUNDING_M:
        return None
    # Half-angle form: exact where the arm is nearly stretched, unlike the arc cosine.
    bend = 2 * np.arctan2(
        np.sqrt(max(farthest_m**2 - distance_m**2, 0.0)),
        np.sqrt(max(distance_m**2 - nearest_m**2, 0.0)),
    )
    bend = bend if branch.is_elbow_up else -bend
    to_elbow = np.arctan2(
        _ELBOW_TO_WRIST_M * np.sin(bend), UPPER_ARM_M + _ELBOW_TO_WRIST_M * np.cos(bend)
    )
    return float(np.arctan2(-up_m, out_m) - to_elbow), float(bend + ELBOW_STRETCHED_RAD)


def _wrist_rad(
    hand: FloatArray, arm_rad: tuple[float, float, float], branch: Branch, near_rad: float
) -> tuple[float, float, float]:
    """Split the rotation of the hand against the forearm into A4, A5 and A6."""
    a1, a2, a3 = arm_rad
    m = (_about_z(-a1) @ _about_y(a2 + a3)).T @ hand
    sine = float(np.hypot(m[1, 0], m[2, 0]))
    sign = -1.0 if branch.is_wrist_flipped else 1.0
    a5 = sign * float(np.arctan2(sine, m[0, 0]))
    if sine < _FREE:
        a4 = near_rad
        roll = float(np.arctan2(-m[1, 2], m[1, 1]))  # of the hand about the forearm: -(A4 + A6)
        return a4, a5, -roll - a4 if m[0, 0] > 0 else a4 - roll
    a4 = -float(np.arctan2(sign * m[1, 0], -sign * m[2, 0]))
    a6 = -float(np.arctan2(sign * m[0, 1], sign * m[0, 2]))
    return a4, a5, a6


def _about_x(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _about_y(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _about_z(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _span_m() -> tuple[float, float]:
    return abs(UPPER_ARM_M - _ELBOW_TO_WRIST_M), UPPER_ARM_M + _ELBOW_TO_WRIST_M


def _wrapped(axes: FloatArray) -> FloatArray:
    return axes - _TURN * np.round(axes / _TURN)


def _turns_within(angle: float, low: float, high: float) -> Iterator[float]:
    first = int(np.ceil((low - _LIMIT_ROUNDING_RAD - angle) / _TURN))
    last = int(np.floor((high + _LIMIT_ROUNDING_RAD - angle) / _TURN))
    for turns in range(first, last + 1):
        yield angle + turns * _TURN


def _effort(axes: FloatArray, current: FloatArray) -> float:
    return float(np.sum(((axes - current) / KR16_SPEED_RAD_PER_S) ** 2))


def _out_of_reach(base_from_flange: RigidTransform) -> str:
    p_wrist = base_from_flange.apply([0.0, 0.0, -FLANGE_OUT_M])
    out_m, up_m = _shoulder_to_wrist_m(p_wrist, BRANCHES[0])
    nearest_m, farthest_m = _span_m()
    return (
        f"out of reach: the wrist centre is {np.hypot(out_m, up_m):.4f} m from the shoulder,"
        f" allowed {nearest_m:.4f} to {farthest_m:.4f} m; choose poses nearer to the robot"
    )


def _beyond_limits(solutions: dict[Branch, FloatArray], limits: Limits) -> str:
    nearest = min(solutions.values(), key=lambda axes: _excess_rad(axes, limits))
    return (
        f"no branch is within the limits of the axes; in the nearest"
        f" {'; '.join(excesses(nearest, limits))} deg; choose another pose or turn of the flange"
    )


def _excess_rad(axes: FloatArray, limits: Limits) -> float:
    beyond = np.maximum(limits[:, 0] - axes, axes - limits[:, 1])
    return float(np.sum(np.maximum(beyond, 0.0)))
