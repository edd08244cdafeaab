"""What the simulated robot can reach: the rail's ends, and a rough model of the KR 16's arm.

The wrist centre must lie between two spheres about the shoulder, which turns with the first axis.
Lengths are the KR 16's: shoulder 0.26 m out and 0.675 m up, links of 0.68 m and 0.671 m, flange
0.158 m beyond the wrist centre, so that the wrist centre reaches 1.61 m from the first axis. Limits
of the single axes and collisions are not modelled.
"""

import numpy as np

from tronlab.devices.readings import RobotTarget
from tronlab.errors import LimitError

SHOULDER_OUT_M = 0.26
SHOULDER_UP_M = 0.675
WRIST_TO_FLANGE_M = 0.158
WRIST_RANGE_M = (0.31, 1.351)
"""From shoulder to wrist centre: elbow bent as far as it goes, and arm stretched."""


def check_reach(
    target: RobotTarget, *, rail_range_m: tuple[float, float], device: str, call: str
) -> None:
    """Return if rail and arm reach the target.

    Raises:
        LimitError: They do not; the message has the limit, the value and what is allowed.
    """
    low, high = rail_range_m
    if not low <= target.rail_m <= high:
        raise LimitError(
            f"{call}: rail position is {target.rail_m:.4f} m, allowed {low:.4f} to {high:.4f} m;"
            " choose poses nearer to or farther from the model",
            device=device,
        )
    distance_m = wrist_distance_m(target)
    near, far = WRIST_RANGE_M
    if not near <= distance_m <= far:
        raise LimitError(
            f"{call}: arm's wrist centre is {distance_m:.4f} m from the shoulder,"
            f" allowed {near:.4f} to {far:.4f} m; choose poses nearer to the middle of the model",
            device=device,
        )


def wrist_distance_m(target: RobotTarget) -> float:
    """Give the distance from the shoulder to the wrist centre."""
    wrist = target.base_from_flange.apply([0.0, 0.0, -WRIST_TO_FLANGE_M])
    out = float(np.hypot(wrist[0], wrist[1])) - SHOULDER_OUT_M
    return float(np.hypot(out, wrist[2] - SHOULDER_UP_M))
