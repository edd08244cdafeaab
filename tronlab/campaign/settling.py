"""Does the camera stand still? Judged by the tracker's looks at the T-MAC, never by the robot."""

from dataclasses import dataclass

import numpy as np

from tronlab.campaign.config import SettleConfig
from tronlab.devices.clock import Clock
from tronlab.devices.protocols import PoseTracker
from tronlab.devices.readings import PoseReading
from tronlab.errors import NotSettledError
from tronlab.geometry.poses import rotation_angle_rad


@dataclass(frozen=True, slots=True)
class Motion:
    """How far the T-MAC seems to have moved between two looks."""

    shift_m: float
    turn_rad: float

    def is_rest(self, settle: SettleConfig) -> bool:
        """Tell whether it is little enough to count as standing still."""
        return self.shift_m <= settle.max_shift_m and self.turn_rad <= np.radians(
            settle.max_turn_deg
        )


def motion_between(a: PoseReading, b: PoseReading) -> Motion:
    """Compare two looks."""
    shift_m = np.linalg.norm(b.trk_from_tmac.translation - a.trk_from_tmac.translation)
    return Motion(float(shift_m), rotation_angle_rad(a.trk_from_tmac, b.trk_from_tmac))


def wait_for_rest(tracker: PoseTracker, settle: SettleConfig, clock: Clock) -> Motion:
    """Look until two looks in a row agree, and give by how much they differ.

    Raises:
        NotSettledError: They did not within ``settle.timeout_s``.
    """
    give_up_s = clock.monotonic_s + settle.timeout_s
    last = tracker.measure_pose(window_s=settle.window_s)
    while True:
        clock.advance(settle.wait_s)
        look = tracker.measure_pose(window_s=settle.window_s)
        motion = motion_between(last, look)
        if motion.is_rest(settle):
            return motion
        if clock.monotonic_s > give_up_s:
            raise _not_settled(motion, settle, f"after {settle.timeout_s:g} s", tracker.name)
        last = look


def confirm_rest(before: PoseReading, tracker: PoseTracker, settle: SettleConfig) -> Motion:
    """Look once more after the exposure, and give how far that is from the measurement before it.

    Raises:
        NotSettledError: Too far: the truth does not belong to the image.
    """
    motion = motion_between(before, tracker.measure_pose(window_s=settle.window_s))
    if not motion.is_rest(settle):
        raise _not_settled(motion, settle, "during the exposure", tracker.name)
    return motion


def _not_settled(motion: Motion, settle: SettleConfig, when: str, device: str) -> NotSettledError:
    return NotSettledError(
        f"the T-MAC still moves {when}: {motion.shift_m * 1e3:.3f} mm and"
        f" {np.degrees(motion.turn_rad):.4f} deg between two looks (settle allows"
        f" {settle.max_shift_m * 1e3:g} mm and {settle.max_turn_deg:g} deg)",
        device=device,
    )
