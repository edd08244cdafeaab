"""The simulated controller: what it does with commands, and what faults do to it."""

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from drivers.kuka.simulator import faults as f
from drivers.kuka.simulator.cell import Mode
from drivers.kuka.simulator.command import FREE, Command, CommandType, Refusal
from drivers.kuka.simulator.controller import Controller
from drivers.kuka.simulator.machine import HOME, Machine, flange_of, position_of
from drivers.kuka.simulator.scene import EmptyScene
from tronlab.devices.readings import RobotTarget
from tronlab.errors import ConfigError, DeviceFaultError, DeviceTimeoutError
from tronlab.twin.state import ArmedFaults

STEP = np.array([3.0, 0.0, 0.0, 0.0, 0.0, 5.0, 8.0])
LONG = np.array([60.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3000.0])

NIMBLE = Machine(axis_ramp_s=0.05, rail_acceleration_mm_per_s2=5e3)
"""Starts and stops faster than a KR 16, so that tests do not wait for it."""


def wait_until(condition, *, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.005)


def command(number, kind=CommandType.PTP_AXIS, *, axes=HOME, **changes) -> Command:
    values = {
        "number": number,
        "type": kind,
        "velocity_pct": 100.0,
        "acceleration_pct": 100.0,
        "axes": np.array(axes, dtype=float),
        "position": replace(position_of(np.array(axes, dtype=float)), status=FREE, turn=FREE),
    }
    return Command(**{**values, **changes})


class Witness(EmptyScene):
    """Notes every move that begins and everywhere the robot stands."""

    def __init__(self) -> None:
        super().__init__()
        self.begun: list[RobotTarget] = []
        self.stood: list[tuple[RobotTarget, float]] = []
        self.n_asked = 0
        self.failure: Exception | None = None

    def begin_move(self, target):
        self.n_asked += 1
        if self.failure is not None:
            raise self.failure
        self.begun.append(target)

    def stand(self, encoders, *, progress):
        super().stand(encoders, progress=progress)
        self.stood.append((encoders, progress))


@pytest.fixture
def faults():
    return ArmedFaults()


@pytest.fixture
def scene():
    return Witness()


@pytest.fixture
def controller(scene, faults):
    controller = Controller(scene, faults, machine=NIMBLE, override_pct=100)
    yield controller
    controller.close()


def carry_out(controller, what: Command):
    controller.write(what)
    wait_until(lambda: controller.state.done == what.number)
    return controller.state


def test_robot_stands_first_where_the_scene_says():
    at = RobotTarget(1.25, flange_of(np.array([10.0, -80.0, 100.0, 20.0, 40.0, -30.0])))
    controller = Controller(EmptyScene(at), ArmedFaults(), machine=Machine(rail_zero_mm=100.0))
    controller.close()
    axes = controller.state.measured
    np.testing.assert_allclose(
        flange_of(axes).as_matrix(), at.base_from_flange.as_matrix(), atol=1e-9
    )
    assert axes[6] == pytest.approx(1350.0)


def test_scene_beyond_the_arm_is_an_error():
    far = RobotTarget(0.0, RigidTransform.from_translation([3.0, 0.0, 0.0]))
    with pytest.raises(ConfigError, match="cannot stand"):
        Controller(EmptyScene(far), ArmedFaults())


def test_ptp_ends_exactly_and_tells_the_scene_all_the_way(controller, scene):
    goal = HOME + np.array([3.0, 0.0, 0.0, 0.0, 0.0, 5.0, 800.0])
    state = carry_out(controller, command(1, axes=goal))
    assert (state.acknowledged, state.refusal, state.is_moving) == (1, Refusal.NONE, False)
    np.testing.assert_array_equal(state.measured, goal)
    progress = [p for _, p in scene.stood]
    assert progress == sorted(progress)
    assert len(set(progress)) > 3
    assert progress[-1] == 1.0
    assert len(scene.begun) == 1
    assert scene.stood[-1][0].rail_m == pytest.approx(scene.begun[0].rail_m) == 0.8


def test_robot_says_that_it_moves_while_it_does(controller):
    controller.write(command(1, axes=HOME + LONG))
    wait_until(lambda: controller.state.is_moving)
    state = controller.state
    assert (state.acknowledged, state.done) == (1, 0)


@pytest.mark.parametrize("kind", [CommandType.PTP_CARTESIAN, CommandType.LIN])
def test_cartesian_commands_end_at_their_position(controller, kind):
    goal = RigidTransform.from_translation([0.02, -0.03, 0.01]) * flange_of(HOME)
    x, y, z = goal.translation * 1e3
    position = replace(position_of(HOME), x_mm=x, y_mm=y, z_mm=z, status=FREE, turn=FREE, e1_mm=2.0)
    state = carry_out(controller, command(1, kind, position=position))
    assert state.refusal is Refusal.NONE
    np.testing.assert_allclose(flange_of(state.measured).as_matrix(), goal.as_matrix(), atol=1e-9)
    assert state.measured[6] == pytest.approx(2.0)


def test_ping_is_done_and_moves_nothing(controller, scene):
    assert carry_out(controller, command(5, CommandType.PING)).acknowledged == 5
    assert scene.stood == []


def test_command_of_the_same_number_is_no_new_one(controller, scene):
    carry_out(controller, command(1, axes=HOME + STEP))
    controller.write(command(1, axes=HOME - STEP))
    carry_out(controller, command(2, CommandType.PING))
    assert len(scene.begun) == 1


BEYOND = [
    (command(1, 7), Refusal.UNKNOWN_TYPE),
    (command(1, axes=HOME + np.array([0, 130, 0, 0, 0, 0, 0])), Refusal.AXIS_LIMIT),
    (command(1, axes=HOME + np.array([0, 0, 0, 0, 0, 0, -1])), Refusal.RAIL_LIMIT),
    (command(1, axes=HOME + np.array([0, 0, 0, 0, 0, 0, 11001])), Refusal.RAIL_LIMIT),
    (command(1, velocity_pct=0.0), Refusal.FAILED),
    (command(1, acceleration_pct=101.0), Refusal.FAILED),
    (command(1, tool=1), Refusal.FAILED),
    (command(1, base=3), Refusal.FAILED),
    (
        command(1, CommandType.LIN, position=replace(position_of(HOME), x_mm=2500.0)),
        Refusal.FAILED,
    ),
    (
        command(1, CommandType.PTP_CARTESIAN, position=replace(position_of(HOME), x_mm=2500.0)),
        Refusal.FAILED,
    ),
    (
        command(1, CommandType.LIN, position=replace(position_of(HOME), e1_mm=-5.0)),
        Refusal.RAIL_LIMIT,
    ),
]


@pytest.mark.parametrize(("what", "refusal"), BEYOND)
def test_what_cannot_be_is_refused_and_nothing_moves(controller, scene, what, refusal):
    state = carry_out(controller, what)
    assert (state.acknowledged, state.refusal) == (1, refusal)
    assert scene.begun == scene.stood == []
    assert not state.cell.has_stop_message
    assert carry_out(controller, command(2, axes=HOME + STEP)).refusal is Refusal.NONE


def test_position_within_reach_but_beyond_the_axes_is_a_matter_of_limits(faults):
    narrow = Machine(
        lowest_deg=(-1.0, *Machine.lowest_deg[1:]), highest_deg=(1.0, *Machine.highest_deg[1:])
    )
    controller = Controller(EmptyScene(), faults, machine=narrow)
    aside = position_of(HOME + np.array([20, 0, 0, 0, 0, 0, 0]))
    try:
        state = carry_out(controller, command(1, CommandType.PTP_CARTESIAN, position=aside))
    finally:
        controller.close()
    assert state.refusal is Refusal.AXIS_LIMIT


def test_undefined_value_stops_the_program_until_someone_confirms(controller, scene, capsys):
    undefined = replace(command(1), axes=HOME + np.array([np.nan, 0, 0, 0, 0, 0, 0]))
    state = carry_out(controller, undefined)
    assert state.refusal is Refusal.FAILED
    wait_until(lambda: controller.state.cell.has_stop_message)
    assert "not initialised" in capsys.readouterr().err
    assert carry_out(controller, command(2, axes=HOME + STEP)).refusal is Refusal.NOT_READY
    assert scene.begun == []
    controller.confirm()
    assert carry_out(controller, command(3, axes=HOME + STEP)).refusal is Refusal.NONE


def test_hold_stops_on_the_way_and_counts_for_the_motion(controller, scene):
    controller.write(command(1, axes=HOME + LONG))
    wait_until(lambda: controller.state.measured[6] > 1.0)
    state = carry_out(controller, command(2, CommandType.HOLD))
    assert (state.acknowledged, state.refusal, state.is_moving) == (2, Refusal.HELD, False)
    assert 1.0 < state.measured[6] < 3000.0
    assert scene.stood[-1][0].rail_m == state.measured[6] / 1000


def test_hold_discards_the_command_that_waits(controller, scene):
    controller.write(command(1, axes=HOME + LONG))
    wait_until(lambda: controller.state.is_moving)
    controller.write(command(2, axes=HOME - STEP))
    carry_out(controller, command(3, CommandType.HOLD))
    carry_out(controller, command(4, CommandType.PING))
    assert len(scene.begun) == 1


def test_hold_at_rest_is_no_error(controller):
    assert carry_out(controller, command(1, CommandType.HOLD)).refusal is Refusal.NONE


def test_command_waits_for_the_one_before_it(controller, scene):
    controller.write(command(1, axes=HOME + STEP))
    wait_until(lambda: controller.state.acknowledged == 1)
    controller.write(command(2, axes=HOME))
    wait_until(lambda: controller.state.done == 2)
    assert len(scene.begun) == 2
    np.testing.assert_array_equal(controller.state.measured, HOME)


def test_override_of_zero_freezes_and_a_higher_one_lets_go_on(controller):
    controller.set_override(0)
    controller.write(command(1, axes=HOME + STEP))
    wait_until(lambda: controller.state.acknowledged == 1)
    time.sleep(0.1)
    np.testing.assert_allclose(controller.state.measured, HOME, atol=1e-9)
    controller.set_override(100)
    wait_until(lambda: controller.state.done == 1)


UNSAFE = [f.EMERGENCY_STOP, f.GUARD_OPEN, f.DRIVES_OFF, f.WRONG_MODE, f.STOP_MESSAGE]


@pytest.mark.parametrize("fault", UNSAFE)
def test_unsafe_cell_refuses_to_move_until_it_is_safe_again(controller, scene, faults, fault):
    faults.arm(fault)
    state = carry_out(controller, command(1, axes=HOME + STEP))
    assert state.refusal is Refusal.NOT_READY
    assert scene.begun == []
    faults.arm(fault, times=0)
    assert carry_out(controller, command(2, axes=HOME + STEP)).refusal is Refusal.NONE


@pytest.mark.parametrize("fault", UNSAFE)
def test_cell_that_becomes_unsafe_stops_the_motion(controller, faults, fault):
    controller.write(command(1, axes=HOME + LONG))
    wait_until(lambda: controller.state.measured[6] > 1.0)
    faults.arm(fault)
    wait_until(lambda: controller.state.done == 1)
    assert controller.state.refusal is Refusal.NOT_READY
    assert controller.state.measured[6] < 3000.0


def test_each_fault_shows_in_the_state(controller, faults):
    def told():
        cell = controller.state.cell
        return {
            f.EMERGENCY_STOP: not cell.is_estop_released,
            f.GUARD_OPEN: not cell.is_guard_closed,
            f.DRIVES_OFF: not cell.are_drives_on,
            f.WRONG_MODE: cell.mode is Mode.T1,
            f.STOP_MESSAGE: cell.has_stop_message,
        }

    assert not any(told().values())
    assert controller.state.cell.is_program_active
    for fault in told():
        faults.arm(fault)
        wait_until(lambda fault=fault: told()[fault])
        assert not controller.state.cell.is_program_active
        faults.arm(fault, times=0)
        wait_until(lambda: not any(told().values()))


def test_stuck_robot_accepts_and_can_be_held(controller, faults, scene):
    faults.arm(f.STUCK)
    controller.write(command(1, axes=HOME + STEP))
    wait_until(lambda: controller.state.acknowledged == 1)
    time.sleep(0.1)
    assert controller.state.done == 0
    np.testing.assert_allclose(controller.state.measured, HOME, atol=1e-9)
    assert carry_out(controller, command(2, CommandType.HOLD)).refusal is Refusal.HELD
    np.testing.assert_allclose(controller.state.measured, HOME, atol=1e-9)


def test_robot_that_is_not_still_creeps_after_it_is_done(controller, faults):
    faults.arm(f.NOT_STILL)
    carry_out(controller, command(1, axes=HOME + STEP))
    first = controller.state.measured
    wait_until(lambda: controller.state.measured[6] > first[6] + 0.1)
    assert not controller.state.is_moving
    np.testing.assert_array_equal(controller.state.commanded, HOME + STEP)


def test_robot_that_loses_its_position_says_so_only_by_its_encoders(controller, faults):
    faults.arm(f.LOSES_POSITION, times=1)
    state = carry_out(controller, command(1, axes=HOME + STEP))
    assert state.refusal is Refusal.NONE
    np.testing.assert_array_equal(state.commanded, HOME + STEP)
    np.testing.assert_allclose(state.measured - state.commanded, [0.1, 0, 0, 0, 0, 0, 2.0])
    state = carry_out(controller, command(2, axes=HOME))
    np.testing.assert_array_equal(state.measured, HOME)


def test_wrong_acknowledgement_lasts_until_the_command_is_done(controller, faults):
    faults.arm(f.WRONG_ACK, times=1)
    controller.write(command(7, axes=HOME + LONG))
    wait_until(lambda: controller.state.acknowledged == 8)
    assert carry_out(controller, command(9, CommandType.HOLD)).acknowledged == 9


def test_scripted_fault_fails_the_move(controller, scene):
    scene.failure = DeviceFaultError("scripted", device="robot", code=900)
    assert carry_out(controller, command(1, axes=HOME + STEP)).refusal is Refusal.FAILED
    assert scene.stood == []


def test_scripted_timeout_never_starts_and_can_be_held(controller, scene):
    scene.failure = DeviceTimeoutError("scripted", device="robot")
    controller.write(command(1, axes=HOME + STEP))
    wait_until(lambda: scene.n_asked == 1)
    time.sleep(0.1)
    assert controller.state.done == 0
    assert carry_out(controller, command(2, CommandType.HOLD)).refusal is Refusal.HELD
    scene.failure = None
    assert carry_out(controller, command(3, axes=HOME + STEP)).refusal is Refusal.NONE
