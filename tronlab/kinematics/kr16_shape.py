"""The space a KR 16-2 takes up: its links as capsules, which move with the axes.

Each capsule holds all of its link in the public collision meshes of ROS-Industrial
``kuka_kr16_support`` (measured on their surfaces), and about a centimetre more. Cables and hoses
along the arm are not in those meshes: give the envelope more clearance for them.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from tronlab.geometry.poses import FloatArray
from tronlab.kinematics.kr16 import (
    FLANGE_OUT_M,
    FOREARM_DROP_M,
    FOREARM_M,
    SHOULDER_OUT_M,
    SHOULDER_UP_M,
    UPPER_ARM_M,
)

COLUMN, UPPER_ARM, FOREARM, WRIST, HAND = range(5)
"""Places of the links among the capsules, from the base to the flange."""
LINK_NAMES: Final = ("column", "upper arm", "forearm", "wrist", "hand")

_ENDS_M: Final[FloatArray] = np.array(
    [
        [[0.0, 0.0, -0.22], [0.18, 0.04, -0.05]],
        [[0.0, -0.165, 0.0], [0.664, -0.192, 0.0]],
        [[-0.256, 0.051, -0.009], [0.274, 0.035, 0.008]],
        [[-0.246, 0.0, 0.0], [-0.004, 0.021, 0.008]],
        [[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]],
    ]
)
"""Of the capsules' axes in the frames of their links, shape (links, 2, 3): origins where A1 and A2
cross in the drawing, at A2, at A3, and at the wrist centre; at zero parallel to the base."""
LINK_RADII_M: Final[FloatArray] = np.array([0.29, 0.135, 0.20, 0.091, 0.125])

BASE_LOW_M: Final[FloatArray] = np.array([-0.41, -0.28, 0.0])
BASE_HIGH_M: Final[FloatArray] = np.array([0.29, 0.28, 0.40])
"""The foot of the robot, which does not turn: a box in the frame of the base."""


@dataclass(frozen=True, slots=True)
class ArmShape:
    """Where the links are, for a stack of axes."""

    ends_base_m: FloatArray
    """Ends of the capsules' axes, shape (n, links, 2, 3), frame base."""
    flange_rotation: FloatArray
    """Of ``base_from_flange``, shape (n, 3, 3)."""
    p_flange_base_m: FloatArray
    """Origin of the flange, shape (n, 3), frame base."""


def arm_shape(axes_rad: FloatArray) -> ArmShape:
    """Place the links of an arm whose axes are A1 to A6, shape (n, 6), radians."""
    a1, a2, a3, a4, a5, a6 = axes_rad.T
    column = _about(2, -a1)
    upper_arm = column @ _about(1, a2)
    forearm = column @ _about(1, a2 + a3)
    wrist = forearm @ _about(0, -a4)
    hand = wrist @ _about(1, a5)
    p_axis_1 = np.broadcast_to([0.0, 0.0, SHOULDER_UP_M], (len(axes_rad), 3))
    p_shoulder = p_axis_1 + column @ [SHOULDER_OUT_M, 0.0, 0.0]
    p_elbow = p_shoulder + upper_arm @ [UPPER_ARM_M, 0.0, 0.0]
    p_wrist = p_elbow + forearm @ [FOREARM_M, 0.0, -FOREARM_DROP_M]
    frames = np.stack([column, upper_arm, forearm, wrist, hand], axis=1)
    origins = np.stack([p_axis_1, p_shoulder, p_elbow, p_wrist, p_wrist], axis=1)
    tool = hand @ _about(0, -a6)
    return ArmShape(
        ends_base_m=origins[:, :, np.newaxis] + np.einsum("nlij,lej->nlei", frames, _ENDS_M),
        flange_rotation=np.stack([-tool[..., 2], tool[..., 1], tool[..., 0]], axis=-1),
        p_flange_base_m=p_wrist + hand @ [FLANGE_OUT_M, 0.0, 0.0],
    )


def levers_m(payload_m: float) -> FloatArray:
    """Bound how far each body reaches from each axis that moves it.

    Args:
        payload_m: How far the payload reaches from the wrist centre.

    Returns:
        Shape (links + 1, 6), the payload last; 0 where the axis does not move the body. Times the
        turn of the axis that is how far any point of the body moves at most.
    """
    reach_m = np.append(np.linalg.norm(_ENDS_M, axis=-1).max(axis=-1) + LINK_RADII_M, payload_m)
    # Along the chain, how far the origins of the bodies' frames are from that of A1.
    forearm_m = float(np.hypot(FOREARM_M, FOREARM_DROP_M))
    at_m = np.cumsum([0.0, SHOULDER_OUT_M, UPPER_ARM_M, forearm_m, 0.0, 0.0])
    return np.tril(reach_m[:, np.newaxis] + at_m[:, np.newaxis] - at_m)


def _about(axis: int, angle_rad: FloatArray) -> FloatArray:
    """Give rotations about x, y or z, shape (n, 3, 3)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.zeros((len(angle_rad), 3, 3))
    rotation[:, axis, axis] = 1.0
    rotation[:, i, i] = rotation[:, j, j] = c
    rotation[:, i, j], rotation[:, j, i] = -s, s
    return rotation
