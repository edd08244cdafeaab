"""Whether the robot can stand where the shots want it, and how it would change over between them.

All moves are by axes. Such a move cannot fail in a singularity and may change the branch; it then
turns single axes far, carrying cables and plate around, for what is a small step of the camera. So
these are warnings; what a limit forbids, or a move sweeps away, is refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from tronlab.devices.protocols import MotionModel, Robot
from tronlab.devices.readings import Posture
from tronlab.errors import LimitError
from tronlab.kinematics.kr16 import AXIS_NAMES, Branch, singularities_near
from tronlab.planning.assessment import Finding
from tronlab.planning.shots import Shot

_TURNED_OVER_RAD: Final = float(np.pi / 2)
"""A wrist that flips and turns an axis farther has turned over; less is passing through."""
_UNWOUND_RAD: Final = float(np.pi)
"""No pose needs an axis to turn farther, unless it has come to the end of its range."""


@dataclass(frozen=True, slots=True)
class Reach:
    """How the robot would stand at a shot."""

    posture: Posture | None
    """None if it cannot, or cannot be asked."""
    findings: tuple[Finding, ...]


def check_reach_along(
    shots: Sequence[Shot], robot: Robot | MotionModel, *, start: Posture | None = None
) -> tuple[Reach, ...]:
    """Let the robot choose its posture at each shot, each nearest to the one before.

    Args:
        shots: In the order taken.
        robot: Whoever moves; one that cannot be asked without a connection gets a warning at the
            first shot.
        start: Where it stands before.
    """
    if not isinstance(robot, MotionModel):
        unknown = Finding(
            "reach",
            f"robot '{robot.name}' cannot be asked without a connection: reach, clearance and"
            " duration of its moves are unknown; the run asks it about reach before anything moves",
            is_refusal=False,
        )
        return tuple(Reach(None, () if i else (unknown,)) for i in range(len(shots)))
    checks: list[Reach] = []
    before = start
    for shot in shots:
        check = _check(shot, robot, before)
        before = check.posture or before
        checks.append(check)
    return tuple(checks)


def turns_over(before: Posture, after: Posture) -> str:
    """Say how the arm changes over between two postures; empty if it does not."""
    turns_rad = after.axes_rad - before.axes_rad
    widest = int(np.abs(turns_rad).argmax())
    turn_rad = abs(float(turns_rad[widest]))
    change = _change(Branch.of(before.axes_rad), Branch.of(after.axes_rad), turn_rad)
    if not change:
        return ""
    return (
        f"{change} between this shot and the one before: {AXIS_NAMES[widest]} turns by"
        f" {np.degrees(turn_rad):.0f} deg"
    )


def _check(shot: Shot, robot: MotionModel, before: Posture | None) -> Reach:
    try:
        posture = robot.posture_for(shot.robot_target, near=before)
    except LimitError as error:
        return Reach(None, (Finding("reach", str(error)),))
    findings = [
        Finding(
            "singularity",
            f"near a singularity: {name}; only a straight correction is not possible there",
            is_refusal=False,
        )
        for name in singularities_near(posture.axes_rad)
    ]
    if before is not None and (text := turns_over(before, posture)):
        findings.append(Finding("branch", text, is_refusal=False))
    return Reach(posture, tuple(findings))


def _change(before: Branch, after: Branch, turn_rad: float) -> str:
    if before.is_overhead != after.is_overhead:
        return "the arm reaches over its own shoulder, or back"
    if before.is_elbow_up != after.is_elbow_up:
        return "the elbow changes sides"
    if before.is_wrist_flipped != after.is_wrist_flipped and turn_rad > _TURNED_OVER_RAD:
        return "the wrist turns over"
    return "an axis unwinds" if turn_rad > _UNWOUND_RAD else ""
