"""How the simulated robot says it stands and moves, and that it does so."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.devices.protocols import MotionModel
from tronlab.devices.readings import Posture, RobotTarget
from tronlab.errors import LimitError
from tronlab.kinematics.kr16 import forward
from tronlab.twin.config import RobotConfig
from tronlab.twin.reach import move_duration_s, posture_at

FORWARD = Rotation.from_euler("y", 90, degrees=True)
"""Flange z along x of base."""
HELD_DEG = (6.0, -96.0, 104.0, 37.0, -10.0, -36.0)


def target(xyz_m: list[float], rotation: Rotation = FORWARD, rail_m: float = 1.0) -> RobotTarget:
    return RobotTarget(rail_m, RigidTransform.from_components(xyz_m, rotation))


def stand(place: RobotTarget, near: Posture | None = None) -> Posture:
    return posture_at(place, near=near, rail_range_m=(0.0, 4.0), device="robot", call="move")


def held(rail_m: float = 1.0, **degrees: float) -> Posture:
    axes_deg = {f"a{i}": angle for i, angle in enumerate(HELD_DEG, start=1)} | degrees
    return Posture(rail_m, np.radians(list(axes_deg.values())))


@pytest.mark.parametrize("rail_m", [-0.01, 4.01, np.nan])
def test_rail_ends(rail_m: float):
    with pytest.raises(
        LimitError, match=r"robot: move: rail position is .* m, allowed 0\.0000 to 4\.0000 m"
    ):
        stand(target([1.0, 0.0, 1.0], rail_m=rail_m))


@pytest.mark.parametrize("xyz_m", [[1.9, 0.0, 0.7], [1.0, 0.0, 2.5]])
def test_arm_too_short(xyz_m: list[float]):
    with pytest.raises(LimitError, match=r"robot: move: out of reach: the wrist centre is \d\.\d+"):
        stand(target(xyz_m))


def test_limits_of_single_axes_count():
    with pytest.raises(LimitError, match=r"no branch is within the limits .* A\d is -?\d+\.\d+"):
        stand(target([0.35, 0.0, 0.6]))


def test_posture_reaches_its_target():
    place = target([1.0, 0.3, 1.2], rail_m=4.0)
    posture = stand(place)
    assert posture.rail_m == 4.0
    np.testing.assert_allclose(
        forward(posture.axes_rad).as_matrix(), place.base_from_flange.as_matrix(), atol=1e-9
    )


def test_posture_goes_on_from_the_one_before():
    turned = held(a6=300.0)
    again = stand(RobotTarget(1.0, forward(turned.axes_rad)), near=held(a6=290.0))
    np.testing.assert_allclose(again.axes_rad, turned.axes_rad, atol=1e-9)


@pytest.mark.parametrize(
    ("end", "duration_s"),
    [
        (held(), 0.0),
        (held(rail_m=3.0), 4.0),  # 2 m at 0.5 m/s
        (held(a6=579.0), 1.0),  # a full second at the highest speed of A6; nothing else moves
        (held(rail_m=1.1, a6=579.0), 1.0),
    ],
)
def test_slowest_of_rail_flange_and_axes_sets_the_time(end: Posture, duration_s: float):
    assert move_duration_s(held(), end, RobotConfig()) == pytest.approx(duration_s)
    assert move_duration_s(end, held(), RobotConfig()) == pytest.approx(duration_s)


def test_flange_moves_at_its_speed():
    start, end = held(), held(a2=-86.0)
    way_m = forward(end.axes_rad).translation - forward(start.axes_rad).translation
    expected_s = np.linalg.norm(way_m) / RobotConfig().arm_speed_m_per_s
    assert move_duration_s(start, end, RobotConfig()) == pytest.approx(expected_s)


def test_moves_take_as_long_as_foretold_without_a_connection(bench, spec, look_at):
    b = bench()
    robot, clock, mounting = b.devices.robot, b.world.clock, spec.mounting.nominal
    assert isinstance(robot, MotionModel)
    robot.close()  # the plan is made without
    places = [mounting.robot_target(look_at(z_m=z_m)) for z_m in (3.0, 2.9, 1.2, 1.2, 3.4)]
    postures = [robot.posture_for(places[0])]
    for place in places[1:]:
        postures.append(robot.posture_for(place, near=postures[-1]))
    robot.connect()
    robot.move(places[0], timeout_s=60.0)
    for place, start, end in zip(places[1:], postures, postures[1:], strict=False):
        before_s = clock.now_s
        robot.move(place, timeout_s=60.0)
        assert clock.now_s - before_s == pytest.approx(robot.move_duration_s(start, end), abs=1e-6)


def test_robot_that_somebody_else_moved_goes_on_from_there(bench, spec, look_at):
    b = bench()
    robot, mounting = b.devices.robot, spec.mounting.nominal
    robot.move(mounting.robot_target(look_at(z_m=3.0)), timeout_s=60.0)
    pushed = mounting.robot_target(look_at(z_m=1.0))
    b.world.stand_robot(pushed, actual=pushed)
    before_s = b.world.clock.now_s
    robot.move(pushed, timeout_s=60.0)
    assert b.world.clock.now_s == before_s
