"""Why all answers of a core may be wrong: it means another convention than ours."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.dataset.records import Truth
from tronlab.geometry.poses import FloatArray
from tronlab.nav.core import NavigationResult

MIN_ANSWERS = 3
_GOOD_PCT_LOS = 5.0
_GOOD_DEG = 3.0
"""What the median error of a core that works stays below, and of one misread does not."""
_ALIKE = 0.01
"""Conventions that fit better than this part of what is good fit alike."""
_CV_FROM_GL = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
"""OpenGL's camera looks along -z with y up: half a turn about x."""


@dataclass(frozen=True, slots=True)
class _Convention:
    """What a core may mean by its numbers."""

    is_inverse: bool
    is_opengl: bool
    is_wxyz: bool
    is_mm: bool

    @property
    def deviations(self) -> tuple[str, ...]:
        """Get what differs from our convention, in words."""
        named = (
            (self.is_inverse, "cam_from_trs instead of trs_from_cam"),
            (self.is_opengl, "camera axes of OpenGL (y up, z backward) instead of y down, z ahead"),
            (self.is_wxyz, "quaternions in the order w, x, y, z instead of x, y, z, w"),
            (self.is_mm, "millimetres instead of metres"),
        )
        return tuple(text for is_so, text in named if is_so)

    def read(self, answers: RigidTransform) -> RigidTransform:
        """Give the ``trs_from_cam`` that the core meant, shape (n,)."""
        rotation, translation_m = answers.rotation, answers.translation
        if self.is_wxyz:
            rotation = Rotation.from_quat(np.roll(rotation.as_quat(), -1, axis=-1))
        if self.is_mm:
            translation_m = translation_m / 1000.0
        poses = RigidTransform.from_components(translation_m, rotation)
        if self.is_inverse:
            poses = poses.inv()
        if self.is_opengl:
            poses = RigidTransform.from_components(
                poses.translation, poses.rotation * _CV_FROM_GL.inv()
            )
        return poses


_CONVENTIONS = sorted(
    (_Convention(*flags) for flags in product((False, True), repeat=4)),
    key=lambda convention: len(convention.deviations),
)
"""All of them, ours first, then those that differ least."""


def convention_hint(truths: Sequence[Truth], results: Sequence[NavigationResult]) -> str:
    """Say which convention would make a core's answers right, if ours makes them wrong.

    Args:
        truths: Of each shot.
        results: What the core answered to each shot.

    Returns:
        A line for people; empty if the answers are right as they are, no convention explains them,
        or there are fewer than ``MIN_ANSWERS``.
    """
    solved = [
        (truth, result.trs_from_cam)
        for truth, result in zip(truths, results, strict=True)
        if result.status == "ok"
        and result.trs_from_cam is not None
        and np.isfinite(truth.range_los_m)
    ]
    if len(solved) < MIN_ANSWERS:
        return ""
    truth = RigidTransform.concatenate([truth.trs_from_cam for truth, _ in solved])
    ranges_m = np.array([truth.range_los_m for truth, _ in solved])
    answers = RigidTransform.concatenate([answer for _, answer in solved])
    badness = [_badness(c.read(answers), truth, ranges_m) for c in _CONVENTIONS]
    if badness[0] <= 1.0 or min(badness) > 1.0:
        return ""
    # Of those that fit about as well, the one that differs least from ours.
    fitting = max(2.0 * min(badness), _ALIKE)
    meant = next(c for c, b in zip(_CONVENTIONS, badness, strict=True) if b <= fitting)
    return (
        f"its answers fit the truth if they are taken as {' and '.join(meant.deviations)};"
        " docs/conventions.md says what a core shall answer"
    )


def _badness(poses: RigidTransform, truth: RigidTransform, ranges_m: FloatArray) -> float:
    """Give the larger of the median errors of position and rotation, over what is still good."""
    distances_m = np.linalg.norm(poses.translation - truth.translation, axis=-1)
    angles_deg = np.degrees((poses.rotation * truth.rotation.inv()).magnitude())
    return max(
        float(np.median(100.0 * distances_m / ranges_m)) / _GOOD_PCT_LOS,
        float(np.median(angles_deg)) / _GOOD_DEG,
    )
