import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.planning.feasible import gap_m, nearest_feasible

ORIGIN = RigidTransform.identity()


def at(x: float, y: float = 0.0, z: float = 0.0) -> RigidTransform:
    return RigidTransform.from_translation([x, y, z])


@given(st.floats(0.012, 0.35), st.sampled_from([0, 1, 2]), st.sampled_from([-1, 1]))
@settings(max_examples=15, deadline=None)
def test_a_wall_along_the_camera_is_left_by_the_shortest_way(distance_m, axis, sign):
    found = nearest_feasible(
        ORIGIN, [], lambda pose: sign * pose.translation[axis] >= distance_m, max_tries=200
    )
    assert found is not None
    assert distance_m <= gap_m(ORIGIN, found) < 1.03 * distance_m + 1e-3


def test_a_turn_is_found_where_only_the_direction_is_wrong():
    def passes(pose: RigidTransform) -> bool:
        return bool(pose.rotation.as_rotvec()[1] > np.radians(4.0))

    found = nearest_feasible(ORIGIN, [], passes, max_tries=200)
    assert found is not None
    assert np.allclose(found.translation, 0.0)
    assert np.radians(4.0) < found.rotation.magnitude() < np.radians(4.2)


def test_far_from_anything_the_way_leads_to_an_accepted_shot():
    accepted = RigidTransform.from_components([3.0, 0.0, 0.0], Rotation.from_rotvec([0, 0, 1.0]))
    found = nearest_feasible(
        ORIGIN, [accepted], lambda pose: pose.translation[0] >= 1.5, max_tries=200
    )
    assert found is not None
    assert 1.5 <= found.translation[0] < 1.55
    assert np.isclose(found.rotation.magnitude(), found.translation[0] / 3.0)


def test_it_gives_up_after_so_many_tries():
    asked: list[RigidTransform] = []

    def passes(pose: RigidTransform) -> bool:
        asked.append(pose)
        return False

    assert nearest_feasible(ORIGIN, [], passes, max_tries=17) is None
    assert len(asked) == 17


def test_an_accepted_pose_is_the_answer_if_nothing_nearer_passes():
    accepted = at(0.0, 0.0, 2.0)
    found = nearest_feasible(ORIGIN, [at(3.0), accepted], lambda p: p is accepted, max_tries=300)
    assert found is accepted
    assert nearest_feasible(ORIGIN, [accepted], lambda pose: False, max_tries=300) is None
