"""What the driver says it would do, against what it commands and the simulator makes of that."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from drivers.kuka.backend import Command, ControllerState, Mode
from drivers.kuka.driver import KukaRobot
from drivers.kuka.options import KukaOptions
from drivers.kuka.position import Axes
from drivers.kuka.simulator.machine import KR16
from drivers.kuka.simulator.motion import axis_path, axis_profile
from tronlab.devices.protocols import MotionModel
from tronlab.devices.readings import DeviceIdentity, Posture, RobotTarget
from tronlab.errors import LimitError
from tronlab.kinematics.kr16 import forward

HELD_DEG = (6.0, -96.0, 104.0, 37.0, -10.0, -36.0)
OPTIONS = {
    "host": "192.0.2.1",
    "protocol": {"kind": "eki"},
    "rail_range_m": [-0.05, 4.4],
    "settle": {"dwell_s": 0.0, "n_readings": 2},
}


@dataclass
class Obedient:
    """A controller that is there as soon as it is told."""

    state_now: ControllerState
    sent: list[Command] = field(default_factory=list)

    def connect(self) -> None: ...

    def close(self) -> None: ...

    def identify(self, *, call: str) -> DeviceIdentity:
        return DeviceIdentity("KUKA", "KR 16", "", "")

    def state(self, *, call: str) -> ControllerState:
        return self.state_now

    def send(self, command: Command, *, call: str) -> int:
        self.sent.append(command)
        n = len(self.sent)
        self.state_now = replace(self.state_now, accepted_id=n, done_id=n, axes=command.axes)
        return n


def controller_at(axes: Axes) -> Obedient:
    return Obedient(
        ControllerState(
            reading=0,
            accepted_id=0,
            done_id=0,
            error=0,
            axes=axes,
            is_moving=False,
            has_stop_message=False,
            are_drives_on=True,
            is_emergency_stop_released=True,
            is_guard_closed=True,
            mode=Mode.EXT,
            override_pct=50,
            is_program_active=True,
            time_s=1.0,
        )
    )


def make_robot(backend: Obedient | None = None, **options: object) -> KukaRobot:
    parsed = KukaOptions.model_validate({**OPTIONS, **options})
    return KukaRobot("arm", parsed, backend or controller_at(Axes.from_controller(HELD_DEG, 0.0)))


def target(axes_deg: tuple[float, ...] = HELD_DEG, rail_m: float = 1.0) -> RobotTarget:
    return RobotTarget(rail_m, forward(np.radians(axes_deg)))


def simulated_s(sent: list[Command], start: Axes, options: KukaOptions) -> float:
    """Give how long the simulator, whose profiles are its own, would move."""
    total_s, before = 0.0, start
    for command in sent:
        ends = [np.array([*axes.arm_deg, axes.e1_mm]) for axes in (before, command.axes)]
        path = axis_path(*ends)
        speed, ramp = options.velocity_pct / 100, options.acceleration_pct / 100
        total_s += axis_profile(path, KR16, speed=speed, ramp=ramp).duration_s / 0.5
        before = command.axes
    return total_s


def test_is_a_motion_model_without_any_connection():
    robot = make_robot()
    assert isinstance(robot, MotionModel)
    posture = robot.posture_for(target())
    np.testing.assert_allclose(np.degrees(posture.axes_rad), HELD_DEG, atol=1e-6)
    assert robot.move_duration_s(posture, posture) == pytest.approx(0.3)


def test_plans_what_move_commands_and_takes_as_long_as_the_simulator():
    backend = controller_at(Axes.from_controller(HELD_DEG, 1000.0))
    robot = make_robot(backend)
    robot.connect()
    robot.move(target(), timeout_s=5.0)  # from here on the rail is seated
    at = robot.posture_for(target(), near=Posture(1.0, np.radians(HELD_DEG)))
    rng = np.random.default_rng(4)
    options = KukaOptions.model_validate(OPTIONS)
    n_detours = 0
    for _ in range(12):
        start, backend.sent[:] = backend.state_now.axes, []
        backend.state_now = replace(backend.state_now, accepted_id=0, done_id=0)
        goal = target(
            tuple(HELD_DEG + rng.uniform(-25.0, 25.0, 6)), round(rng.uniform(0.0, 4.4), 3)
        )
        planned = robot.posture_for(goal, near=at)
        robot.move(goal, timeout_s=5.0)
        np.testing.assert_allclose(backend.sent[-1].axes.arm_rad, planned.axes_rad, atol=1e-9)
        expected_s = simulated_s(backend.sent, start, options) + 0.3 * len(backend.sent)
        assert robot.move_duration_s(at, planned) == pytest.approx(expected_s, rel=1e-6)
        n_detours += len(backend.sent) == 2
        at = planned
    assert 0 < n_detours < 12


def test_own_limits_and_rail_are_refused_with_what_is_allowed():
    robot = make_robot(axis_limits_deg={"a1": [-5.0, 5.0]})
    with pytest.raises(LimitError, match=r"arm: posture_for: no branch .* allowed -5 to 5 deg"):
        robot.posture_for(target())
    with pytest.raises(LimitError, match=r"rail position is -0\.0400 m, allowed -0\.0300 to 4\.4"):
        robot.posture_for(target(rail_m=-0.04))


def test_pace_and_override_stretch_the_estimate():
    start, end = (Posture(x, np.radians(HELD_DEG)) for x in (0.0, 2.0))
    slow = make_robot(pace={"override_pct": 25, "command_s": 0.0})
    full = make_robot(pace={"override_pct": 50, "command_s": 0.0})
    assert slow.move_duration_s(start, end) == pytest.approx(2 * full.move_duration_s(start, end))
    # 2 m at 20 % of 1 m/s and 50 % of 0.5 m/s2: 10 s and 0.8 s of ramp, at half the override.
    assert full.move_duration_s(start, end) == pytest.approx(2 * (10.0 + 0.8))
    quick = make_robot(pace={"rail_speed_m_per_s": 2.0, "command_s": 0.0})
    assert quick.move_duration_s(start, end) == pytest.approx(2 * (5.0 + 1.6))
