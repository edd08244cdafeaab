from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.devices.laboratory import MountingSpec, PoseSpec
from tronlab.devices.readings import RobotTarget
from tronlab.errors import LimitError, PlanError
from tronlab.planning.shots import (
    Plan,
    Shot,
    check_reach,
    database_indices,
    make_plan,
)

MOUNTING = MountingSpec(
    trs_from_rail=PoseSpec(xyz_m=(2.3, 2.0, 6.0), zyx_deg=(0.0, 90.0, 180.0)),
    flange_from_cam=PoseSpec(xyz_m=(0.0, 0.1, 0.1), zyx_deg=(-90.0, 0.0, 0.0)),
    flange_from_tmac=PoseSpec(xyz_m=(0.0, -0.1, 0.0)),
    rail_range_m=(0.0, 4.0),
    arm_forward_m=1.0,
)


def poses(n: int, *, noise: float = 0.0) -> list[RigidTransform]:
    rotation = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return [RigidTransform.from_components([1.0 + noise, 2.0, 4.0 - i], rotation) for i in range(n)]


def test_ids_count_from_1_and_targets_put_the_camera_there() -> None:
    plan = make_plan(poses(3), mounting=MOUNTING.nominal)
    assert [shot.shot_id for shot in plan.shots] == [1, 2, 3]
    for shot in plan.shots:
        base = RigidTransform.from_translation([shot.robot_target.rail_m, 0, 0])
        trs_from_cam = (
            MOUNTING.trs_from_rail.pose
            * base
            * shot.robot_target.base_from_flange
            * MOUNTING.flange_from_cam.pose
        )
        np.testing.assert_allclose(
            trs_from_cam.as_matrix(), shot.trs_from_cam_nominal.as_matrix(), atol=1e-12
        )


def test_plan_cannot_be_changed() -> None:
    plan = make_plan(poses(2), mounting=MOUNTING.nominal)
    with pytest.raises(FrozenInstanceError):
        plan.shots = plan.shots[:1]  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(FrozenInstanceError):
        plan.shots[0].shot_id = 7  # pyright: ignore[reportAttributeAccessIssue]
    assert isinstance(plan.shots, tuple)


def test_empty_plan_and_duplicate_ids_are_refused() -> None:
    with pytest.raises(PlanError, match="the plan is empty"):
        make_plan([], mounting=MOUNTING.nominal)
    shot = make_plan(poses(1), mounting=MOUNTING.nominal).shots[0]
    with pytest.raises(PlanError, match=r"more than once: 1$"):
        Plan((shot, shot))


def test_hash_is_the_same_for_the_same_plan_and_ignores_the_last_bits() -> None:
    a = make_plan(poses(3), mounting=MOUNTING.nominal)
    assert a.sha256 == make_plan(poses(3), mounting=MOUNTING.nominal).sha256
    assert a.sha256 == make_plan(poses(3, noise=1e-15), mounting=MOUNTING.nominal).sha256
    assert len(a.sha256) == 64


def test_hash_of_a_known_plan_does_not_change() -> None:
    """A changed hash makes every recorded dataset look like another plan's."""
    shot = Shot(
        shot_id=1,
        trs_from_cam_nominal=RigidTransform.from_translation([1.0, 2.0, 3.0]),
        robot_target=RobotTarget(0.5, RigidTransform.identity()),
    )
    assert Plan((shot,)).sha256 == (
        "d6a01c0261fdcbbb11db200facc6a316026ac897353bfefdfcfb5a68dbefb6e3"
    )


def test_hash_sees_every_part_of_a_shot() -> None:
    shot = make_plan(poses(1), mounting=MOUNTING.nominal).shots[0]
    moved = RigidTransform.from_translation([0, 0, 1e-6]) * shot.trs_from_cam_nominal
    target = shot.robot_target
    others = [
        Shot(2, shot.trs_from_cam_nominal, target),
        Shot(1, moved, target),
        Shot(1, shot.trs_from_cam_nominal, RobotTarget(0.0, target.base_from_flange)),
        Shot(1, shot.trs_from_cam_nominal, RobotTarget(target.rail_m, moved)),
    ]
    hashes = {Plan((s,)).sha256 for s in [shot, *others]}
    assert len(hashes) == 5


class ShortArm:
    """A robot that reaches rail positions below 2 m only."""

    def check(self, target: RobotTarget) -> None:
        if target.rail_m > 2:
            raise LimitError(f"check: rail {target.rail_m:.1f} m", device="robot")


def test_all_unreachable_shots_are_listed() -> None:
    plan = make_plan(poses(4), mounting=MOUNTING.nominal)
    with pytest.raises(PlanError) as caught:
        check_reach(plan.shots, ShortArm())  # pyright: ignore[reportArgumentType]
    lines = str(caught.value).splitlines()
    assert lines[0] == "2 of 4 shots cannot be reached:"
    assert [line.split(":")[0] for line in lines[1:3]] == ["  shot 3", "  shot 4"]
    assert "change the trajectory" in lines[-1]


def test_reference_views_of_the_paper() -> None:
    assert database_indices(61, n_views=11) == tuple(range(0, 61, 6))


@given(n_poses=st.integers(1, 500), data=st.data())
def test_reference_views_are_distinct_and_spread(n_poses: int, data: st.DataObject) -> None:
    n_views = data.draw(st.integers(1, n_poses))
    indices = database_indices(n_poses, n_views=n_views)
    assert len(set(indices)) == n_views
    assert indices[0] == 0
    if n_views > 1:
        assert indices[-1] == n_poses - 1
        gaps = np.diff(indices)
        assert gaps.max() - gaps.min() <= 1


def test_more_views_than_poses_are_refused() -> None:
    with pytest.raises(PlanError, match="3 reference views, but the trajectory has only 2 poses"):
        database_indices(2, n_views=3)
