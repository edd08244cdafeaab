"""The driver over real sockets against the simulated controller, by both ways in."""

import threading
import time

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from drivers.kuka.driver import open_robot
from drivers.kuka.simulator import faults as f
from drivers.kuka.simulator.controller import Controller
from drivers.kuka.simulator.eki import EkiServer
from drivers.kuka.simulator.kvp import KvpServer
from drivers.kuka.simulator.machine import Machine
from drivers.kuka.simulator.scene import EmptyScene
from tronlab.devices.readings import RobotTarget
from tronlab.devices.registry import DeviceContext
from tronlab.errors import (
    AccessDeniedError,
    DeviceError,
    DeviceFaultError,
    DeviceTimeoutError,
    LimitError,
    NotConnectedError,
    NotReadyError,
    ProtocolError,
    SafetyError,
)
from tronlab.kinematics.kr16 import forward
from tronlab.twin.state import ArmedFaults

NIMBLE = Machine(
    axis_speed_deg_per_s=(2000.0,) * 6,
    axis_ramp_s=0.05,
    rail_acceleration_mm_per_s2=50_000.0,
    path_acceleration_mm_per_s2=50_000.0,
)
"""Starts and stops faster than a KR 16, so that tests do not wait for it."""


@pytest.fixture
def faults():
    return ArmedFaults()


@pytest.fixture
def controller(faults):
    controller = Controller(EmptyScene(), faults, machine=NIMBLE)
    yield controller
    controller.close()


@pytest.fixture(params=["eki", "kvp"])
def protocol(request, controller, faults):
    """The options that lead to the simulated controller."""
    if request.param == "eki":
        server = EkiServer(controller, faults)
        ports = {
            "command_port": server.command_address[1],
            "state_port": server.state_address[1],
        }
    else:
        server = KvpServer(controller, faults)
        ports = {"port": server.address[1]}
    yield {"kind": request.param, **ports}
    server.close()


@pytest.fixture
def make(protocol):
    made = []

    def make_one():
        options = {
            "host": "127.0.0.1",
            "protocol": protocol,
            "timeout_s": 2.0,
            "rail_range_m": [-0.05, 4.4],
            "velocity_pct": 100,
            "acceleration_pct": 100,
            "settle": {"dwell_s": 0.01},
        }
        robot = open_robot(DeviceContext(name="arm", options=options, seed=0, world=None))
        made.append(robot)
        return robot

    yield make_one
    for robot in made:
        robot.close()


@pytest.fixture
def robot(make):
    robot = make()
    robot.connect()
    return robot


NEAR = (3.0, -87.0, 92.0, 4.0, 85.0, -5.0)
"""Near to where the simulated robot stands at first."""
FAR = RobotTarget(4.0, forward(np.radians(NEAR)))
"""Far enough to be still on the way when something happens."""


def target(rail_m=0.03, arm_deg=NEAR):
    return RobotTarget(rail_m, forward(np.radians(arm_deg)))


def test_connecting_moves_nothing(robot, controller):
    assert robot.identify().maker == "KUKA"
    assert robot.diagnose()["operating mode"] == "AUT"
    assert robot.read().rail_m == pytest.approx(0.0)
    assert controller.state.sequence == 0


def test_a_move_ends_where_it_was_told(robot, controller):
    robot.move(target(), timeout_s=20.0)
    reading = robot.read()
    assert reading.rail_m == pytest.approx(0.03, abs=1e-6)
    np.testing.assert_allclose(
        reading.base_from_flange.as_matrix(), target().base_from_flange.as_matrix(), atol=1e-6
    )
    np.testing.assert_allclose(controller.state.measured[:6], NEAR, atol=1e-5)
    assert not controller.state.is_moving


def test_a_way_down_the_rail_takes_two_commands(robot, controller):
    robot.move(target(0.05), timeout_s=20.0)
    robot.move(target(0.04), timeout_s=20.0)
    assert controller.state.sequence == 3
    assert robot.read().rail_m == pytest.approx(0.04, abs=1e-6)


def test_a_straight_line_ends_where_it_was_told(robot):
    robot.move(target(), timeout_s=20.0)
    goal = RigidTransform.from_translation([0.004, 0.002, 0.001]) * target().base_from_flange
    robot.move_linear(RobotTarget(0.03, goal), timeout_s=20.0)
    np.testing.assert_allclose(
        robot.read().base_from_flange.as_matrix(), goal.as_matrix(), atol=1e-6
    )


def test_the_next_connection_goes_on_counting(robot, controller):
    robot.move(target(), timeout_s=20.0)
    robot.close()
    robot.connect()
    robot.move(target(0.04), timeout_s=20.0)
    assert controller.state.done == 2 + 1  # approached anew: two commands


def test_messages_in_small_pieces_are_no_matter(robot, faults):
    faults.arm(f.SPLIT)
    robot.move(target(), timeout_s=20.0)
    assert robot.read().rail_m == pytest.approx(0.03, abs=1e-6)


def test_stop_from_another_thread_ends_a_move_on_the_way(robot, controller):
    errors = []

    def move():
        try:
            robot.move(FAR, timeout_s=60.0)
        except DeviceError as error:
            errors.append(error)

    thread = threading.Thread(target=move)
    thread.start()
    wait_for(lambda: controller.state.is_moving)
    robot.stop()
    thread.join()
    (error,) = errors
    assert isinstance(error, DeviceFaultError)
    assert "stopped by stop()" in str(error)
    assert not controller.state.is_moving
    assert robot.read().rail_m < 3.0
    robot.move(target(robot.read().rail_m + 0.03), timeout_s=20.0)


def test_a_move_that_takes_too_long_is_held(robot, controller):
    with pytest.raises(DeviceTimeoutError, match=r"^arm: move: not at the target"):
        robot.move(FAR, timeout_s=0.3)
    wait_for(lambda: not controller.state.is_moving)
    assert robot.read().rail_m < 3.0


@pytest.mark.parametrize(
    ("fault", "error", "message"),
    [
        (f.EMERGENCY_STOP, SafetyError, "emergency stop is pressed"),
        (f.GUARD_OPEN, SafetyError, "guard is open"),
        (f.STOP_MESSAGE, DeviceFaultError, "stop message is pending"),
        (f.DRIVES_OFF, NotReadyError, "drives are off"),
        (f.WRONG_MODE, NotReadyError, "operating mode is T1"),
    ],
)
def test_a_cell_that_is_not_ready_is_only_reported(
    robot, controller, faults, fault, error, message
):
    faults.arm(fault)
    wait_for(lambda: not robot.state().is_program_active)
    with pytest.raises(error, match=rf"^arm: move: .*{message}"):
        robot.move(target(), timeout_s=5.0)
    assert controller.state.sequence == 0
    faults.arm(fault, times=0)
    wait_for(lambda: robot.state().is_program_active)
    robot.move(target(), timeout_s=20.0)


@pytest.mark.parametrize(
    ("fault", "error"), [(f.EMERGENCY_STOP, SafetyError), (f.GUARD_OPEN, SafetyError)]
)
def test_a_cell_that_becomes_unsafe_ends_a_move(robot, controller, faults, fault, error):
    threading.Timer(0.3, faults.arm, [fault]).start()
    with pytest.raises(error, match=r"^arm: move: "):
        robot.move(FAR, timeout_s=60.0)
    wait_for(lambda: not controller.state.is_moving)
    assert controller.state.measured[6] < 3000.0


def test_a_robot_that_does_not_move_times_out(robot, faults):
    faults.arm(f.STUCK)
    time.sleep(0.15)  # until the controller has looked
    with pytest.raises(DeviceTimeoutError, match=r"^arm: move: not at the target"):
        robot.move(target(), timeout_s=0.5)


def test_a_robot_that_creeps_on_times_out(robot, faults):
    faults.arm(f.NOT_STILL)
    with pytest.raises(DeviceTimeoutError, match=r"^arm: move: done, but not still"):
        robot.move(target(), timeout_s=1.0)


def test_another_acknowledgement_is_a_protocol_error(robot, faults):
    faults.arm(f.WRONG_ACK, times=1)
    with pytest.raises(ProtocolError, match=r"^arm: move: the controller accepts command 2"):
        robot.move(target(), timeout_s=5.0)


def test_a_robot_that_loses_its_position_is_found_out(robot, faults):
    faults.arm(f.LOSES_POSITION, times=1)
    with pytest.raises(DeviceFaultError, match=r"says it is done, but A1 is at 3\.1000 deg"):
        robot.move(target(), timeout_s=20.0)


def test_silence_is_a_timeout_and_the_robot_answers_again_after_reconnecting(robot, faults):
    faults.arm(f.SILENT)
    with pytest.raises(DeviceTimeoutError, match=r"^arm: read: "):
        read(robot, times=3)  # a state may be on its way already
    faults.arm(f.SILENT, times=0)
    robot.close()
    robot.connect()
    assert robot.read().rail_m == pytest.approx(0.0)


def test_a_lost_connection_is_reported_and_can_be_made_again(robot, faults):
    faults.arm(f.DISCONNECT, times=1)
    with pytest.raises(NotConnectedError, match=r"^arm: read: "):
        read(robot, times=20)
    robot.close()
    robot.connect()
    assert robot.read().rail_m == pytest.approx(0.0)


def test_a_lost_connection_ends_a_move(robot, controller, faults):
    threading.Timer(0.3, faults.arm, [f.DISCONNECT], {"times": 1}).start()
    with pytest.raises(NotConnectedError, match=r"^arm: move: ") as caught:
        robot.move(FAR, timeout_s=60.0)
    assert "could not be told to hold" in caught.value.__notes__[0]


def test_an_override_above_the_cap_is_refused_and_left_alone(robot, controller):
    controller.set_override(80)
    with pytest.raises(LimitError, match=r"^arm: move: program override is 80 %, allowed up to 50"):
        robot.move(target(), timeout_s=5.0)
    assert controller.state.override_pct == 80
    assert controller.state.sequence == 0


@pytest.mark.parametrize("protocol", ["eki"], indirect=True)
def test_a_second_client_is_refused_by_ethernetkrl(robot, make):
    with pytest.raises(AccessDeniedError, match=r"^arm: connect: .*another client holds it"):
        make().connect()
    assert robot.read().rail_m == pytest.approx(0.0)


def test_variables_beside_ethernetkrl_tell_the_serial_number(controller, faults):
    eki, kvp = EkiServer(controller, faults), KvpServer(controller, faults)
    protocol = {
        "kind": "eki",
        "command_port": eki.command_address[1],
        "state_port": eki.state_address[1],
        "kvp_port": kvp.address[1],
    }
    options = {"host": "127.0.0.1", "protocol": protocol, "rail_range_m": [0.0, 4.4]}
    robot = open_robot(DeviceContext(name="arm", options=options, seed=0, world=None))
    robot.connect()
    assert robot.identify().serial == controller.machine.serial
    robot.close()
    eki.close()
    kvp.close()


def test_no_thread_is_left(make):
    before = threading.active_count()
    robot = make()
    robot.connect()
    robot.close()
    wait_for(lambda: threading.active_count() <= before)


def read(robot, *, times):
    for _ in range(times):
        robot.read()


def wait_for(condition):
    give_up = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < give_up, "waited in vain"
        time.sleep(0.01)
