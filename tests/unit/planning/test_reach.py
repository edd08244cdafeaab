"""How a chain of shots is reached: nearest postures, limits, changing over, singularities."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.devices.readings import Posture, RobotTarget
from tronlab.errors import LimitError
from tronlab.kinematics.kr16 import UPRIGHT_RAD, axes_for, forward
from tronlab.planning.reach import check_reach_along, turns_over
from tronlab.planning.shots import Shot

OUT_OF_REACH = RigidTransform.from_translation([3.0, 0.0, 1.0])
HELD_DEG = (6.0, -96.0, 104.0, 37.0, -10.0, -36.0)


class Arm:
    """A KR 16 on a rail of 4 m, with no connection to anything."""

    name = "arm"

    def posture_for(self, target: RobotTarget, *, near: Posture | None = None) -> Posture:
        if target.rail_m > 4.0:
            raise LimitError(f"rail is {target.rail_m} m, allowed 4", device=self.name)
        start = UPRIGHT_RAD if near is None else near.axes_rad
        axes_rad = axes_for(target.base_from_flange, start, device=self.name, call="plan")
        return Posture(target.rail_m, axes_rad)

    def move_duration_s(self, start: Posture, end: Posture) -> float:
        raise NotImplementedError


class MuteArm:
    """A robot that has to be connected to be asked."""

    name = "mute"


def shot(shot_id: int, axes_deg: tuple[float, ...] = HELD_DEG, rail_m: float = 1.0) -> Shot:
    target = RobotTarget(rail_m, forward(np.radians(axes_deg)))
    return Shot(shot_id, RigidTransform.identity(), target)


def texts(check) -> list[str]:
    return [f"{f.check}{'!' if f.is_refusal else ''}: {f.text}" for f in check.findings]


def test_each_posture_is_nearest_to_the_one_before():
    # A6 goes on past half a turn, where the pose alone would have it jump back.
    rolled = [shot(i, (*HELD_DEG[:5], float(angle))) for i, angle in enumerate(range(0, 301, 60))]
    checks = check_reach_along(rolled, Arm())
    a6_deg = [np.degrees(check.posture.axes_rad[5]) for check in checks]
    np.testing.assert_allclose(a6_deg, range(0, 301, 60), atol=1e-6)
    assert all(check.findings == () for check in checks)


def test_out_of_reach_is_refused_in_the_robot_s_words_and_passed_by():
    far = Shot(2, RigidTransform.identity(), RobotTarget(1.0, OUT_OF_REACH))
    checks = check_reach_along([shot(1), far, shot(3, rail_m=9.0), shot(4)], Arm())
    assert [check.posture is None for check in checks] == [False, True, True, False]
    assert texts(checks[1])[0].startswith("reach!: arm: plan: out of reach: the wrist centre is")
    assert texts(checks[2]) == ["reach!: arm: rail is 9.0 m, allowed 4"]
    np.testing.assert_allclose(checks[3].posture.axes_rad, checks[0].posture.axes_rad, atol=1e-9)


def test_wrist_that_has_to_turn_over_is_a_warning():
    class NarrowArm(Arm):
        """Whose A5 stays positive: what hangs on it allows no other."""

        def posture_for(self, target: RobotTarget, *, near: Posture | None = None) -> Posture:
            deg = (6.0, -96.0, 104.0, -143.0, 10.0, 144.0)
            return Posture(target.rail_m, np.radians(deg if near else HELD_DEG))

    first, second = check_reach_along([shot(1), shot(2)], NarrowArm())
    assert texts(first) == []
    (text,) = texts(second)
    assert re.fullmatch(
        "branch: the wrist turns over between this shot and the one before: A[46] turns by 180 deg",
        text,
    )
    assert not second.findings[0].is_refusal


@pytest.mark.parametrize(
    ("after_deg", "text"),
    [
        ((6.0, -96.0, 104.0, 37.0, 10.0, -36.0), ""),  # A5 passes through 0: no axis jumps
        ((6.0, -96.0, 104.0, -153.0, -10.0, -36.0), "an axis unwinds .* A4 turns by 190 deg"),
        ((6.0, -30.0, -60.0, 37.0, -10.0, -36.0), "the elbow changes sides .* A3 turns by 164"),
        ((6.0, -150.0, -20.0, 37.0, -10.0, -36.0), "over its own shoulder"),
    ],
)
def test_changing_over_is_told_from_passing_through(after_deg, text):
    found = turns_over(Posture(0.0, np.radians(HELD_DEG)), Posture(0.0, np.radians(after_deg)))
    assert re.search(text, found) if text else found == ""


def test_singular_posture_is_a_warning():
    (check,) = check_reach_along([shot(1, (0.0, -90.0, 90.0, 0.0, 0.0, 0.0))], Arm())
    (text,) = texts(check)
    assert text.startswith("singularity: near a singularity: wrist (A5 is")


def test_robot_that_must_be_connected_is_said_once():
    checks = check_reach_along([shot(1), shot(2)], MuteArm())
    assert [len(check.findings) for check in checks] == [1, 0]
    assert texts(checks[0])[0].startswith("reach: robot 'mute' cannot be asked without a conn")
    assert all(check.posture is None for check in checks)
