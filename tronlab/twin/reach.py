"""How the simulated robot stands and moves: a KR 16 on a rail, by its own kinematics and limits."""

import numpy as np

from tronlab.devices.readings import Posture, RobotTarget
from tronlab.errors import LimitError
from tronlab.kinematics.kr16 import KR16_SPEED_RAD_PER_S, UPRIGHT_RAD, axes_for, flange_place_m
from tronlab.twin.config import RobotConfig


def posture_at(
    target: RobotTarget,
    *,
    near: Posture | None,
    rail_range_m: tuple[float, float],
    device: str,
    call: str,
) -> Posture:
    """Choose how to stand at a target, with the least motion from ``near``, or from upright.

    Raises:
        LimitError: Rail or arm do not reach it; the message has the limit, the value and what is
            allowed.
    """
    low, high = rail_range_m
    if not low <= target.rail_m <= high:
        raise LimitError(
            f"{call}: rail position is {target.rail_m:.4f} m, allowed {low:.4f} to {high:.4f} m;"
            " choose poses nearer to or farther from the model",
            device=device,
        )
    return _nearest(target, near=near, device=device, call=call)


def likely_posture(at: RobotTarget, *, near: Posture | None, device: str) -> Posture:
    """Give how a robot may stand where it is found, which may be beyond what it is allowed.

    Raises:
        LimitError: No KR 16 can stand there.
    """
    return _nearest(at, near=near, device=device, call="stand")


def move_duration_s(start: Posture, end: Posture, config: RobotConfig) -> float:
    """Give how long a move takes: as long as the slowest of rail, flange and single axes.

    Rail and flange have the speeds of the world's description, axes their highest; what it takes to
    speed up and to come to rest is in those.
    """
    flange_m = flange_place_m(end.axes_rad) - flange_place_m(start.axes_rad)
    turns_rad = np.abs(end.axes_rad - start.axes_rad)
    return max(
        abs(end.rail_m - start.rail_m) / config.rail_speed_m_per_s,
        float(np.linalg.norm(flange_m)) / config.arm_speed_m_per_s,
        float((turns_rad / KR16_SPEED_RAD_PER_S).max()),
    )


def _nearest(target: RobotTarget, *, near: Posture | None, device: str, call: str) -> Posture:
    start_rad = UPRIGHT_RAD if near is None else near.axes_rad
    axes_rad = axes_for(target.base_from_flange, start_rad, device=device, call=call)
    return Posture(target.rail_m, axes_rad)
