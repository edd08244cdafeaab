"""Straight motions of the flange: followed in small steps before the controller does them."""

from typing import Final

import numpy as np
from scipy.spatial.transform import RigidTransform, Slerp

from tronlab.errors import LimitError
from tronlab.geometry.poses import FloatArray
from tronlab.kinematics.kr16 import (
    AXIS_NAMES,
    Branch,
    Limits,
    excesses,
    forward,
    inverse,
    singularities_near,
)

_N_STEPS: Final = 50
_LARGEST_STEP_RAD: Final = float(np.radians(45.0))
"""An axis that turns farther between two steps has passed a singularity between them."""


def follow_line(
    start_rad: FloatArray,
    base_from_flange: RigidTransform,
    *,
    limits_rad: Limits,
    device: str,
    call: str,
) -> FloatArray:
    """Give the axes, shape (6,), at the end of a straight motion that stays in its branch.

    Args:
        start_rad: Axes at its start, shape (6,).
        base_from_flange: The pose at its end.
        limits_rad: Lowest and highest angle of each axis.
        device: Name of the device for errors.
        call: Name of the call for errors.

    Raises:
        LimitError: On the way the arm does not reach, an axis leaves its limits, or the motion
            comes near a singularity; the message says where and which.
    """
    start = forward(start_rad)
    branch = Branch.of(start_rad)
    ends = RigidTransform.concatenate([start, base_from_flange])
    turned = Slerp([0.0, 1.0], ends.rotation)
    axes = start_rad
    for progress in np.linspace(0.0, 1.0, _N_STEPS + 1):
        place = start.translation + progress * (base_from_flange.translation - start.translation)
        pose = RigidTransform.from_components(place, turned(progress))
        found = inverse(pose, near_rad=axes).get(branch)
        problems = ["out of reach"] if found is None else []
        if found is not None:
            found = found + 2 * np.pi * np.round((axes - found) / (2 * np.pi))
            problems = [*_jumps(axes, found), *singularities_near(found)]
            problems += excesses(found, limits_rad)
            axes = found
        if problems:
            raise LimitError(
                f"{call}: a straight motion is not possible, at {progress:.0%} of it:"
                f" {'; '.join(problems)}; allowed is one that stays in its branch; use move",
                device=device,
            )
    return axes


def _jumps(before_rad: FloatArray, after_rad: FloatArray) -> list[str]:
    """Name the axes that turn too far between two steps."""
    turns = np.abs(after_rad - before_rad)
    return [
        f"{name} would turn by {np.degrees(turn):.0f} deg at once"
        for name, turn in zip(AXIS_NAMES, turns, strict=True)
        if turn > _LARGEST_STEP_RAD
    ]
