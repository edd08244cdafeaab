import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.devices.readings import RobotTarget
from tronlab.errors import LimitError
from tronlab.twin.reach import check_reach, wrist_distance_m

FORWARD = Rotation.from_euler("y", 90, degrees=True)
"""Flange z along x of base."""


def target(xyz_m: list[float], rotation: Rotation = FORWARD, rail_m: float = 1.0) -> RobotTarget:
    return RobotTarget(rail_m, RigidTransform.from_components(xyz_m, rotation))


def check(place: RobotTarget) -> None:
    check_reach(place, rail_range_m=(0.0, 4.0), device="robot", call="move")


def test_stretched_arm_reaches_the_maker_s_1611_mm_from_the_first_axis():
    straight = target([1.611 + 0.158, 0.0, 0.675])
    assert wrist_distance_m(straight) == pytest.approx(1.351)


def test_shoulder_turns_with_the_first_axis():
    turned = Rotation.from_euler("z", 1.0) * FORWARD
    place = Rotation.from_euler("z", 1.0).apply([1.2, 0.0, 0.9])
    assert wrist_distance_m(target(list(place), turned)) == pytest.approx(
        wrist_distance_m(target([1.2, 0.0, 0.9]))
    )


@pytest.mark.parametrize("rail_m", [-0.01, 4.01, np.nan])
def test_rail_ends(rail_m: float):
    with pytest.raises(
        LimitError, match=r"robot: move: rail position is .* m, allowed 0\.0000 to 4\.0000 m"
    ):
        check(target([1.0, 0.0, 1.0], rail_m=rail_m))


@pytest.mark.parametrize("xyz_m", [[1.9, 0.0, 0.7], [0.4, 0.0, 0.7], [1.0, 0.0, 2.5]])
def test_arm_too_far_or_too_near(xyz_m: list[float]):
    with pytest.raises(
        LimitError, match=r"wrist centre is \d\.\d+ m .* allowed 0\.3100 to 1\.3510 m"
    ):
        check(target(xyz_m))


def test_within_reach():
    check(target([1.0, 0.3, 1.2], rail_m=4.0))
