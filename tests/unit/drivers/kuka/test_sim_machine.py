"""The simulator's own kinematics, held to published points and to the driver's."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drivers.kuka.simulator.machine import KR16, Machine, axes_at, flange_at, flange_of, position_of
from tronlab.kinematics import kr16

POINTS = [  # axes; X Y Z mm; A B C deg: computed from the ROS-Industrial kr16_2 description
    ((0, 0, 0, 0, 0, 0), (1768, 0, 640), (0, 90, 0)),
    ((0, -90, 90, 0, 0, 0), (1088, 0, 1320), (0, 90, 0)),
    ((0, -90, 90, 0, 90, 0), (930, 0, 1162), (180, 0, 180)),
    ((30, -80, 100, 20, -40, 60), (1006.439, -540.958, 1130.910), (-103.4803, 9.7765, -71.9350)),
    (
        (-45, -60, 75, -100, 35, -150),
        (903.649, 1029.865, 1038.384),
        (-8.7762, -13.1836, -96.8309),
    ),
    ((90, -90, 90, 0, 45, 10), (0, -1041.723, 1208.277), (104.0019, 44.1360, -170.1489)),
]

within_limits = st.tuples(
    *(st.floats(low, high) for low, high in zip(KR16.lowest_deg, KR16.highest_deg, strict=True))
)


@pytest.mark.parametrize(("axes", "xyz_mm", "abc_deg"), POINTS)
def test_flange_is_where_the_robot_description_says(axes, xyz_mm, abc_deg):
    pose = flange_of(np.array([*axes, 0.0]))
    np.testing.assert_allclose(pose.translation * 1e3, xyz_mm, atol=6e-4)
    expected = Rotation.from_euler("ZYX", abc_deg, degrees=True)
    assert np.degrees((expected.inv() * pose.rotation).magnitude()) < 2e-4


@given(within_limits)
@settings(max_examples=50, deadline=None)
def test_two_chains_written_apart_agree(axes_deg):
    ours, theirs = flange_of(np.array(axes_deg)), kr16.forward(np.radians(axes_deg))
    np.testing.assert_allclose(ours.as_matrix(), theirs.as_matrix(), atol=1e-12)


@given(within_limits)
@example((1.0, 0.0, 0.0, 2.868012033614e-07, 0.0, 0.0))  # B is nearly 90 deg
@example((1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
@settings(max_examples=50, deadline=None)
def test_position_tells_pose_and_branch_of_the_axes(axes_deg):
    axes = np.array([*axes_deg, 12.5])
    position = position_of(axes)
    assert position.e1_mm == 12.5
    np.testing.assert_allclose(
        flange_at(position).as_matrix(), flange_of(axes).as_matrix(), atol=1e-12
    )


def test_status_and_turn_choose_among_the_solutions():
    axes = np.array([20.0, -60.0, 80.0, 30.0, -40.0, 50.0, 0.0])
    position = position_of(axes)
    other_way_up = np.array([20.0, -60.0, 80.0, -150.0, 40.0, -130.0])
    found = axes_at(
        flange_at(position), other_way_up, KR16, status=position.status, turn=position.turn
    )
    np.testing.assert_allclose(found, axes[:6], atol=1e-6)
    free = axes_at(flange_at(position), other_way_up, KR16)
    assert free is not None
    assert not np.allclose(free, axes[:6], atol=1.0)


def test_rail_counts_from_its_zero_with_its_sign():
    machine = Machine(rail_zero_mm=500.0, rail_sign=-1)
    assert machine.rail_m(300.0) == pytest.approx(0.2)
    assert machine.e1_mm(machine.rail_m(300.0)) == pytest.approx(300.0)
