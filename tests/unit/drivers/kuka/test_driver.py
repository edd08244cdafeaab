"""The driver's decisions, against a controller that is played by the test."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from drivers.kuka.backend import CommandKind, ControllerState, Mode
from drivers.kuka.driver import KukaRobot, open_robot
from drivers.kuka.options import KukaOptions
from drivers.kuka.position import Axes
from tronlab.devices.readings import DeviceIdentity, RobotTarget
from tronlab.devices.registry import DeviceContext
from tronlab.errors import (
    ConfigError,
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

HOME = Axes.from_controller((0, -90, 90, 0, 40, 0), 1000.0)
OPTIONS = {
    "host": "192.0.2.1",
    "protocol": {"kind": "eki"},
    "timeout_s": 0.2,
    "rail_range_m": [-0.05, 4.4],
    "settle": {"dwell_s": 0.0},
}
FINE = ControllerState(
    reading=0,
    accepted_id=0,
    done_id=0,
    error=0,
    axes=HOME,
    is_moving=False,
    has_stop_message=False,
    are_drives_on=True,
    is_emergency_stop_released=True,
    is_guard_closed=True,
    mode=Mode.EXT,
    override_pct=30,
    is_program_active=True,
    time_s=1.0,
)


class Controller:
    """A back end that carries out commands: accepted at the first look, done at the third.

    ``during`` is laid over every state between, ``after`` over those once a motion is done.
    """

    def __init__(self):
        self.now = FINE
        self.sent = []
        self.model = "KR 16"
        self.during = {}
        self.after = {}
        self.look = lambda state: state
        self.is_open = False
        self.base_from_root = RigidTransform.identity()
        self._n_looks = 0

    @property
    def motions(self):
        return [command for command in self.sent if command.kind is not CommandKind.HOLD]

    @property
    def n_holds(self):
        return len(self.sent) - len(self.motions)

    def connect(self):
        self.is_open = True

    def close(self):
        self.is_open = False

    def identify(self, *, call):
        return DeviceIdentity("KUKA", self.model, "", "")

    def send(self, command, *, call):
        self.sent.append(command)
        self._n_looks = 0
        if command.kind is CommandKind.HOLD:
            n = len(self.sent)
            self.now = replace(self.now, accepted_id=n, done_id=n, is_moving=False)
        return len(self.sent)

    def position(self, *, call):
        return self.base_from_root * forward(self.now.axes.arm_rad)

    def state(self, *, call):
        self._n_looks += 1
        if self.sent and self.now.done_id < len(self.sent):
            self._carry_out(self.sent[-1])
        self.now = replace(self.now, reading=self.now.reading + 1)
        return self.look(self.now)

    def _carry_out(self, command):
        n = len(self.sent)
        if self._n_looks < 3:
            self.now = replace(self.now, **{"accepted_id": n, "is_moving": True} | self.during)
            return
        arrived = {
            "accepted_id": n,
            "done_id": n,
            "is_moving": False,
            "axes": command.axes,
        }
        self.now = replace(self.now, **arrived | self.after)


@pytest.fixture(autouse=True)
def _no_waiting(monkeypatch):
    monkeypatch.setattr("drivers.kuka.motion.POLL_S", 0.001)


@pytest.fixture
def controller():
    return Controller()


@pytest.fixture
def make(controller):
    def make_one(**changes):
        context = DeviceContext(name="arm", options=OPTIONS | changes, seed=0, world=None)
        robot = KukaRobot("arm", context.parse_options(KukaOptions), controller)
        robot.connect()
        return robot

    return make_one


@pytest.fixture
def robot(make):
    return make()


def target(rail_m=1.5, arm_deg=(5, -85, 95, 10, 45, -5)):
    return RobotTarget(rail_m, forward(np.radians(arm_deg)))


# --- Where it goes


def test_a_move_ends_at_the_axes_of_its_target(robot, controller):
    robot.move(target(), timeout_s=5.0)
    (command,) = controller.sent
    assert command.kind is CommandKind.PTP_AXES
    assert command.axes.arm_deg == pytest.approx((5, -85, 95, 10, 45, -5))
    assert command.axes.e1_mm == pytest.approx(1500.0)
    assert (command.velocity_pct, command.acceleration_pct) == (20, 50)


def test_what_is_read_is_where_the_encoders_say_it_stands(robot):
    robot.move(target(), timeout_s=5.0)
    reading = robot.read()
    assert reading.rail_m == pytest.approx(1.5)
    np.testing.assert_allclose(
        reading.base_from_flange.as_matrix(), target().base_from_flange.as_matrix(), atol=1e-9
    )
    assert reading.time_s == 1.0


def test_zero_and_sign_of_the_rail_are_the_rig_files(make, controller):
    robot = make(rail_zero_mm=2000.0, rail_sign=-1)
    assert robot.read().rail_m == pytest.approx(1.0)
    robot.move(target(1.5), timeout_s=5.0)
    assert controller.sent[-1].axes.e1_mm == pytest.approx(500.0)


def test_axes_can_be_commanded_themselves(robot, controller):
    axes = Axes.from_controller((10, -80, 90, 200, 30, -300), 1200.0)
    robot.move_axes(axes, timeout_s=5.0)
    assert controller.sent[-1].axes == axes


def test_the_branch_nearest_to_where_it_stands_is_taken(robot, controller):
    flipped = (0, -90, 90, 180, -40, 180)
    controller.now = replace(FINE, axes=Axes.from_controller(flipped, 1000.0))
    robot.move(target(1.5, HOME.arm_deg), timeout_s=5.0)
    assert controller.sent[-1].axes.arm_deg == pytest.approx(flipped, abs=1e-6)


# --- The rail comes from below


def rails(controller):
    return [round(command.axes.e1_mm, 6) for command in controller.motions]


def test_a_way_up_is_direct_and_a_way_down_passes_below_the_target(robot, controller):
    robot.move(target(1.5), timeout_s=5.0)
    robot.move(target(1.2), timeout_s=5.0)
    robot.move(target(1.201), timeout_s=5.0)
    assert rails(controller) == [1500, 1180, 1200, 1201]


def test_the_arm_is_in_place_before_the_last_of_the_rail(robot, controller):
    robot.move(target(0.5), timeout_s=5.0)
    below, at = controller.motions
    assert below.axes.arm_rad == at.axes.arm_rad


def test_a_rail_that_stays_needs_no_approach_once_it_was_approached(robot, controller):
    robot.move(target(1.5), timeout_s=5.0)
    robot.move(target(1.5, HOME.arm_deg), timeout_s=5.0)
    assert rails(controller) == [1500, 1500]


def test_nobody_knows_from_where_a_rail_came_that_stands_there_at_first(robot, controller):
    robot.move(target(1.0), timeout_s=5.0)
    assert rails(controller) == [980, 1000]


def test_a_short_way_up_is_no_approach_unless_the_rail_was_approached(robot, controller):
    robot.move(target(1.01), timeout_s=5.0)
    assert rails(controller) == [990, 1010]


@pytest.mark.parametrize("forget", ["stop", "connect"])
def test_after_a_stop_the_rail_is_approached_anew(robot, controller, forget):
    robot.move(target(1.5), timeout_s=5.0)
    getattr(robot, forget)()
    robot.move(target(1.5), timeout_s=5.0)
    assert rails(controller) == [1500, 1480, 1500]


def test_without_an_approach_every_way_is_direct(make, controller):
    robot = make(rail_approach_m=0.0)
    robot.move(target(0.5), timeout_s=5.0)
    assert rails(controller) == [500]


# --- What it refuses


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (target(4.41), r"rail position is 4\.4100 m, allowed -0\.0300 to 4\.4000 m"),
        (target(-0.04), r"rail position is -0\.0400 m, allowed -0\.0300"),
        (
            RobotTarget(1.0, RigidTransform.from_translation([3.0, 0, 0])),
            r"out of reach: .* allowed 0\.00",
        ),
    ],
)
@pytest.mark.parametrize("call", ["check", "move"])
def test_targets_out_of_reach_are_refused_and_nothing_moves(
    robot, controller, call, wrong, message
):
    arguments = {"timeout_s": 5.0} if call == "move" else {}
    with pytest.raises(LimitError, match=rf"^arm: {call}: {message}"):
        getattr(robot, call)(wrong, **arguments)
    assert controller.sent == []


def test_narrower_limits_of_the_rig_file_are_kept(make, controller):
    robot = make(axis_limits_deg={"a1": [-3, 3]})
    with pytest.raises(LimitError, match=r"^arm: move: .*A1 is 5\.0000 deg, allowed -3 to 3"):
        robot.move(target(), timeout_s=5.0)
    with pytest.raises(LimitError, match=r"^arm: move_axes: A1 is 10\.0000 deg, allowed -3 to 3"):
        robot.move_axes(Axes.from_controller((10, -90, 90, 0, 40, 0), 1000.0), timeout_s=5.0)
    assert controller.sent == []


def test_axes_with_a_rail_out_of_range_are_refused(robot):
    with pytest.raises(LimitError, match=r"^arm: move_axes: rail position is 9\.0000 m"):
        robot.move_axes(replace(HOME, e1_m=9.0), timeout_s=5.0)


NOT_NOW = [
    ({"is_emergency_stop_released": False}, SafetyError, "emergency stop is pressed"),
    ({"is_guard_closed": False, "are_drives_on": False}, SafetyError, "guard is open"),
    ({"has_stop_message": True, "error": 6}, DeviceFaultError, "stop message is pending.*code 6"),
    ({"are_drives_on": False}, NotReadyError, "drives are off"),
    ({"mode": Mode.T1}, NotReadyError, "operating mode is T1, allowed AUT, EXT"),
    ({"is_program_active": False}, NotReadyError, "program does not run"),
]


@pytest.mark.parametrize(
    ("state", "error", "message"),
    [
        *NOT_NOW,
        ({"override_pct": 51}, LimitError, "override is 51 %, allowed up to 50 %"),
        ({"override_pct": 0}, NotReadyError, "override is 0 %"),
        ({"is_moving": True}, NotReadyError, "still busy"),
        ({"accepted_id": 3}, NotReadyError, "still busy with command 3"),
    ],
)
def test_a_controller_that_may_not_move_is_sent_nothing(robot, controller, state, error, message):
    controller.now = replace(FINE, **state)
    with pytest.raises(error, match=rf"^arm: move: .*{message}"):
        robot.move(target(), timeout_s=5.0)
    assert controller.sent == []


def test_t1_can_be_allowed_for_first_trials(make, controller):
    controller.now = replace(FINE, mode=Mode.T1)
    make(operating_modes=["T1"]).move(target(), timeout_s=5.0)
    assert len(controller.motions) == 1


# --- What can go wrong on the way


@pytest.mark.parametrize(("state", "error", "message"), NOT_NOW)
def test_what_comes_up_during_a_motion_holds_it(robot, controller, state, error, message):
    controller.during = state
    with pytest.raises(error, match=rf"^arm: move: .*{message}"):
        robot.move(target(), timeout_s=5.0)
    assert controller.n_holds == 1


@pytest.mark.parametrize(
    ("code", "error", "message"),
    [
        (1, DeviceFaultError, "does not know this kind"),
        (2, LimitError, "an axis would leave its software limits"),
        (3, LimitError, "the rail would leave its software limits"),
        (4, NotReadyError, "not ready"),
        (5, DeviceFaultError, "held before the target"),
        (6, DeviceFaultError, "the motion failed"),
        (77, DeviceFaultError, "unknown error"),
    ],
)
def test_a_refusal_of_the_controller_keeps_its_number(robot, controller, code, error, message):
    controller.after = {"error": code}
    with pytest.raises(error, match=rf"^arm: move: .*{message}.*code {code}") as caught:
        robot.move(target(), timeout_s=5.0)
    if isinstance(caught.value, DeviceFaultError):
        assert caught.value.code == code


def test_a_command_that_is_not_accepted_times_out_and_is_held(robot, controller):
    controller.look = lambda state: replace(FINE, reading=state.reading)
    with pytest.raises(DeviceTimeoutError, match=r"^arm: move: .*does not accept"):
        robot.move(target(), timeout_s=5.0)
    assert controller.n_holds == 1


def test_the_acceptance_of_another_command_is_an_error(robot, controller):
    controller.during = {"accepted_id": 9}
    with pytest.raises(ProtocolError, match=r"^arm: move: .*accepts command 9, sent was 1"):
        robot.move(target(), timeout_s=5.0)
    assert controller.n_holds == 1


def test_a_hold_that_was_accepted_late_is_not_taken_for_a_foreign_command(robot, controller):
    controller.sent = [None] * 7
    controller.now = replace(FINE, accepted_id=7, done_id=7)
    told = iter([5, 5, 7])  # as if hold 7 had waited until command 8 was sent

    def look(state):
        n = next(told, None)
        return state if n is None else replace(state, accepted_id=n, done_id=n)

    controller.look = look
    robot.move(target(), timeout_s=5.0)
    assert next(told, None) is None
    assert controller.now.done_id == 8


def test_a_command_that_may_have_arrived_is_held(robot, controller):
    """Its confirmation is lost, and nobody knows whether it is carried out."""

    def send(command, *, call):
        number = Controller.send(controller, command, call=call)
        if command.kind is not CommandKind.HOLD:
            raise DeviceTimeoutError(f"{call}: LAB_SEQ: no answer in 2 s", device="arm")
        return number

    controller.send = send
    with pytest.raises(DeviceTimeoutError, match=r"^arm: move: LAB_SEQ"):
        robot.move(target(), timeout_s=5.0)
    assert controller.n_holds == 1


def test_a_motion_that_does_not_end_is_held_and_times_out(robot, controller):
    def stuck(state):
        return replace(state, accepted_id=len(controller.sent), done_id=0, is_moving=True)

    controller.look = lambda state: stuck(state) if controller.sent else state
    with pytest.raises(DeviceTimeoutError, match=r"^arm: move: not at the target"):
        robot.move(target(), timeout_s=0.1)
    assert controller.n_holds == 1


def test_done_while_still_moving_is_not_done(robot, controller):
    controller.look = lambda state: replace(state, is_moving=bool(controller.sent))
    with pytest.raises(DeviceTimeoutError, match=r"not at the target"):
        robot.move(target(), timeout_s=0.1)


@pytest.mark.parametrize("creeping", ["E1", "A1"])
def test_a_robot_that_creeps_on_is_not_still(robot, controller, creeping):
    def creep(state):
        if state.done_id == 0:
            return state
        step = 0.1 * state.reading
        arm_deg = list(state.axes.arm_deg)
        arm_deg[0] += step * 0.05 * (creeping == "A1")
        e1_mm = state.axes.e1_mm + step * (creeping == "E1")
        return replace(state, axes=Axes.from_controller(arm_deg, e1_mm))

    controller.look = creep
    with pytest.raises(DeviceTimeoutError, match=r"^arm: move: done, but not still: 0\.\d+ mm"):
        robot.move(target(), timeout_s=0.3)
    assert controller.n_holds == 1


def test_readings_that_agree_must_agree_still_after_the_dwell(robot, controller):
    looks_when_done = []

    def slip(state):
        if state.done_id == 0:
            return state
        looks_when_done.append(state)
        off_m = 1e-4 if len(looks_when_done) <= 4 else 0.0  # the first of them ended the motion
        return replace(state, axes=replace(state.axes, e1_m=state.axes.e1_m + off_m))

    controller.look = slip
    robot.move(target(), timeout_s=5.0)
    assert len(looks_when_done) == 1 + 3 + 1 + 2 + 1


@pytest.mark.parametrize(
    ("off", "message"),
    [
        ({"e1_mm": 2.0}, r"E1 is at 1502\.000 mm, commanded 1500\.000, allowed 0\.2 mm off"),
        ({"a3_deg": 0.1}, r"A3 is at 95\.1000 deg, commanded 95\.0000, allowed 0\.02 deg off"),
    ],
)
def test_done_somewhere_else_is_a_fault(robot, controller, off, message):
    arm_deg = np.add((5, -85, 95, 10, 45, -5), np.eye(6)[2] * off.get("a3_deg", 0.0))
    axes = Axes.from_controller(tuple(arm_deg), 1500.0 + off.get("e1_mm", 0.0))
    controller.after = {"axes": axes}
    with pytest.raises(DeviceFaultError, match=rf"^arm: move: .*says it is done, but {message}"):
        robot.move(target(), timeout_s=5.0)


def test_after_a_failure_the_rail_is_approached_anew(robot, controller):
    robot.move(target(1.5), timeout_s=5.0)
    controller.after = {"error": 6}
    with pytest.raises(DeviceFaultError):
        robot.move(target(1.6), timeout_s=5.0)
    controller.after = {}
    controller.now = replace(controller.now, error=0)
    controller.sent.clear()
    controller.now = replace(controller.now, accepted_id=0, done_id=0)
    robot.move(target(1.6), timeout_s=5.0)
    assert rails(controller) == [1580, 1600]


def test_an_error_says_so_if_the_robot_could_not_even_be_told_to_hold(robot, controller):
    def send(command, *, call):
        if command.kind is CommandKind.HOLD:
            raise NotConnectedError(f"{call}: lost", device="arm")
        return Controller.send(controller, command, call=call)

    controller.send = send
    controller.during = {"is_guard_closed": False}
    with pytest.raises(SafetyError) as caught:
        robot.move(target(), timeout_s=5.0)
    assert caught.value.__notes__ == ["and it could not be told to hold: arm: move: lost"]


# --- Stopping


def test_stop_from_another_thread_ends_a_move(robot, controller):
    controller.during = {"is_moving": True}
    is_moving, let_go = threading.Event(), threading.Event()

    def look(state):
        if controller.sent and not let_go.is_set():
            is_moving.set()
            let_go.wait(5.0)
        return state

    controller.look = look
    errors = []

    def move():
        try:
            robot.move(target(), timeout_s=30.0)
        except DeviceError as error:
            errors.append(error)

    thread = threading.Thread(target=move)
    thread.start()
    assert is_moving.wait(5.0)
    threading.Timer(0.05, let_go.set).start()
    robot.stop()
    thread.join()
    (error,) = errors
    assert isinstance(error, DeviceFaultError)
    assert str(error).startswith("arm: move: stopped by stop()")
    assert controller.n_holds == 1


def test_a_stop_is_forgotten_at_the_next_move(robot, controller):
    robot.stop()
    robot.move(target(), timeout_s=5.0)
    assert len(controller.motions) == 1


def test_a_stop_that_is_not_confirmed_says_what_to_do(robot, controller, monkeypatch):
    monkeypatch.setattr("drivers.kuka.driver._STOP_TIMEOUT_S", 0.05)
    controller.look = lambda state: replace(state, is_moving=True)
    with pytest.raises(DeviceTimeoutError, match=r"^arm: stop: .*use the emergency stop"):
        robot.stop()


def test_a_robot_without_drives_stands_whether_it_confirms_or_not(robot, controller):
    controller.look = lambda state: replace(state, are_drives_on=False, done_id=0)
    robot.stop()
    assert controller.n_holds == 1


def test_two_moves_at_once_are_refused(robot, controller):
    is_moving, go_on = threading.Event(), threading.Event()

    def look(state):
        if controller.sent:
            is_moving.set()
            go_on.wait(5.0)
        return state

    controller.look = look
    thread = threading.Thread(target=robot.move, args=(target(),), kwargs={"timeout_s": 30.0})
    thread.start()
    assert is_moving.wait(5.0)
    with pytest.raises(NotReadyError, match=r"^arm: move: another thread moves the robot"):
        robot.move(target(), timeout_s=1.0)
    go_on.set()
    thread.join()
    assert len(controller.motions) == 1


# --- Straight lines


def shifted(pose, *xyz_m):
    return RigidTransform.from_translation(xyz_m) * pose


def test_a_line_is_sent_as_pose_and_as_axes(robot, controller):
    robot.move(target(1.5), timeout_s=5.0)
    goal = shifted(target().base_from_flange, 0.01, -0.02, 0.0)
    robot.move_linear(RobotTarget(1.5, goal), timeout_s=5.0)
    command = controller.sent[-1]
    assert command.kind is CommandKind.LINEAR
    np.testing.assert_allclose(command.base_from_flange.as_matrix(), goal.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(
        forward(command.axes.arm_rad).as_matrix(), goal.as_matrix(), atol=1e-9
    )


def test_a_line_that_leads_the_rail_back_is_refused(robot, controller):
    robot.move(target(1.5), timeout_s=5.0)
    with pytest.raises(LimitError, match=r"^arm: move_linear: the rail would come .*from above"):
        robot.move_linear(target(1.4), timeout_s=5.0)
    assert len(controller.sent) == 1


def test_a_line_through_a_singularity_is_refused_by_its_name(robot, controller):
    robot.move(target(1.5, (0, -90, 90, 0, 5, 0)), timeout_s=5.0)
    with pytest.raises(LimitError, match=r"wrist \(A5 is .*stays in its branch; use move"):
        robot.move_linear(target(1.5, (0, -90, 90, 0, -5, 0)), timeout_s=5.0)
    assert len(controller.sent) == 1


def test_a_line_needs_tool_and_base_to_be_none(robot, controller):
    robot.move(target(1.5), timeout_s=5.0)
    controller.base_from_root = RigidTransform.from_translation([1.5, 0, 0])
    with pytest.raises(LimitError, match=r"^arm: move_linear: .*1500\.0 mm .*rail is coupled"):
        robot.move_linear(target(1.5), timeout_s=5.0)


# --- Connecting


@pytest.mark.parametrize(
    ("call", "arguments"),
    [
        ("identify", {}),
        ("state", {}),
        ("diagnose", {}),
        ("read", {}),
        ("stop", {}),
        ("check", {"target": target()}),
        ("move", {"target": target(), "timeout_s": 1.0}),
        ("move_linear", {"target": target(), "timeout_s": 1.0}),
        ("move_axes", {"axes": HOME, "timeout_s": 1.0}),
    ],
)
def test_use_before_connect_and_after_close_names_the_call(robot, call, arguments):
    robot.close()
    robot.close()
    with pytest.raises(NotConnectedError, match=rf"^arm: {call}: not connected; call connect\(\)"):
        getattr(robot, call)(**arguments)


@pytest.mark.parametrize("model", ["KR 16", "KR16 C2 FLR ZH16", "kr16-2", "KR 16 R1610"])
def test_a_kr_16_by_any_of_its_names_is_accepted(robot, controller, model):
    controller.model = model
    robot.connect()
    assert controller.sent == []


@pytest.mark.parametrize("model", ["KR 160", "KR6 R900", ""])
def test_another_robot_is_refused_and_the_connection_closed(robot, controller, model):
    controller.model = model
    with pytest.raises(DeviceError, match=rf"^arm: connect: .*drives a '{model}', allowed"):
        robot.connect()
    assert not controller.is_open


def test_the_state_in_words_says_whether_it_could_move(robot, controller):
    controller.now = replace(FINE, is_guard_closed=False, mode=Mode.T1)
    facts = robot.diagnose()
    assert facts["guard"] == "open"
    assert facts["operating mode"] == "T1"
    assert facts["rail"] == "1.0000 m"
    assert facts["axes"].startswith("A1 0.0000, A2 -90.0000")


def options(**changes):
    return DeviceContext(name="arm", options=OPTIONS | changes, seed=0, world=None)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"protocol": {"kind": "rsi"}}, r"protocol.*'rsi'"),
        ({"rail_range_m": [1.0, 0.0]}, r"rail_range_m: \[1, 0\] m, allowed is an ordered range"),
        ({"rail_range_m": [0.0, 0.01]}, r"longer than rail_approach_m"),
        ({"velocity_pct": 0}, r"velocity_pct: must be greater than or equal to 1"),
        ({"axis_limits_deg": {"a2": [-160, 0]}}, r"a2: \[-160, 0\] deg, allowed .*\[-155, 35\]"),
        ({"axis_limits_deg": {"a2": [0, -10]}}, r"a2: \[0, -10\] deg, allowed is a range"),
        ({"velocity": 10}, r"unknown key, did you mean velocity_pct \(in per cent\)"),
        ({"rail_sign": 0}, r"rail_sign"),
    ],
)
def test_options_that_cannot_be_are_named(changes, message):
    with pytest.raises(ConfigError, match=rf"^devices\.arm\.options.*{message}"):
        open_robot(options(**changes))


@pytest.mark.parametrize("protocol", [{"kind": "eki"}, {"kind": "kvp", "port": 7001}])
def test_the_factory_touches_no_network(protocol):
    robot = open_robot(options(protocol=protocol))
    assert robot.name == "arm"
    robot.close()
