"""The simulated controller: one robot, and the KRL program that carries out the PC's commands.

The program takes one command at a time. What arrives meanwhile waits in a single place: a later
command replaces it, and a hold jumps the queue. Everything happens at ticks of one thread.
"""

import sys
import threading
import time
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from drivers.kuka.simulator import faults as f
from drivers.kuka.simulator.cell import Cell, look_at_cell
from drivers.kuka.simulator.command import FREE, Command, CommandType, Refusal, Refused
from drivers.kuka.simulator.machine import (
    KR16,
    N_ARM,
    RAIL,
    Machine,
    axes_at,
    flange_at,
    flange_of,
    has_axes,
)
from drivers.kuka.simulator.motion import (
    Brake,
    LinePath,
    Path,
    Profile,
    Trapezoid,
    axis_path,
    axis_profile,
    line_profile,
)
from drivers.kuka.simulator.scene import Scene
from tronlab.devices.readings import RobotTarget
from tronlab.errors import ConfigError, DeviceError, DeviceTimeoutError, TronlabError
from tronlab.geometry.poses import FloatArray
from tronlab.twin.state import Faults

_TICK_S: Final = 0.02
_CELL_PERIOD_S: Final = 0.1
"""The cell is looked at so often while nothing is begun; it may be in another process."""
_START_NEAR = np.array([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
_LOST = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0])
"""How far off a robot that loses its position ends: 0.1 deg on A1, 2 mm on E1."""
_CREEP_PER_S = np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0])


@dataclass(frozen=True, slots=True)
class ControllerState:
    """What the controller tells of itself."""

    commanded: FloatArray
    """$AXIS_ACT: A1 to A6 in degrees, E1 in mm, shape (7,)."""
    measured: FloatArray
    """$AXIS_ACT_MEAS, likewise."""
    cell: Cell
    override_pct: int
    is_moving: bool = False
    sequence: int = 0
    """Number of the command that came last."""
    acknowledged: int = 0
    """Number of the command that was accepted last."""
    done: int = 0
    """Number of the command that was finished or refused last."""
    refusal: Refusal = Refusal.NONE


@dataclass
class _Motion:
    """A motion under way."""

    number: int
    path: Path
    profile: Profile
    slip_before: FloatArray
    slip_after: FloatArray
    can_start: bool = True
    time_s: float = 0.0
    outcome: Refusal = Refusal.NONE

    @property
    def is_braking(self) -> bool:
        return isinstance(self.profile, Brake)

    def go_on(self, elapsed_s: float, *, override: float) -> None:
        """Let time pass; the override stretches it, except while braking."""
        self.time_s += elapsed_s * (1.0 if self.is_braking else override)

    def brake(self, outcome: Refusal, *, override: float) -> None:
        """Slow down from here, on the path."""
        if isinstance(self.profile, Trapezoid):
            progress, speed = self.profile.at(self.time_s)
            self.profile = Brake(progress, override * speed, self.profile.acceleration)
            self.time_s = 0.0
        self.outcome = outcome


@dataclass
class _Inbox:
    """What the PC wrote and the program has not taken yet."""

    lock: threading.Lock = field(default_factory=threading.Lock)
    command: Command | None = None
    hold: Command | None = None

    def put(self, command: Command) -> None:
        with self.lock:
            if command.type == CommandType.HOLD:
                self.hold, self.command = command, None
            else:
                self.command = command

    def take_hold(self) -> Command | None:
        with self.lock:
            hold, self.hold = self.hold, None
            return hold

    def take_command(self) -> Command | None:
        with self.lock:
            command, self.command = self.command, None
            return command


class Controller:
    """A robot and its program, over a scene; runs until closed.

    Raises:
        ConfigError: The arm cannot be where the scene says that it stands.
    """

    def __init__(
        self,
        scene: Scene,
        faults: Faults,
        *,
        machine: Machine = KR16,
        override_pct: int = 50,
    ) -> None:
        self.machine = machine
        self._scene = scene
        self._faults = faults
        self._inbox = _Inbox()
        self._motion: _Motion | None = None
        self._slip = np.zeros(RAIL + 1)
        self._progress = 1.0
        self._has_stop_message = False
        self._is_stuck = self._creeps = False
        self._next_look_s = 0.0
        self._state_lock = threading.Lock()
        axes = _axes_of(scene.robot_at(), machine)
        self._state = ControllerState(axes, axes, look_at_cell(faults), override_pct)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="robot", daemon=True)
        self._thread.start()

    @property
    def state(self) -> ControllerState:
        """Get the state as of the last tick."""
        return self._state

    def write(self, command: Command) -> None:
        """Let the program have a command; one with the number of the last changes nothing."""
        if command.number != self._state.sequence:
            self._change(sequence=command.number)
            self._inbox.put(command)

    def set_override(self, override_pct: int) -> None:
        """Set $OV_PRO."""
        self._change(override_pct=override_pct)

    def stop_program(self, reason: str) -> None:
        """Stop with a message, as the controller does at a fault of the program."""
        print(f"robot: {reason}", file=sys.stderr, flush=True)
        self._has_stop_message = True
        self._next_look_s = 0.0

    def confirm(self) -> None:
        """Confirm the controller's own messages and start the program again, as a person would."""
        self._has_stop_message = False
        self._next_look_s = 0.0

    def close(self) -> None:
        """Stop where the robot stands."""
        self._stopped.set()
        self._thread.join()

    def _run(self) -> None:
        last_s = time.monotonic()
        while not self._stopped.wait(_TICK_S):
            now_s = time.monotonic()
            try:
                self._tick(now_s, now_s - last_s)
            except TronlabError as error:  # the laboratory around it is gone
                print(f"robot: stopped: {error}", file=sys.stderr, flush=True)
                return
            last_s = now_s

    def _tick(self, now_s: float, elapsed_s: float) -> None:
        if now_s >= self._next_look_s:
            self._look_at_cell(now_s)
        if (hold := self._inbox.take_hold()) is not None:
            self._hold(hold)
        if self._motion is None and (command := self._inbox.take_command()) is not None:
            self._look_at_cell(now_s)
            self._accept(command)
        if self._motion is not None:
            self._advance(self._motion, elapsed_s)
        elif self._creeps:
            self._creep(elapsed_s)

    def _look_at_cell(self, now_s: float) -> None:
        cell = look_at_cell(self._faults, has_stop_message=self._has_stop_message)
        self._next_look_s = now_s + _CELL_PERIOD_S
        self._is_stuck = self._faults.is_armed(f.STUCK)
        self._creeps = self._faults.is_armed(f.NOT_STILL)
        self._change(cell=cell)

    def _hold(self, command: Command) -> None:
        self._change(acknowledged=self._acknowledgement(command))
        if self._motion is None:
            self._finish(command.number, Refusal.NONE)
        else:
            self._motion.brake(Refusal.HELD, override=self._override)
            self._motion.number = command.number

    def _accept(self, command: Command) -> None:
        self._change(acknowledged=self._acknowledgement(command), refusal=Refusal.NONE)
        try:
            self._motion = self._prepare(command)
        except Refused as refused:
            self._finish(command.number, refused.refusal)
        else:
            if self._motion is None:
                self._finish(command.number, Refusal.NONE)

    def _finish(self, number: int, outcome: Refusal) -> None:
        self._change(acknowledged=number, done=number, refusal=outcome)

    def _acknowledgement(self, command: Command) -> int:
        return command.number + 1 if self._faults.strike(f.WRONG_ACK) else command.number

    def _prepare(self, command: Command) -> _Motion | None:
        """Make the motion of a command; None if nothing is to move.

        Raises:
            Refused: It must not, or cannot, be.
        """
        if not command.is_complete:
            raise Refused(Refusal.FAILED)
        if not command.is_readable:
            self.stop_program(f"command {command.number}: a value is not initialised")
            raise Refused(Refusal.FAILED)
        if command.type == CommandType.PING:
            return None
        if not command.is_move:
            raise Refused(Refusal.UNKNOWN_TYPE)
        if not self._state.cell.is_program_active:
            raise Refused(Refusal.NOT_READY)
        percentages = command.velocity_pct, command.acceleration_pct
        if command.tool or command.base or not all(1 <= pct <= 100 for pct in percentages):
            raise Refused(Refusal.FAILED)
        path, profile = self._plan(command)
        return self._start(command.number, path, profile)

    def _plan(self, command: Command) -> tuple[Path, Profile]:
        here, end = self._state.commanded, self._end_of(command)
        self._check_limits(end)
        shares = {"speed": command.velocity_pct / 100, "ramp": command.acceleration_pct / 100}
        if command.type == CommandType.LIN:
            goal = flange_at(command.position)
            line = LinePath(here, goal, float(end[RAIL]), self.machine)
            return line, line_profile(line, self.machine, **shares)
        path = axis_path(here, end)
        return path, axis_profile(path, self.machine, **shares)

    def _start(self, number: int, path: Path, profile: Profile) -> _Motion:
        can_start = True
        try:
            self._scene.begin_move(self._target(path.at(1.0)))
        except DeviceTimeoutError:
            can_start = False
        except DeviceError as error:
            raise Refused(Refusal.FAILED) from error
        slip = _LOST if self._faults.strike(f.LOSES_POSITION) else np.zeros(RAIL + 1)
        return _Motion(number, path, profile, self._slip, slip, can_start)

    def _end_of(self, command: Command) -> FloatArray:
        """Give the axes at the end of a move, which may be beyond their limits."""
        if command.type == CommandType.PTP_AXIS:
            return command.axes
        position, is_line = command.position, command.type == CommandType.LIN
        goal = flange_at(position)
        arm = axes_at(
            goal,
            self._state.commanded,
            self.machine,
            status=FREE if is_line else position.status,  # a line ignores S and T
            turn=FREE if is_line else position.turn,
        )
        if arm is None:
            raise Refused(Refusal.AXIS_LIMIT if has_axes(goal) else Refusal.FAILED)
        return np.array([*arm, position.e1_mm])

    def _check_limits(self, end: FloatArray) -> None:
        is_allowed = self.machine.is_allowed(end)
        if not is_allowed[:N_ARM].all():
            raise Refused(Refusal.AXIS_LIMIT)
        if not is_allowed[RAIL]:
            raise Refused(Refusal.RAIL_LIMIT)

    def _advance(self, motion: _Motion, elapsed_s: float) -> None:
        if not self._state.cell.is_program_active and not motion.is_braking:
            motion.brake(Refusal.NOT_READY, override=self._override)
        if not motion.is_braking and (self._is_stuck or not motion.can_start):
            return
        motion.go_on(elapsed_s, override=self._override)
        progress, _ = motion.profile.at(motion.time_s)
        commanded = motion.path.at(progress)
        self._slip = motion.slip_before + progress * (motion.slip_after - motion.slip_before)
        is_over = motion.time_s >= motion.profile.duration_s
        self._progress = progress
        self._stand(commanded, is_moving=not is_over)
        if is_over:
            self._motion = None
            self._finish(motion.number, motion.outcome)

    def _creep(self, elapsed_s: float) -> None:
        self._slip = self._slip + elapsed_s * _CREEP_PER_S
        self._stand(self._state.commanded, is_moving=False)

    def _stand(self, commanded: FloatArray, *, is_moving: bool) -> None:
        measured = commanded + self._slip
        self._scene.stand(self._target(measured), progress=self._progress)
        self._change(commanded=commanded, measured=measured, is_moving=is_moving)

    @property
    def _override(self) -> float:
        return self._state.override_pct / 100

    def _target(self, axes: FloatArray) -> RobotTarget:
        return RobotTarget(self.machine.rail_m(float(axes[RAIL])), flange_of(axes))

    def _change(self, **values: object) -> None:
        with self._state_lock:
            self._state = replace(self._state, **values)  # pyright: ignore[reportArgumentType]  # fields of it


def _axes_of(target: RobotTarget, machine: Machine) -> FloatArray:
    arm = axes_at(target.base_from_flange, _START_NEAR, machine)
    if arm is None:
        raise ConfigError(
            "a KR 16 cannot stand where the laboratory's robot stands:"
            f" flange at {target.base_from_flange.translation.round(4).tolist()} m from its base"
        )
    return np.array([*arm, machine.e1_mm(target.rail_m)])
