"""The driver ``kuka.robot``: a KUKA KR 16 on a rail, through EthernetKRL or KUKAVARPROXY."""

import re
import threading
import time
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from typing import Final

import numpy as np

from drivers.kuka.backend import CommandKind, ControllerState, MotionBackend, Refusal
from drivers.kuka.eki_backend import EkiBackend
from drivers.kuka.kvp_backend import KvpBackend
from drivers.kuka.linear import follow_line
from drivers.kuka.motion import Motion, Mover
from drivers.kuka.motion_model import KukaMotionModel
from drivers.kuka.options import EkiOptions, KukaOptions
from drivers.kuka.position import Axes
from drivers.kuka.rail import Rail
from drivers.kuka.readiness import require_ready
from tronlab.devices.readings import DeviceIdentity, Posture, RobotReading, RobotTarget
from tronlab.devices.registry import DeviceContext
from tronlab.errors import (
    DeviceError,
    LimitError,
    NotConnectedError,
    NotReadyError,
)
from tronlab.geometry.poses import FloatArray, rotation_angle_rad
from tronlab.kinematics.kr16 import excesses, forward

_MODEL: Final = re.compile(r"KR\s*16(?!\d)", re.IGNORECASE)
_STOP_TIMEOUT_S: Final = 5.0
_SAME_PLACE_M: Final = 0.002
_SAME_TURN_RAD: Final = float(np.radians(0.1))
"""The controller's own kinematics may differ so much from ours: a calibrated arm does a little."""


class KukaRobot:
    """Arm and rail of a KR 16; every motion ends in an exact stop.

    Motions are by axes, chosen here, so that tool and base on the controller do not matter and
    every limit is known before anything moves.
    """

    def __init__(self, name: str, options: KukaOptions, backend: MotionBackend) -> None:
        self._name = name
        self._options = options
        self._backend = backend
        self._rail = Rail(options, device=name)
        self._model = KukaMotionModel(options, device=name)
        self._limits_rad = options.axis_limits_deg.limits_rad
        self._mover: Mover | None = None
        self._one_at_a_time = threading.Lock()

    @property
    def name(self) -> str:
        """Get the name errors and logs use."""
        return self._name

    def connect(self) -> None:
        """Open the connection and read the first state; nothing moves.

        Raises:
            AccessDeniedError: Another client holds the controller.
            NotConnectedError: Nobody answers.
        """
        self.close()
        self._backend.connect()
        try:
            self._require_kr16(self._backend.identify(call="connect"))
            self._mover = Mover(self._backend, self._options, device=self._name)
        except BaseException:
            self._backend.close()
            raise
        self._rail.leave()

    def close(self) -> None:
        """Close the connection; what moves then goes on to its target."""
        self._mover = None
        self._backend.close()

    def identify(self) -> DeviceIdentity:
        """Read maker, model and serial number; EthernetKRL alone does not tell the last."""
        self._connected("identify")
        return self._backend.identify(call="identify")

    def state(self) -> ControllerState:
        """Read everything the controller says of itself."""
        return self._connected("state").state(call="state")

    def diagnose(self) -> Mapping[str, str]:
        """Read where it stands and whether it could move; changes and moves nothing."""
        state = self._connected("diagnose").state(call="diagnose")
        return {
            "axes": str(state.axes),
            "rail": f"{self._rail.rail_m(state.axes.e1_m):.4f} m",
            "emergency stop": "released" if state.is_emergency_stop_released else "pressed",
            "guard": "closed" if state.is_guard_closed else "open",
            "drives": "on" if state.are_drives_on else "off",
            "operating mode": str(state.mode),
            "program": "runs" if state.is_program_active else "does not run",
            "stop message": "pending" if state.has_stop_message else "none",
            "program override": f"{state.override_pct} %",
        }

    def check(self, target: RobotTarget) -> None:
        """Return if rail and arm can reach the target."""
        self._axes(target, self._connected("check").last_axes, call="check")

    def posture_for(self, target: RobotTarget, *, near: Posture | None = None) -> Posture:
        """Choose how ``move`` would stand at a target, coming from ``near``; needs no connection.

        Raises:
            LimitError: Rail or arm cannot reach it; the message names the limit.
        """
        return self._model.posture_for(target, near=near)

    def move_duration_s(self, start: Posture, end: Posture) -> float:
        """Estimate how long ``move`` takes; needs no connection, see ``PaceOptions``."""
        return self._model.move_duration_s(start, end)

    def read(self) -> RobotReading:
        """Read rail and flange pose from the encoders."""
        state = self._connected("read").state(call="read")
        return RobotReading(
            rail_m=self._rail.rail_m(state.axes.e1_m),
            base_from_flange=forward(state.axes.arm_rad),
            time_s=state.time_s,
        )

    def move(self, target: RobotTarget, *, timeout_s: float) -> None:
        """Move there with all axes at once, in the branch with the least motion.

        Raises:
            LimitError: As ``check``, before anything moved; or the override is too high.
            SafetyError: The cell is not safe, or no longer.
            NotReadyError: The controller cannot move: drives, program, operating mode.
            DeviceFaultError: A stop message, a refusal, or ``stop`` was called.
            DeviceTimeoutError: Not there in time; the robot was told to hold.
        """
        with self._moving("move") as mover:
            state = mover.state(call="move")
            axes = self._axes(target, state.axes, call="move")
            self._move(axes, state, mover, timeout_s=timeout_s, call="move")

    def move_axes(self, axes: Axes, *, timeout_s: float) -> None:
        """Move all axes at once to the values given.

        Raises:
            LimitError: An axis or the rail would leave its limits, before anything moved.
            DeviceError: As ``move``.
        """
        with self._moving("move_axes") as mover:
            self._check_axes(axes, call="move_axes")
            state = mover.state(call="move_axes")
            self._move(axes, state, mover, timeout_s=timeout_s, call="move_axes")

    def move_linear(self, target: RobotTarget, *, timeout_s: float) -> None:
        """Move the flange there in a straight line, the rail along with it; for small corrections.

        The rail must not have to go back: that takes a detour, which is no straight line.

        Raises:
            LimitError: The line leaves the reach, the limits or the branch, comes near a
                singularity, or leads the rail back; or the controller's tool, base or rail
                coupling are not as a line needs them.
            DeviceError: As ``move``.
        """
        call = "move_linear"
        with self._moving(call) as mover:
            self._rail.check(target.rail_m, call=call)
            state = mover.state(call=call)
            axes = self._line_end(target, state, call=call)
            require_ready(state, self._options, device=self._name, call=call)
            motion = Motion(call, CommandKind.LINEAR, axes, give_up_s=_deadline(timeout_s))
            self._rail.leave()
            mover.execute(motion)
            self._rail.arrive(target.rail_m)

    def stop(self) -> None:
        """Hold; when this returns nothing moves, and ``move`` in another thread raises."""
        mover = self._connected("stop")
        self._rail.leave()
        mover.stop(call="stop", timeout_s=_STOP_TIMEOUT_S)

    def _move(
        self, axes: Axes, state: ControllerState, mover: Mover, *, timeout_s: float, call: str
    ) -> None:
        require_ready(state, self._options, device=self._name, call=call)
        give_up_s = _deadline(timeout_s)
        rail_m = self._rail.rail_m(axes.e1_m)
        detour_m = self._detour(rail_m, state)
        self._rail.leave()
        if detour_m is not None:
            below = self._with_rail(axes.arm_rad, detour_m)
            mover.execute(Motion(call, CommandKind.PTP_AXES, below, give_up_s))
        mover.execute(Motion(call, CommandKind.PTP_AXES, axes, give_up_s))
        self._rail.arrive(rail_m)

    @contextmanager
    def _moving(self, call: str) -> Generator[Mover]:
        """Let one motion at a time through, and refuse a second instead of queueing it."""
        mover = self._connected(call)
        if not self._one_at_a_time.acquire(blocking=False):
            raise NotReadyError(
                f"{call}: another thread moves the robot",
                device=self._name,
                code=Refusal.NOT_READY,
            )
        try:
            mover.begin()
            yield mover
        finally:
            self._one_at_a_time.release()

    def _line_end(self, target: RobotTarget, state: ControllerState, *, call: str) -> Axes:
        self._require_own_frames(state, call=call)
        if self._detour(target.rail_m, state) is not None:
            raise LimitError(
                f"{call}: the rail would come to {target.rail_m:.4f} m from above, or by less than"
                " its approach, allowed is from below; use move",
                device=self._name,
            )
        arm_rad = follow_line(
            np.array(state.axes.arm_rad),
            target.base_from_flange,
            limits_rad=self._limits_rad,
            device=self._name,
            call=call,
        )
        return self._with_rail(arm_rad, target.rail_m)

    def _detour(self, rail_m: float, state: ControllerState) -> float | None:
        return self._rail.detour_m(rail_m, now_m=self._rail.rail_m(state.axes.e1_m))

    def _axes(self, target: RobotTarget, now: Axes, *, call: str) -> Axes:
        near = Posture(self._rail.rail_m(now.e1_m), np.array(now.arm_rad))
        posture = self._model.posture_for(target, near=near, call=call)
        return self._with_rail(posture.axes_rad, posture.rail_m)

    def _with_rail(self, arm_rad: FloatArray | tuple[float, ...], rail_m: float) -> Axes:
        return Axes(tuple(float(a) for a in arm_rad), self._rail.e1_m(rail_m))

    def _check_axes(self, axes: Axes, *, call: str) -> None:
        self._rail.check(self._rail.rail_m(axes.e1_m), call=call)
        beyond = excesses(axes.arm_rad, self._limits_rad)
        if beyond:
            raise LimitError(f"{call}: {'; '.join(beyond)} deg", device=self._name)

    def _require_kr16(self, identity: DeviceIdentity) -> None:
        if not _MODEL.search(identity.model):
            raise DeviceError(
                f"connect: the controller drives a '{identity.model}', allowed is a KR 16:"
                " this driver knows no other kinematics",
                device=self._name,
            )

    def _require_own_frames(self, state: ControllerState, *, call: str) -> None:
        """Return if the controller's Cartesian position is that of flange in base, as ours is."""
        ours, theirs = forward(state.axes.arm_rad), self._backend.position(call=call)
        off_m = float(np.linalg.norm(ours.translation - theirs.translation))
        off_rad = rotation_angle_rad(ours, theirs)
        if off_m > _SAME_PLACE_M or off_rad > _SAME_TURN_RAD:
            raise LimitError(
                f"{call}: the controller's Cartesian position is {off_m * 1e3:.1f} mm and"
                f" {np.degrees(off_rad):.2f} deg from that of its axes, allowed"
                f" {_SAME_PLACE_M * 1e3:g} mm and 0.1 deg: its tool or base is not 0, or the rail"
                " is coupled; use move, which does not depend on that",
                device=self._name,
            )

    def _connected(self, call: str) -> Mover:
        if self._mover is None:
            raise NotConnectedError(
                f"{call}: not connected; call connect() first", device=self._name
            )
        return self._mover


def open_robot(context: DeviceContext) -> KukaRobot:
    """Make the driver of a rig file; nothing is connected yet.

    Raises:
        ConfigError: The options do not fit.
    """
    options = context.parse_options(KukaOptions)
    protocol = options.protocol
    if isinstance(protocol, EkiOptions):
        backend = EkiBackend(
            options.host, protocol, timeout_s=options.timeout_s, device=context.name
        )
    else:
        backend = KvpBackend(
            options.host, protocol, timeout_s=options.timeout_s, device=context.name
        )
    return KukaRobot(context.name, options, backend)


def _deadline(timeout_s: float) -> float:
    return time.monotonic() + timeout_s
