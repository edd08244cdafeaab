"""Absolute and relative errors of a whole trajectory against another one.

Definitions: Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM Systems, IROS 2012;
alignment: Umeyama, IEEE PAMI 13 (1991) 376. Results are those of evo (``evo_ape``, ``evo_rpe``).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.dataset.exchange.association import associate
from tronlab.dataset.exchange.tum_import import TUM_MAX_DIFFERENCE_S, read_trajectory
from tronlab.errors import DegenerateGeometryError, ScoreError
from tronlab.geometry.alignment import align_points
from tronlab.geometry.poses import FloatArray

Alignment: TypeAlias = Literal["none", "se3", "sim3"]
"""What of the estimate's frame is free: nothing, rotation and translation, or also the scale."""

_MIN_RELATIVE_SPREAD = 1e-9


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Poses ``world_from_cam`` in the order of time."""

    times_s: FloatArray
    """Shape (n,)."""
    world_from_cam: RigidTransform
    """Shape (n,)."""

    def __len__(self) -> int:
        """Give the number of poses."""
        return len(self.times_s)

    def at(self, rows: ArrayLike) -> "Trajectory":
        """Give some of the poses."""
        i = np.asarray(rows, dtype=np.int64)
        return Trajectory(self.times_s[i], self.world_from_cam[i])


@dataclass(frozen=True, slots=True)
class Similarity:
    """A rotation, translation and change of scale: ``p_a = scale * R p_b + t``."""

    rotation: Rotation
    translation_m: FloatArray
    """Shape (3,)."""
    scale: float

    def apply(self, b_from_cam: RigidTransform) -> RigidTransform:
        """Give poses in frame a; a pose has no size, so that only positions are scaled."""
        moved = self.scale * self.rotation.apply(b_from_cam.translation) + self.translation_m
        return RigidTransform.from_components(moved, self.rotation * b_from_cam.rotation)


@dataclass(frozen=True, slots=True)
class TrajectoryErrors:
    """Errors of each pose, or of each pair of poses."""

    translation_m: FloatArray
    """Length of the difference, shape (n,)."""
    rotation_rad: FloatArray
    """Angle of the difference, shape (n,), 0 to pi."""


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """What a series of errors amounts to, in its unit; ``sse`` in the unit squared."""

    rmse: float
    mean: float
    median: float
    std: float
    """About the mean, over n."""
    min: float
    max: float
    sse: float


def load_trajectory(path: Path) -> Trajectory:
    """Read a trajectory in TUM's format, rows of ``timestamp tx ty tz qx qy qz qw``.

    Raises:
        DatasetError: The file cannot be read, has no rows, or a row is no pose.
    """
    return Trajectory(*read_trajectory(path))


def matched(
    reference: Trajectory,
    estimate: Trajectory,
    *,
    max_difference_s: float = TUM_MAX_DIFFERENCE_S,
    offset_s: float = 0.0,
) -> tuple[Trajectory, Trajectory]:
    """Give those poses of two trajectories that were taken at the same time, pair by pair.

    Each pose of the one that has fewer takes the nearest in time of the other.

    Args:
        reference: What is true.
        estimate: What is judged.
        max_difference_s: How far apart in time two of a pair may be.
        offset_s: Added to the times of the estimate.

    Raises:
        ScoreError: There is no pair.
    """
    is_denser = len(estimate) > len(reference)
    few, many = (reference, estimate) if is_denser else (estimate, reference)
    pairs = associate(
        few.times_s,
        many.times_s,
        max_difference_s=max_difference_s,
        offset_b_s=offset_s if is_denser else -offset_s,
    )
    if not pairs.i_a.size:
        raise ScoreError(
            f"no pose of the estimate is within {max_difference_s:g} s of one of the reference;"
            " check the time stamps, or name an offset"
        )
    few, many = few.at(pairs.i_a), many.at(pairs.i_b)
    return (few, many) if is_denser else (many, few)


def align(reference: RigidTransform, estimate: RigidTransform, alignment: Alignment) -> Similarity:
    """Find what takes the estimate's positions onto the reference's in the least-squares sense.

    Args:
        reference: Poses, shape (n,).
        estimate: The same poses as estimated, shape (n,).
        alignment: What is free.

    Raises:
        ScoreError: Different numbers of poses.
        DegenerateGeometryError: Fewer than three poses, or one trajectory is a point or a line.
    """
    _check_lengths(reference, estimate)
    if alignment == "none":
        return Similarity(Rotation.identity(), np.zeros(3), 1.0)
    a, b = reference.translation, estimate.translation
    ref_from_est = align_points(a, b)
    rotation = ref_from_est.rotation
    a0, b0 = a - a.mean(axis=0), b - b.mean(axis=0)
    spreads = np.linalg.svd(a0.T @ b0, compute_uv=False)
    if not spreads[1] > _MIN_RELATIVE_SPREAD * spreads[0]:  # also if both are 0
        raise DegenerateGeometryError(
            "alignment: the estimated positions lie on one line or point, so that the rotation is"
            " not determined"
        )
    if alignment == "se3":
        return Similarity(rotation, ref_from_est.translation, 1.0)
    turned = rotation.apply(b0)
    scale = float((a0 * turned).sum() / (b0**2).sum())
    translation_m = a.mean(axis=0) - scale * rotation.apply(b.mean(axis=0))
    return Similarity(rotation, translation_m, scale)


def absolute_errors(
    reference: RigidTransform, estimate: RigidTransform, *, alignment: Alignment = "none"
) -> TrajectoryErrors:
    """Compare pose by pose (APE).

    Args:
        reference: Poses ``world_from_cam``, shape (n,).
        estimate: The same poses as estimated, shape (n,).
        alignment: How the estimate is brought onto the reference first.

    Raises:
        ScoreError: Different numbers of poses.
        DegenerateGeometryError: The alignment is not determined.
    """
    aligned = align(reference, estimate, alignment).apply(estimate)
    return _errors(reference.inv() * aligned)


def relative_errors(
    reference: RigidTransform,
    estimate: RigidTransform,
    *,
    step: int = 1,
    has_all_pairs: bool = False,
    alignment: Alignment = "none",
) -> TrajectoryErrors:
    """Compare motions between two poses (RPE): the drift.

    Args:
        reference: Poses ``world_from_cam``, shape (n,).
        estimate: The same poses as estimated, shape (n,).
        step: How many poses further the second of a pair is.
        has_all_pairs: Whether pairs may overlap; otherwise each begins where the last one ended.
        alignment: How the estimate is brought onto the reference first; only the scale matters.

    Raises:
        ScoreError: Different numbers of poses, a step below 1, or too few poses for a pair.
        DegenerateGeometryError: The alignment is not determined.
    """
    if step < 1:
        raise ScoreError(f"relative errors: step is {step}, must be 1 or more")
    aligned = align(reference, estimate, alignment).apply(estimate)
    first = np.arange(0, len(reference) - step, 1 if has_all_pairs else step)
    if not first.size:
        raise ScoreError(f"relative errors: {len(reference)} poses have no pair {step} apart")
    second = first + step
    motion = reference[first].inv() * reference[second]
    motion_estimated = aligned[first].inv() * aligned[second]
    return _errors(motion.inv() * motion_estimated)


def error_statistics(errors: ArrayLike) -> ErrorStatistics:
    """Give the statistics of a series of errors, shape (n,).

    Raises:
        ScoreError: It is empty, or a value is not finite.
    """
    e = np.asarray(errors, dtype=np.float64)
    if not e.size or not np.isfinite(e).all():
        raise ScoreError("statistics: the errors are none, or not all finite")
    sse = float((e**2).sum())
    return ErrorStatistics(
        rmse=float(np.sqrt(sse / e.size)),
        mean=float(e.mean()),
        median=float(np.median(e)),
        std=float(e.std()),
        min=float(e.min()),
        max=float(e.max()),
        sse=sse,
    )


def _errors(difference: RigidTransform) -> TrajectoryErrors:
    return TrajectoryErrors(
        translation_m=np.linalg.norm(difference.translation, axis=-1),
        rotation_rad=difference.rotation.magnitude(),
    )


def _check_lengths(reference: RigidTransform, estimate: RigidTransform) -> None:
    if len(reference) != len(estimate):
        raise ScoreError(
            f"the reference has {len(reference)} poses and the estimate {len(estimate)};"
            " match them by time first"
        )
