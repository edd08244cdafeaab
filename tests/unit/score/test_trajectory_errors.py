"""Errors of trajectories: against evo's own results, and against what must be."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import DegenerateGeometryError, ScoreError
from tronlab.score.trajectory_errors import (
    Alignment,
    Trajectory,
    absolute_errors,
    align,
    error_statistics,
    load_trajectory,
    matched,
    relative_errors,
)

DATA = Path(__file__).parents[3].parent / "shared/data/evo_tum"

APE_OF_EVO = {
    "none": (0.134185, 0.122986, 0.126531, 0.053668, 0.249332),
    "se3": (0.013470, 0.012025, 0.011183, 0.006071, 0.034760),
    "sim3": (0.013389, 0.011987, 0.011134, 0.005966, 0.034846),
}
"""rmse, mean, median, std, max of freiburg1_xyz-rgbdslam_drift by evo 1.38.1, as the data's README
has them."""


def trajectory(name: str) -> Trajectory:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"no {path}")
    return load_trajectory(path)


@pytest.fixture(scope="module")
def drift() -> tuple[RigidTransform, RigidTransform]:
    """Ground truth and estimate of a drifting odometry, pair by pair."""
    reference, estimate = matched(
        trajectory("freiburg1_xyz-groundtruth.txt"),
        trajectory("freiburg1_xyz-rgbdslam_drift.txt"),
        max_difference_s=0.01,
    )
    assert len(reference) == 785
    return reference.world_from_cam, estimate.world_from_cam


def walk(seed: int, n: int = 30) -> RigidTransform:
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(rng.normal(0.0, 0.7, (n, 3)))
    return RigidTransform.from_components(np.cumsum(rng.normal(0, 0.1, (n, 3)), axis=0), turns)


@pytest.mark.parametrize("alignment", ["none", "se3", "sim3"])
def test_absolute_errors_are_those_of_evo(
    drift: tuple[RigidTransform, RigidTransform], alignment: Alignment
) -> None:
    found = error_statistics(absolute_errors(*drift, alignment=alignment).translation_m)
    expected = APE_OF_EVO[alignment]
    assert (found.rmse, found.mean, found.median, found.std, found.max) == pytest.approx(
        expected, abs=1e-6
    )


def test_angles_and_relative_errors_are_those_of_evo(
    drift: tuple[RigidTransform, RigidTransform],
) -> None:
    degrees = np.degrees(absolute_errors(*drift, alignment="se3").rotation_rad)
    angle = error_statistics(degrees)
    expected = (2.057702, 2.024698, 2.000899, 3.639637)
    assert (angle.rmse, angle.mean, angle.median, angle.max) == pytest.approx(expected, abs=1e-6)
    step = error_statistics(relative_errors(*drift).translation_m)
    expected = (0.005764, 0.004816, 0.004139, 0.020865)
    assert (step.rmse, step.mean, step.median, step.max) == pytest.approx(expected, abs=1e-6)


def test_a_monocular_trajectory_is_scaled_as_by_evo() -> None:
    reference, estimate = matched(
        trajectory("fr2_desk_groundtruth.txt"),
        trajectory("fr2_desk_ORB.txt"),
        max_difference_s=0.01,
    )
    errors = absolute_errors(reference.world_from_cam, estimate.world_from_cam, alignment="sim3")
    found = error_statistics(errors.translation_m)
    assert (found.rmse, found.mean, found.max) == pytest.approx(
        (0.006123, 0.005586, 0.021477), abs=1e-6
    )


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.floats(0.05, 20.0))
def test_alignment_finds_what_was_done_to_a_trajectory(seed: int, scale: float) -> None:
    reference = walk(seed)
    rng = np.random.default_rng(seed + 1)
    turn = Rotation.from_rotvec(rng.normal(0, 1.5, 3))
    moved = RigidTransform.from_components(
        scale * turn.apply(reference.translation) + rng.normal(0, 3, 3), turn * reference.rotation
    )
    found = align(reference, moved, "sim3")
    assert found.scale == pytest.approx(1 / scale, rel=1e-9)
    errors = absolute_errors(reference, moved, alignment="sim3")
    assert errors.translation_m.max() < 1e-9
    assert errors.rotation_rad.max() < 1e-7
    assert relative_errors(reference, moved, alignment="sim3").translation_m.max() < 1e-9


def test_scale_is_free_only_where_it_may_be() -> None:
    reference = walk(5)
    double = RigidTransform.from_components(2 * reference.translation, reference.rotation)
    assert align(reference, double, "se3").scale == 1.0
    assert absolute_errors(reference, double, alignment="se3").translation_m.max() > 0.1
    at_origin = absolute_errors(reference, double).translation_m
    np.testing.assert_allclose(at_origin, np.linalg.norm(reference.translation, axis=1))


def test_relative_errors_forget_where_and_when_it_went_wrong() -> None:
    reference = walk(6)
    jump = RigidTransform.from_components([0.0, 0.3, 0.4], Rotation.from_rotvec([0.0, 0.0, 0.1]))
    estimate = RigidTransform.concatenate([reference[:10], jump * reference[10:]])
    for step, has_all_pairs, n_wrong, n_pairs in (
        (1, True, 1, 29),
        (5, True, 5, 25),
        (5, False, 1, 5),
    ):
        errors = relative_errors(reference, estimate, step=step, has_all_pairs=has_all_pairs)
        assert len(errors.rotation_rad) == n_pairs
        wrong = errors.rotation_rad > 1e-6
        assert wrong.sum() == n_wrong
        np.testing.assert_allclose(errors.rotation_rad[wrong], 0.1)


def test_a_pose_of_the_sparser_trajectory_takes_the_nearest_of_the_other() -> None:
    dense, sparse = walk(1, 20), walk(2, 3)
    reference = Trajectory(np.arange(20.0), dense)
    estimate = Trajectory(np.array([2.2, 7.9, 30.0]), sparse)
    for a, b, offset_s in ((reference, estimate, 0.0), (estimate, reference, 0.0)):
        left, right = matched(a, b, max_difference_s=0.25, offset_s=offset_s)
        assert sorted([left.times_s.tolist(), right.times_s.tolist()]) == [[2.0, 8.0], [2.2, 7.9]]
    left, right = matched(reference, estimate, max_difference_s=0.25, offset_s=-1.0)
    assert (left.times_s.tolist(), right.times_s.tolist()) == ([1.0, 7.0], [2.2, 7.9])


def test_statistics_of_three_numbers() -> None:
    found = error_statistics([3.0, 0.0, 3.0])
    assert (found.sse, found.mean, found.median) == (18.0, 2.0, 3.0)
    assert (found.min, found.max) == (0.0, 3.0)
    assert found.rmse == pytest.approx(np.sqrt(6.0))
    assert found.std == pytest.approx(np.sqrt(2.0))


def test_what_cannot_be_judged_is_refused() -> None:
    poses = walk(3)
    line = RigidTransform.from_translation(np.outer(np.arange(30.0), [1.0, 2.0, 0.5]))
    with pytest.raises(ScoreError, match="the reference has 30 poses and the estimate 29"):
        absolute_errors(poses, poses[:29])
    with pytest.raises(ScoreError, match="step is 0, must be 1 or more"):
        relative_errors(poses, poses, step=0)
    with pytest.raises(ScoreError, match="30 poses have no pair 30 apart"):
        relative_errors(poses, poses, step=30)
    with pytest.raises(DegenerateGeometryError, match="lie on one line"):
        absolute_errors(line, poses, alignment="se3")
    with pytest.raises(DegenerateGeometryError, match="lie on one line or point"):
        absolute_errors(poses, line, alignment="sim3")
    with pytest.raises(DegenerateGeometryError, match="line or point"):
        absolute_errors(poses, RigidTransform.identity(30), alignment="sim3")
    with pytest.raises(ScoreError, match="not all finite"):
        error_statistics([])
    with pytest.raises(ScoreError, match=r"no pose of the estimate is within 0\.02 s"):
        matched(Trajectory(np.arange(30.0), poses), Trajectory(np.arange(30.0) + 99, poses))
