"""One motion from its command until the robot stands still at its target, and how it is stopped."""

import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from drivers.kuka.backend import Command, CommandKind, ControllerState, MotionBackend, Refusal
from drivers.kuka.options import KukaOptions
from drivers.kuka.position import Axes
from drivers.kuka.readiness import refused, require_running
from tronlab.errors import DeviceError, DeviceFaultError, DeviceTimeoutError, ProtocolError
from tronlab.geometry.poses import rotation_angle_rad
from tronlab.kinematics.kr16 import AXIS_NAMES, forward

POLL_S: Final = 0.02
"""Between two looks at the controller, at least; EthernetKRL tells its state more rarely."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What a driver's call wants done."""

    call: str
    kind: CommandKind
    axes: Axes
    """Where it ends; of every kind, so that arrival can be judged."""
    give_up_s: float
    """Monotonic time."""


class Mover:
    """Carries out motions one after the other; ``stop`` may come from any thread."""

    def __init__(self, backend: MotionBackend, options: KukaOptions, *, device: str) -> None:
        self._backend = backend
        self._options = options
        self._device = device
        self._stopped = threading.Event()
        self._sending = threading.Lock()
        self._last = backend.state(call="connect")

    @property
    def last_axes(self) -> Axes:
        """Get where the axes stood when the state was last read."""
        return self._last.axes

    def state(self, *, call: str) -> ControllerState:
        """Read the controller's state."""
        self._last = self._backend.state(call=call)
        return self._last

    def begin(self) -> None:
        """Forget stops that came before: a call that may move begins here."""
        self._stopped.clear()

    def execute(self, motion: Motion) -> None:
        """Move, and return when the robot stands still at the target.

        Whatever goes wrong once the command may have been sent, the robot is told to hold first.

        Raises:
            DeviceFaultError: Stopped by ``stop``, refused, or somewhere else than commanded.
            DeviceTimeoutError: Not accepted, not done or not still in the time allowed.
            DeviceError: As ``readiness.require_running``.
        """
        try:
            command_id = self._send(motion)
            self._wait_until_accepted(motion, command_id)
            self._wait_until_done(motion, command_id)
            self._wait_until_still(motion)
        except BaseException as error:
            self._hold_after(error, motion.call)
            raise
        self._verify_arrival(motion)

    def stop(self, *, call: str, timeout_s: float) -> None:
        """Hold; when this returns nothing moves.

        Raises:
            DeviceTimeoutError: The controller did not confirm it in time.
        """
        give_up_s = time.monotonic() + timeout_s
        with self._sending:
            self._stopped.set()
            hold_id = self._send_hold(call)
        while True:
            state = self.state(call=call)
            can_move = state.is_program_active and state.are_drives_on
            if not state.is_moving and (state.done_id == hold_id or not can_move):
                return
            if time.monotonic() > give_up_s:
                raise DeviceTimeoutError(
                    f"{call}: not confirmed in {timeout_s:g} s; use the emergency stop",
                    device=self._device,
                )
            time.sleep(POLL_S)

    def _send(self, motion: Motion) -> int:
        command = Command(
            kind=motion.kind,
            axes=motion.axes,
            base_from_flange=forward(motion.axes.arm_rad),
            velocity_pct=self._options.velocity_pct,
            acceleration_pct=self._options.acceleration_pct,
        )
        with self._sending:
            self._raise_if_stopped(motion.call)
            return self._backend.send(command, call=motion.call)

    def _send_hold(self, call: str) -> int:
        command = Command(
            kind=CommandKind.HOLD,
            axes=self._last.axes,
            base_from_flange=forward(self._last.axes.arm_rad),
            velocity_pct=self._options.velocity_pct,
            acceleration_pct=self._options.acceleration_pct,
        )
        return self._backend.send(command, call=call)

    def _hold_after(self, error: BaseException, call: str) -> None:
        try:
            with self._sending:
                if not self._stopped.is_set():  # else stop() has seen to it
                    self._send_hold(call)
        except DeviceError as second:
            error.add_note(f"and it could not be told to hold: {second}")

    def _wait_until_accepted(self, motion: Motion, command_id: int) -> None:
        before_id = self._last.accepted_id
        give_up_s = min(time.monotonic() + self._options.timeout_s, motion.give_up_s)
        while True:
            state = self._look(motion)
            if command_id in (state.accepted_id, state.done_id):
                return
            is_earlier = before_id <= state.accepted_id < command_id
            if not is_earlier:  # a hold of ours may have waited for a program that stood still
                raise ProtocolError(
                    f"{motion.call}: the controller accepts command {state.accepted_id}, sent was"
                    f" {command_id}; another program may be sending commands",
                    device=self._device,
                    sent=str(command_id).encode(),
                    received=str(state.accepted_id).encode(),
                )
            if time.monotonic() > give_up_s:
                raise DeviceTimeoutError(
                    f"{motion.call}: the controller does not accept the command in"
                    f" {self._options.timeout_s:g} s; it was told to hold; does its program run?",
                    device=self._device,
                )

    def _wait_until_done(self, motion: Motion, command_id: int) -> None:
        while True:
            state = self._look(motion)
            if state.done_id == command_id:
                if state.error != Refusal.NONE:
                    raise refused(state, device=self._device, call=motion.call)
                if not state.is_moving:
                    return
            if time.monotonic() > motion.give_up_s:
                raise DeviceTimeoutError(
                    f"{motion.call}: not at the target in the time allowed; it was told to hold",
                    device=self._device,
                )

    def _wait_until_still(self, motion: Motion) -> None:
        settle = self._options.settle
        readings: deque[ControllerState] = deque(maxlen=settle.n_readings)
        while True:
            readings.append(self._look(motion))
            if len(readings) == settle.n_readings and self._is_still(readings):
                self._stopped.wait(settle.dwell_s)
                readings.append(self._look(motion))
                if self._is_still(readings):
                    return
            if time.monotonic() > motion.give_up_s:
                shift_mm, turn_deg = _spread(readings)
                raise DeviceTimeoutError(
                    f"{motion.call}: done, but not still: {shift_mm:.4f} mm and {turn_deg:.4f} deg"
                    f" between the last {len(readings)} readings, allowed {settle.still_mm:g} mm"
                    f" and {settle.still_deg:g} deg; it was told to hold",
                    device=self._device,
                )

    def _is_still(self, readings: deque[ControllerState]) -> bool:
        shift_mm, turn_deg = _spread(readings)
        settle = self._options.settle
        is_any_moving = any(reading.is_moving for reading in readings)
        return not is_any_moving and shift_mm <= settle.still_mm and turn_deg <= settle.still_deg

    def _look(self, motion: Motion) -> ControllerState:
        """Read a new state, and raise if it or ``stop`` stands against the motion."""
        self._stopped.wait(POLL_S)
        self._raise_if_stopped(motion.call)
        state = self.state(call=motion.call)
        self._raise_if_stopped(motion.call)
        require_running(state, self._options, device=self._device, call=motion.call)
        return state

    def _raise_if_stopped(self, call: str) -> None:
        if self._stopped.is_set():
            raise DeviceFaultError(
                f"{call}: stopped by stop() before the target was reached",
                device=self._device,
                code=Refusal.HELD,
            )

    def _verify_arrival(self, motion: Motion) -> None:
        settle, at = self._options.settle, self._last.axes
        off_deg = np.subtract(at.arm_deg, motion.axes.arm_deg)
        worst = int(np.abs(off_deg).argmax())
        if abs(off_deg[worst]) > settle.arrival_deg:
            raise self._elsewhere(
                f"{AXIS_NAMES[worst]} is at {at.arm_deg[worst]:.4f} deg, commanded"
                f" {motion.axes.arm_deg[worst]:.4f}, allowed {settle.arrival_deg:g} deg off",
                motion,
            )
        if abs(at.e1_mm - motion.axes.e1_mm) > settle.arrival_mm:
            raise self._elsewhere(
                f"E1 is at {at.e1_mm:.3f} mm, commanded {motion.axes.e1_mm:.3f}, allowed"
                f" {settle.arrival_mm:g} mm off",
                motion,
            )

    def _elsewhere(self, what: str, motion: Motion) -> DeviceFaultError:
        return DeviceFaultError(
            f"{motion.call}: the controller says it is done, but {what}; check the mastering",
            device=self._device,
            code=self._last.error,
        )


def _spread(readings: deque[ControllerState]) -> tuple[float, float]:
    """Give how far flange or rail moved, mm, and turned, degrees, from the last reading back."""
    *before, last = readings
    pose = forward(last.axes.arm_rad)
    shift_m = turn_rad = 0.0
    for reading in before:
        other = forward(reading.axes.arm_rad)
        flange_m = float(np.linalg.norm(other.translation - pose.translation))
        shift_m = max(shift_m, flange_m, abs(reading.axes.e1_m - last.axes.e1_m))
        turn_rad = max(turn_rad, rotation_angle_rad(other, pose))
    return shift_m * 1e3, float(np.degrees(turn_rad))
