"""The KR 16's kinematics against its public description, and against itself."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from drivers.kuka.linear import follow_line
from drivers.kuka.position import (
    abc_deg_from_rotation,
    pose_from_xyz_mm_abc_deg,
    rotation_from_abc_deg,
    xyz_mm_abc_deg,
)
from tronlab.errors import LimitError
from tronlab.kinematics.kr16 import (
    BRANCHES,
    ELBOW_STRETCHED_RAD,
    KR16_LIMITS_RAD,
    Branch,
    axes_for,
    excesses,
    forward,
    inverse,
    singularities_near,
    status_and_turn,
    turned_within,
)

FLANGE_AT = [
    # axes in degrees, tool0 in mm, and its A, B, C in degrees, checked against the URDF
    ([0, 0, 0, 0, 0, 0], [1768, 0, 640], [0, 90, 0]),
    ([0, -90, 90, 0, 0, 0], [1088, 0, 1320], [0, 90, 0]),
    ([0, -90, 90, 0, 90, 0], [930, 0, 1162], [180, 0, 180]),
    ([30, -80, 100, 20, -40, 60], [1006.439, -540.958, 1130.910], [-103.4803, 9.7765, -71.9350]),
    ([-45, -60, 75, -100, 35, -150], [903.649, 1029.865, 1038.384], [-8.7762, -13.1836, -96.8309]),
    ([90, -90, 90, 0, 45, 10], [0, -1041.723, 1208.277], [104.0019, 44.1360, -170.1489]),
]

OPW_MM = (260, 35, 0, 675, 680, 670, 158)
"""The same arm as parameters a1, a2, b, c1 to c4 of an ortho-parallel wrist."""

steadily = settings(
    deadline=None,
    derandomize=True,
    max_examples=60,
    suppress_health_check=[HealthCheck.too_slow],
)
"""The same examples on every machine, however busy it is."""

axes_within_limits = st.tuples(
    *(st.floats(low, high) for low, high in KR16_LIMITS_RAD.round(6) * 0.999)
).map(np.array)


def assert_same_pose(ours, theirs, *, atol=1e-9):
    np.testing.assert_allclose(ours.as_matrix(), theirs.as_matrix(), atol=atol)


def difference_of_angles(a, b):
    return np.abs((np.asarray(a) - b + np.pi) % (2 * np.pi) - np.pi)


def is_far_from_singular(axes, *, margin=1e-3):
    is_bent = abs(np.sin(axes[2] - ELBOW_STRETCHED_RAD)) > margin
    return is_bent and abs(np.sin(axes[4])) > margin and abs(wrist_out_m(axes)) > margin


def wrist_out_m(axes):
    p_wrist = forward(axes).apply([0, 0, -0.158])
    return p_wrist[0] * np.cos(axes[0]) - p_wrist[1] * np.sin(axes[0])


@pytest.mark.parametrize(("axes_deg", "xyz_mm", "abc_deg"), FLANGE_AT)
def test_the_flange_is_where_the_robot_description_has_it(axes_deg, xyz_mm, abc_deg):
    pose = forward(np.radians(axes_deg))
    np.testing.assert_allclose(pose.translation * 1e3, xyz_mm, atol=6e-4)
    turn_rad = (rotation_from_abc_deg(abc_deg).inv() * pose.rotation).magnitude()
    assert np.degrees(turn_rad) < 1e-4


@pytest.mark.parametrize("axes_deg", [row[0] for row in FLANGE_AT])
def test_the_way_back_from_the_test_points_ends_at_their_axes(axes_deg):
    axes = np.radians(axes_deg)
    np.testing.assert_allclose(axes_for(forward(axes), axes), axes, atol=1e-7)


@steadily
@given(axes_within_limits)
def test_every_branch_holds_the_flange_in_the_same_pose(axes):
    pose = forward(axes)
    for found in inverse(pose, near_rad=axes).values():
        # Near a singularity, angles are badly determined, but the pose they make is not.
        assert_same_pose(forward(found), pose, atol=1e-7)


@steadily
@given(axes_within_limits)
def test_the_axes_that_made_a_pose_are_among_those_found_for_it(axes):
    assume(is_far_from_singular(axes))
    solutions = inverse(forward(axes))
    found = solutions[Branch.of(axes)]
    assert difference_of_angles(found, axes).max() < 1e-6


@steadily
@given(axes_within_limits)
def test_every_solution_is_of_the_branch_it_is_found_under(axes):
    assume(is_far_from_singular(axes))
    solutions = inverse(forward(axes))
    assert len(solutions) in (4, 8)  # reaching over the shoulder is not always possible
    for branch, found in solutions.items():
        assume(is_far_from_singular(found))
        assert Branch.of(found) == branch


def test_all_eight_branches_are_found_and_differ():
    axes = np.radians([30, -80, 100, 20, -40, 60])
    solutions = inverse(forward(axes))
    assert set(solutions) == set(BRANCHES)
    found = np.array(list(solutions.values()))
    for i, one in enumerate(found):
        for other in found[:i]:
            assert difference_of_angles(one, other).max() > 0.1


@pytest.mark.parametrize("a5_deg", [0.0, 1e-9, 180.0])
def test_a_wrist_that_is_stretched_or_folded_keeps_a4(a5_deg):
    axes = np.radians([10.0, -70.0, 60.0, 33.0, a5_deg, 44.0])
    pose = forward(axes)
    solutions = inverse(pose, near_rad=axes)
    assert_same_pose(forward(solutions[Branch.of(axes)]), pose, atol=1e-9)
    np.testing.assert_allclose(solutions[Branch.of(axes)][3], axes[3], atol=1e-9)


def test_a_wrist_above_the_first_axis_keeps_a1():
    # The triangle of the arm with its wrist centre 0.26 m behind the shoulder.
    axes = np.radians([25.0, 0.0, 0.0, 5.0, 50.0, 7.0])
    up_m = 0.9
    to_wrist_m, forearm_m = np.hypot(0.26, up_m), np.hypot(0.67, 0.035)
    bend = np.arccos((to_wrist_m**2 - 0.68**2 - forearm_m**2) / (2 * 0.68 * forearm_m))
    axes[1] = np.arctan2(-up_m, -0.26) - np.arctan2(
        forearm_m * np.sin(bend), 0.68 + forearm_m * np.cos(bend)
    )
    axes[2] = bend + ELBOW_STRETCHED_RAD
    assert wrist_out_m(axes) == pytest.approx(0.0, abs=1e-12)
    assert any("overhead" in name for name in singularities_near(axes))
    np.testing.assert_allclose(axes_for(forward(axes), axes), axes, atol=1e-6)


def test_a_whole_turn_of_a4_and_a6_is_another_way_to_hold_the_flange():
    axes = np.radians([0.0, -90.0, 90.0, 100.0, 40.0, -200.0])
    turned = turned_within(axes)
    assert {tuple(np.degrees(found[[3, 5]]).round(6)) for found in turned} == {
        (a4, a6) for a4 in (100.0, -260.0) for a6 in (-200.0, 160.0)
    }
    for found in turned:
        assert_same_pose(forward(found), forward(axes))


@steadily
@given(axes_within_limits)
def test_least_motion_from_the_axes_themselves_is_none(axes):
    assume(is_far_from_singular(axes))
    np.testing.assert_allclose(axes_for(forward(axes), axes), axes, atol=1e-6)


@steadily
@given(axes_within_limits, axes_within_limits)
def test_chosen_axes_are_within_the_limits_and_hold_the_flange_there(axes, current):
    pose = forward(axes)
    found = axes_for(pose, current)
    assert excesses(found) == []
    assert_same_pose(forward(found), pose, atol=1e-7)


def test_axes_go_on_without_a_jump_through_180_degrees():
    """A6 passes 180 deg, where an angle that is kept between -180 and 180 would turn back."""
    start = np.radians([0.0, -90.0, 90.0, 20.0, 40.0, 150.0])
    turns = np.radians(np.arange(0.0, 181.0, 2.0))
    current, path = start, []
    for turn in turns:
        wanted = start + turn * np.eye(6)[5]
        current = axes_for(forward(wanted), current)
        path.append(current)
    assert max(np.abs(b - a).max() for a, b in pairwise(path)) == pytest.approx(np.radians(2.0))
    assert np.degrees(path[-1][5]) == pytest.approx(330.0)


def test_beyond_the_last_turn_the_axis_goes_back_by_a_whole_one():
    current = np.radians([0.0, -90.0, 90.0, 20.0, 40.0, 349.0])
    wanted = current + np.radians([0, 0, 0, 0, 0, 2.0])
    assert np.degrees(axes_for(forward(wanted), current)[5]) == pytest.approx(-9.0)


def test_a_pose_too_far_away_is_refused_with_the_distance():
    pose = RigidTransform.from_components([2.5, 0, 1.0], Rotation.from_euler("y", 90, degrees=True))
    with pytest.raises(LimitError, match=r"^arm: go: out of reach: .* 2\.10\d+ m .*allowed 0\.00"):
        axes_for(pose, np.zeros(6), device="arm", call="go")


def test_a_pose_that_only_an_axis_beyond_its_limits_could_reach_is_refused_by_name():
    limits = KR16_LIMITS_RAD.copy()
    limits[0] = np.radians([-10, 10])
    axes = np.radians([30, -60, 100, 20, -40, 60])
    with pytest.raises(LimitError, match=r"A1 is 30\.0000 deg, allowed -10 to 10"):
        axes_for(forward(axes), axes, limits_rad=limits)


def test_excesses_name_every_axis_beyond_its_limits():
    found = excesses(np.radians([0, 36, 0, 0, -131, 0]))
    assert [text.split()[0] for text in found] == ["A2", "A5"]
    assert "36.0000 deg, allowed -155 to 35" in found[0]


@steadily
@given(axes_within_limits)
def test_the_jacobian_loses_rank_exactly_where_a_singularity_is_named(axes):
    # |det J| of this arm is the product of the three distances from its singularities.
    product = (
        abs(np.sin(axes[4]) * np.sin(axes[2] - ELBOW_STRETCHED_RAD) * wrist_out_m(axes))
        * 0.68
        * np.hypot(0.67, 0.035)
    )
    assert abs(np.linalg.det(numeric_jacobian(axes))) == pytest.approx(product, abs=1e-6)
    if singularities_near(axes) == []:
        assert product > 0.0


@pytest.mark.parametrize(
    ("axes_deg", "named"),
    [
        ([0, -90, 90, 0, 0.5, 0], ["wrist"]),
        ([0, -90, -3, 0, 50, 0], ["elbow"]),
        ([0, -90, 90, 0, 50, 0], []),
        ([0, 0, -3, 0, 0, 0], ["wrist", "elbow"]),
    ],
)
def test_singularities_are_named(axes_deg, named):
    assert [text.split()[0] for text in singularities_near(np.radians(axes_deg))] == named


@pytest.mark.parametrize(
    ("axes_deg", "status", "turn"),
    [
        ([0, -90, 90, 0, 90, 0], 0b010, 0b000010),
        ([30, -80, 100, 20, -40, 60], 0b110, 0b010010),
        ([-30, -80, 100, -20, 40, -60], 0b010, 0b101011),
        ([0, 10, -100, 0, 40, 0], 0b000, 0b000100),
        ([0, -140, 20, 0, 40, 0], 0b011, 0b000010),
    ],
)
def test_status_and_turn_tell_branch_and_signs(axes_deg, status, turn):
    assert status_and_turn(np.radians(axes_deg)) == (status, turn)


@pytest.mark.parametrize(("status", "turn"), [(6, 27), (6, 26), (6, 50), (2, 3), (2, 35), (2, 42)])
def test_status_and_turn_of_recorded_points_are_consistent(status, turn):
    """S and T of points in public KRL programs: bit 2 of S goes with bit 4 of T, the sign of A5."""
    signs = [-1 if turn >> i & 1 else 1 for i in range(6)]
    axes = np.radians([10, 80, 90, 20, 30, 40] * np.array(signs))
    assert status_and_turn(axes) == (status, turn)


@pytest.mark.parametrize("off_deg", [0.0, *np.logspace(-15, 1, 33), 90.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_pose_survives_angles_a_b_c_even_where_two_of_them_are_one(off_deg, sign):
    pose = pose_from_xyz_mm_abc_deg([1.0, 2.0, 3.0, 25.0, sign * (90.0 - off_deg), -70.0])
    again = pose_from_xyz_mm_abc_deg(xyz_mm_abc_deg(pose))
    assert_same_pose(again, pose, atol=2e-12)


@pytest.mark.parametrize("b_deg", [90.0, -90.0])
def test_where_only_one_of_a_and_c_is_determined_c_is_none(b_deg):
    a_deg, b_again_deg, c_deg = abc_deg_from_rotation(rotation_from_abc_deg([25.0, b_deg, -70.0]))
    assert (b_again_deg, c_deg) == pytest.approx((b_deg, 0.0), abs=1e-9)
    assert a_deg == pytest.approx(25.0 + np.sign(b_deg) * 70.0)


def test_angles_a_b_c_turn_about_z_then_y_then_x():
    rotation = rotation_from_abc_deg([90.0, 0.0, 90.0])
    np.testing.assert_allclose(rotation.apply([0, 1, 0]), [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(rotation.apply([1, 0, 0]), [0, 1, 0], atol=1e-12)


def test_a_straight_motion_stays_in_its_branch():
    start = np.radians([10, -80, 100, 20, -40, 60])
    pose = RigidTransform.from_translation([0.05, 0.02, -0.03]) * forward(start)
    end = follow_line(start, pose, limits_rad=KR16_LIMITS_RAD, device="arm", call="go")
    assert_same_pose(forward(end), pose)
    assert Branch.of(end) == Branch.of(start)
    assert np.abs(end - start).max() < np.radians(10)


def test_a_straight_motion_through_the_stretched_wrist_is_refused_by_name():
    start = np.radians([0, -90, 90, 0, 10, 0])
    turn = Rotation.from_euler("y", -20, degrees=True)
    at = forward(start)
    pose = RigidTransform.from_components(at.translation, turn * at.rotation)
    with pytest.raises(LimitError, match=r"arm: go: .* at \d+% of it: wrist \(A5"):
        follow_line(start, pose, limits_rad=KR16_LIMITS_RAD, device="arm", call="go")


def test_a_straight_motion_that_passes_the_stretched_wrist_between_two_steps_is_refused():
    """So wide a turn comes nowhere within a degree of it, but A4 turns over all the same."""
    start, end = (np.radians([0, -90, 60, 0, a5, 0]) for a5 in (98.0, -80.2))
    wrist = forward(start).apply([0.0, 0.0, -0.158])
    pose = forward(end)
    assert pose.apply([0.0, 0.0, -0.158]) == pytest.approx(wrist)
    with pytest.raises(LimitError, match=r"A4 would turn by 180 deg at once"):
        follow_line(start, pose, limits_rad=KR16_LIMITS_RAD, device="arm", call="go")


def test_a_straight_motion_out_of_reach_is_refused():
    start = np.radians([0, -90, 90, 0, 40, 0])
    pose = RigidTransform.from_translation([1.0, 0, 0]) * forward(start)
    with pytest.raises(LimitError, match=r"out of reach|elbow"):
        follow_line(start, pose, limits_rad=KR16_LIMITS_RAD, device="arm", call="go")


def numeric_jacobian(axes, *, step=1e-6):
    """Jacobian at the wrist centre, shape (6, 6), by central differences."""
    columns = []
    for i in range(6):
        before, after = (forward(axes + sign * step * np.eye(6)[i]) for sign in (-1, 1))
        p_before, p_after = (pose.apply([0, 0, -0.158]) for pose in (before, after))
        turn = (after.rotation * before.rotation.inv()).as_rotvec()
        columns.append(np.concatenate([p_after - p_before, turn]) / (2 * step))
    return np.array(columns).T


def test_every_solution_equals_one_of_another_library(rng):
    """py_opw_kinematics was written by others; its parameters here are the KR 16's, in mm."""
    opw = pytest.importorskip("py_opw_kinematics", reason="needs py-opw-kinematics")
    model = opw.KinematicModel(
        **dict(zip(("a1", "a2", "b", "c1", "c2", "c3", "c4"), OPW_MM, strict=True)),
        offsets=(0, -90, 0, 0, 0, 0),
        flip_axes=(True, False, False, True, False, True),
    )
    other = opw.Robot(model, degrees=True)
    for axes in rng.uniform(*KR16_LIMITS_RAD.T, size=(100, 6)):
        pose = other.forward(tuple(np.degrees(axes)))
        np.testing.assert_allclose(forward(axes).translation * 1e3, pose.translation, atol=1e-9)
        assert (forward(axes).rotation.inv() * pose.rotation).magnitude() < 1e-9
        theirs = [np.radians(found) for found in other.inverse(pose)]
        ours = list(inverse(forward(axes), near_rad=axes).values())
        assert len(ours) == len(theirs)
        for found in ours:
            assert min(difference_of_angles(found, one).max() for one in theirs) < 1e-6
