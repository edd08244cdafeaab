"""The plan: a campaign expanded once into an immutable list of shots."""

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.devices.mounting import Mounting
from tronlab.devices.protocols import Robot
from tronlab.devices.readings import RobotTarget
from tronlab.errors import LimitError, PlanError
from tronlab.geometry.poses import FloatArray

_HASH_DECIMALS = 9
"""Poses are hashed to the nanometre, so that the last bits of a platform do not count."""


class RangeFinder(Protocol):
    """Measures distances to the terrain; the heightfield renderer does."""

    def range_along_m(self, p_trs_m: FloatArray, direction_trs: FloatArray) -> float:
        """Give the distance to the terrain along a direction, metres; NaN if it is missed."""
        ...


@dataclass(frozen=True, slots=True)
class Shot:
    """One image to be taken."""

    shot_id: int
    """From 1, in the order of the trajectory."""
    trs_from_cam_nominal: RigidTransform
    robot_target: RobotTarget
    """Where the robot must stand so that the camera nominally has that pose."""


@dataclass(frozen=True, slots=True)
class Plan:
    """All shots of a campaign, in the order they are taken."""

    shots: tuple[Shot, ...]

    def __post_init__(self) -> None:
        if not self.shots:
            raise PlanError("the plan is empty: the trajectory has no pose")
        counts = Counter(shot.shot_id for shot in self.shots)
        twice = [str(shot_id) for shot_id, n in counts.items() if n > 1]
        if twice:
            raise PlanError(f"shot ids must be unique; more than once: {', '.join(twice)}")

    @property
    def sha256(self) -> str:
        """Get the hash of what shall be done; equal plans have equal hashes on every machine."""
        rows = [
            [
                shot.shot_id,
                *_rounded(shot.trs_from_cam_nominal),
                *_rounded(shot.robot_target.base_from_flange),
                _round(shot.robot_target.rail_m),
            ]
            for shot in self.shots
        ]
        return hashlib.sha256(json.dumps(rows).encode()).hexdigest()

    def every(self, n: int) -> "Plan":
        """Give the plan of only every n-th shot, the first included; they keep their ids."""
        return Plan(self.shots[::n])


def make_plan(poses: Sequence[RigidTransform], *, mounting: Mounting) -> Plan:
    """Expand ``trs_from_cam`` poses into shots with ids from 1.

    Raises:
        PlanError: There is no pose.
    """
    shots = (
        Shot(
            shot_id=shot_id,
            trs_from_cam_nominal=trs_from_cam,
            robot_target=mounting.robot_target(trs_from_cam),
        )
        for shot_id, trs_from_cam in enumerate(poses, start=1)
    )
    return Plan(shots=tuple(shots))


def check_reach(shots: Sequence[Shot], robot: Robot) -> None:
    """Ask the robot about every target, before anything moves.

    Raises:
        PlanError: Every shot the robot cannot reach, with its reason.
    """
    refusals: list[str] = []
    for shot in shots:
        try:
            robot.check(shot.robot_target)
        except LimitError as error:
            refusals.append(f"  shot {shot.shot_id}: {error}")
    if refusals:
        raise PlanError(
            "\n".join(
                [
                    f"{len(refusals)} of {len(shots)} shots cannot be reached:",
                    *refusals,
                    "change the trajectory of the campaign, or the limits or mounting of the rig",
                ]
            )
        )


def range_los_m(
    range_finder: RangeFinder, trs_from_cam: RigidTransform, *, ground_trs_m: float
) -> float:
    """Give the distance to the ground along the optical axis: the line of sight (paper, 1.1).

    The ground is the terrain model, and beside it the plane at its mean height: the model is
    finite, and seen from afar the axis of a tilted camera may pass its edge.

    Args:
        range_finder: Measures distances to the terrain.
        trs_from_cam: Pose of the camera.
        ground_trs_m: Mean height of the terrain, along Z of trs.

    Returns:
        Metres; NaN if the axis never meets the ground.
    """
    p_trs_m, boresight_trs = trs_from_cam.translation, trs_from_cam.rotation.apply([0.0, 0.0, 1.0])
    range_m = range_finder.range_along_m(p_trs_m, boresight_trs)
    above_m = float(p_trs_m[2]) - ground_trs_m
    if np.isfinite(range_m) or above_m <= 0 or boresight_trs[2] >= 0:
        return range_m
    return above_m / -float(boresight_trs[2])


def database_indices(n_poses: int, *, n_views: int) -> tuple[int, ...]:
    """Pick equally spaced poses for the reference views, both ends included.

    Raises:
        PlanError: More views are asked for than there are poses.
    """
    if n_views > n_poses:
        raise PlanError(
            f"{n_views} reference views, but the trajectory has only {n_poses} poses;"
            " ask for fewer views"
        )
    indices = np.rint(np.linspace(0, n_poses - 1, n_views)).astype(int)
    return tuple(int(i) for i in indices)


def _rounded(pose: RigidTransform) -> list[float]:
    matrix: FloatArray = pose.as_matrix()
    return [_round(value) for value in matrix[:3].ravel()]


def _round(value: float) -> float:
    return round(float(value), _HASH_DECIMALS) + 0.0  # + 0.0 makes -0.0 into 0.0
