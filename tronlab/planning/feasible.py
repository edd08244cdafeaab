"""The nearest pose that can be taken instead of one that cannot."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.poses import FloatArray

LEVER_M = 1.0
"""A turn counts as the way a point so far from the camera goes: 1 deg is as near as 17 mm."""

_STEPS_M = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
"""Sizes of the shifts that are tried, and of the turns at ``LEVER_M``."""
_DIRECTIONS: FloatArray = np.vstack([np.eye(3), -np.eye(3)])
_N_ANCHORS = 2
_N_HALVINGS = 7
"""Along a line the nearest pose is found to 1/128 of its length."""

Passes = Callable[[RigidTransform], bool]


def gap_m(a: RigidTransform, b: RigidTransform) -> float:
    """Give how far two poses are apart: the shift, and the turn at ``LEVER_M``."""
    return float(_gaps_m(a, b))


def nearest_feasible(
    refused: RigidTransform,
    accepted: Sequence[RigidTransform],
    passes: Passes,
    *,
    max_tries: int,
) -> RigidTransform | None:
    """Look for the nearest pose that passes: on the way to accepted ones, and all around.

    It is the nearest of those that were tried, not of all there are: on straight ways to the
    nearest accepted poses, and along and about the axes of the camera.

    Args:
        refused: ``trs_from_cam`` that does not pass.
        accepted: Poses that may pass, for they do elsewhere in the plan.
        passes: Whether a pose can be taken.
        max_tries: How often ``passes`` may be asked.

    Returns:
        ``trs_from_cam``; None if none was found.
    """
    search = _Search(refused, passes, max_tries)
    for anchor in _nearest_of(accepted, refused):
        if search.ask(anchor):
            search.approach(anchor)
    for pose in _around(refused):
        if search.is_nearer(pose) and search.ask(pose):
            search.approach(pose)
    return search.best


class _Search:
    """The best pose so far, and how many questions are left."""

    def __init__(self, refused: RigidTransform, passes: Passes, max_tries: int) -> None:
        self.best: RigidTransform | None = None
        self._best_gap_m = np.inf
        self._refused = refused
        self._passes = passes
        self._n_left = max_tries

    def is_nearer(self, pose: RigidTransform) -> bool:
        return gap_m(self._refused, pose) < self._best_gap_m

    def ask(self, pose: RigidTransform) -> bool:
        if self._n_left <= 0:
            return False
        self._n_left -= 1
        return self._passes(pose)

    def approach(self, feasible: RigidTransform) -> None:
        """Halve the way from a pose that passes to the refused one; keep what passes nearest."""
        near, far = 0.0, 1.0
        for _ in range(_N_HALVINGS):
            middle = (near + far) / 2
            if self.ask(_between(self._refused, feasible, middle)):
                far = middle
            else:
                near = middle
        found = feasible if far == 1.0 else _between(self._refused, feasible, far)
        if self.is_nearer(found):
            self.best, self._best_gap_m = found, gap_m(self._refused, found)


def _nearest_of(poses: Sequence[RigidTransform], pose: RigidTransform) -> list[RigidTransform]:
    """Give the few nearest of poses, nearest first."""
    if not poses:
        return []
    gaps_m = _gaps_m(pose, RigidTransform.concatenate(list(poses)))
    return [poses[i] for i in np.argsort(gaps_m, kind="stable")[:_N_ANCHORS]]


def _gaps_m(pose: RigidTransform, others: RigidTransform) -> FloatArray:
    """Give how far one or a stack of poses is from a pose."""
    shift_m = np.linalg.norm(others.translation - pose.translation, axis=-1)
    turn_rad = np.asarray((pose.rotation.inv() * others.rotation).magnitude(), dtype=np.float64)
    return shift_m + LEVER_M * turn_rad


def _around(pose: RigidTransform) -> Iterator[RigidTransform]:
    """Give poses around one, nearest first: shifted along or turned about an axis of the camera."""
    for step_m in _STEPS_M:
        for direction in step_m * _DIRECTIONS:
            yield pose * RigidTransform.from_translation(direction)
        for direction in step_m / LEVER_M * _DIRECTIONS:
            yield pose * RigidTransform.from_rotation(Rotation.from_rotvec(direction))


def _between(a: RigidTransform, b: RigidTransform, part: float) -> RigidTransform:
    """Give the pose at a part of the straight way from a to b, turning evenly."""
    turn = (a.rotation.inv() * b.rotation).as_rotvec()
    return RigidTransform.from_components(
        a.translation + part * (b.translation - a.translation),
        a.rotation * Rotation.from_rotvec(part * turn),
    )
