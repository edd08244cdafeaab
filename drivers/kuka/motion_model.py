"""How the robot would stand and move, told without asking the controller."""

import numpy as np

from drivers.kuka.options import KukaOptions
from drivers.kuka.rail import Rail
from tronlab.devices.readings import Posture, RobotTarget
from tronlab.kinematics.kr16 import KR16_SPEED_RAD_PER_S, UPRIGHT_RAD, axes_for
from tronlab.kinematics.ptp import ptp_duration_s


class KukaMotionModel:
    """What ``KukaRobot.move`` chooses and how long it takes, by options alone."""

    def __init__(self, options: KukaOptions, *, device: str) -> None:
        self._options = options
        self._device = device
        self._limits_rad = options.axis_limits_deg.limits_rad
        pace = options.pace
        speed = np.append(KR16_SPEED_RAD_PER_S, pace.rail_speed_m_per_s)
        ramp = np.append(KR16_SPEED_RAD_PER_S / pace.axis_ramp_s, pace.rail_acceleration_m_per_s2)
        self._speed = speed * options.velocity_pct / 100.0
        self._acceleration = ramp * options.acceleration_pct / 100.0

    def posture_for(
        self, target: RobotTarget, *, near: Posture | None = None, call: str = "posture_for"
    ) -> Posture:
        """Choose how to stand at a target, with the least motion from ``near``, or from upright.

        Raises:
            LimitError: Rail or arm cannot reach it; the message names the limit.
        """
        Rail(self._options, device=self._device).check(target.rail_m, call=call)
        axes_rad = axes_for(
            target.base_from_flange,
            UPRIGHT_RAD if near is None else near.axes_rad,
            limits_rad=self._limits_rad,
            device=self._device,
            call=call,
        )
        return Posture(target.rail_m, axes_rad)

    def move_duration_s(self, start: Posture, end: Posture) -> float:
        """Estimate how long ``move`` takes, the rail's approach from below and settling included.

        ``start`` is where a move ended; after ``connect`` and ``stop`` the first may take longer.
        """
        rail = Rail(self._options, device=self._device)
        rail.arrive(start.rail_m)
        below_m = rail.detour_m(end.rail_m, now_m=start.rail_m)
        if below_m is None:
            return self._motion_s(start, end)
        below = Posture(below_m, end.axes_rad)
        return self._motion_s(start, below) + self._motion_s(below, end)

    def _motion_s(self, start: Posture, end: Posture) -> float:
        """Give how long one command takes until the robot is known to stand still."""
        options, pace = self._options, self._options.pace
        travel = np.append(end.axes_rad - start.axes_rad, end.rail_m - start.rail_m)
        moving_s = ptp_duration_s(travel, speed=self._speed, acceleration=self._acceleration)
        return moving_s / (pace.override_pct / 100.0) + pace.command_s + options.settle.dwell_s
