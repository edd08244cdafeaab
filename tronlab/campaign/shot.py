"""One shot, step by step, with blocking devices; the engine decides when each step runs."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.config import CampaignConfig, SettleConfig
from tronlab.campaign.drift import DriftWatch
from tronlab.dataset.records import DriftRecord, ShotRecord, Truth
from tronlab.devices.readings import Frame, PoseReading, RobotReading, RoomReading
from tronlab.devices.registry import Devices
from tronlab.errors import DeviceError, NotSettledError, SafetyError
from tronlab.geometry.poses import pose_from_xyz_quat, rotation_angle_rad, xyz_quat_from_pose
from tronlab.planning.shots import RangeFinder, Shot, range_los_m
from tronlab.render.mask import model_mask
from tronlab.terrain.heightmap import HeightMap

T = TypeVar("T")


def as_stored(reading: PoseReading) -> PoseReading:
    """Give a reading as the dataset will give it back: a quaternion rounds otherwise than a matrix.

    Truth that is derived from it can be recomputed from the dataset bit for bit.
    """
    numbers = xyz_quat_from_pose(reading.trk_from_tmac)
    return replace(reading, trk_from_tmac=pose_from_xyz_quat(numbers))


@dataclass(frozen=True)
class TruthSource:
    """Derives what a shot should be judged by from the tracker's reading."""

    calibration: CalibrationRecord
    heightmap: HeightMap
    range_finder: RangeFinder

    def derive(self, reading: PoseReading) -> tuple[Truth, NDArray[np.bool_]]:
        """Give ground truth and mask of a shot from its raw T-MAC reading."""
        trs_from_cam, covariance = self.calibration.trs_from_cam(reading)
        mask = model_mask(self.heightmap, self.calibration.camera, trs_from_cam)
        truth = Truth(
            trs_from_cam=trs_from_cam,
            covariance=covariance,
            range_los_m=range_los_m(self.range_finder, trs_from_cam),
            usable_fraction=float(mask.mean()),
        )
        return truth, mask


@dataclass
class _Readings:
    """What has been read of the shot in hand."""

    shot: Shot
    attempt: int
    is_in_place: bool = False
    """The robot has reached its target."""
    tracker: PoseReading | None = None
    frame: Frame | None = None
    robot: RobotReading | None = None
    room: RoomReading | None = None


@dataclass
class ShotTaker:
    """Takes one shot at a time. Each step blocks, and gives small numbers for the live view."""

    devices: Devices
    config: CampaignConfig
    truth_source: TruthSource
    sleep: Callable[[float], None] = time.sleep
    monotonic_s: Callable[[], float] = time.monotonic
    drift_watch: DriftWatch | None = None
    """Who measures the reflectors anew; None: nobody."""
    warn: Callable[[str], None] = lambda text: None
    """Told of what is odd but no error."""
    _now: _Readings | None = field(default=None, init=False)
    _has_warned_of_air: bool = field(default=False, init=False)
    in_hand: str = field(default="no shot yet", init=False)
    """Which shot or drift check, and which attempt at it, for messages."""

    @property
    def is_in_place(self) -> bool:
        """Get whether the robot has reached the target of the shot in hand."""
        return self._now is not None and self._now.is_in_place

    def begin(self, shot: Shot, attempt: int) -> None:
        """Forget the last shot: nothing of it can be paired with this one."""
        self._now = _Readings(shot=shot, attempt=attempt)
        self.in_hand = f"shot {shot.shot_id}, attempt {attempt}"

    def begin_check(self, n_shots_before: int, attempt: int) -> None:
        """Forget the last shot: a drift check comes."""
        self._now = None
        self.in_hand = f"drift check after {n_shots_before} shots, attempt {attempt}"

    def check_drift(self, n_shots_before: int) -> DriftRecord:
        """Measure the reflectors, against where the calibration record has them."""
        return _taken(self.drift_watch, "drift watch").check(n_shots_before)

    def check_room(self) -> None:
        """Look whether the room lets a shot be taken.

        Raises:
            SafetyError: It does not.
        """
        self._refuse_open_door(self.devices.room.read())

    def reconnect(self, device_name: str) -> None:
        """Close a device and connect it again, and make it what it was for this campaign.

        The shared state of simulated devices has a name of its own; it finds its server by itself.
        """
        device = next((one for one in self.devices.all() if one.name == device_name), None)
        if device is None:
            return
        device.close()
        device.connect()
        if device is self.devices.camera:
            camera = self.config.camera
            self.devices.camera.configure(
                exposure_s=camera.exposure_s,
                gain_db=camera.gain_db,
                pixel_format=camera.pixel_format,
            )
        if device is self.devices.room:
            self.devices.room.switch_lamp(on=True)

    def move(self) -> None:
        """Drive the robot to the target; it stands still when this returns."""
        now = self._begun()
        self.devices.robot.move(now.shot.robot_target, timeout_s=self.config.robot.timeout_s)
        now.is_in_place = True

    def settle(self) -> dict[str, float]:
        """Look at the T-MAC until two looks in a row agree.

        Raises:
            NotSettledError: They did not within ``settle.timeout_s``.
        """
        settle = self.config.settle
        give_up_s = self.monotonic_s() + settle.timeout_s
        last = self.devices.tracker.measure_pose(window_s=settle.window_s)
        while True:
            self.sleep(settle.wait_s)
            look = self.devices.tracker.measure_pose(window_s=settle.window_s)
            shift_m, turn_rad = _moved(last, look)
            if _is_still(shift_m, turn_rad, settle):
                return {"shift_m": shift_m, "turn_rad": turn_rad}
            if self.monotonic_s() > give_up_s:
                raise self._not_settled(shift_m, turn_rad, f"after {settle.timeout_s:g} s")
            last = look

    def measure(self) -> dict[str, float]:
        """Measure the T-MAC: the raw reading the ground truth follows from."""
        now = self._begun()
        now.tracker = self.devices.tracker.measure_pose(window_s=self.config.tracker.window_s)
        x_m, y_m, z_m = (float(v) for v in now.tracker.trk_from_tmac.translation)
        return {"tmac_trk_x_m": x_m, "tmac_trk_y_m": y_m, "tmac_trk_z_m": z_m}

    def grab(self) -> dict[str, float]:
        """Take the image."""
        now = self._begun()
        now.frame = self.devices.camera.grab(timeout_s=self.config.camera.timeout_s)
        expected = self.truth_source.calibration.camera.shape
        if now.frame.image.shape != expected:
            raise DeviceError(
                f"delivered an image of shape {now.frame.image.shape}, calibrated is {expected}",
                device=self.devices.camera.name,
            )
        return {"mean_grey": float(now.frame.image.mean())}

    def confirm(self) -> dict[str, float]:
        """Look once more: whatever moved during the exposure makes its truth worthless.

        Raises:
            NotSettledError: The T-MAC is no longer where it was measured before the exposure.
        """
        settle = self.config.settle
        look = self.devices.tracker.measure_pose(window_s=settle.window_s)
        shift_m, turn_rad = _moved(_taken(self._begun().tracker, "tracker"), look)
        if not _is_still(shift_m, turn_rad, settle):
            raise self._not_settled(shift_m, turn_rad, "during the exposure")
        return {"exposure_shift_m": shift_m, "exposure_turn_rad": turn_rad}

    def read(self) -> dict[str, float]:
        """Read robot and room.

        Raises:
            SafetyError: The door is open: light, and maybe a person, came in.
        """
        now = self._begun()
        now.robot = self.devices.robot.read()
        now.room = self.devices.room.read()
        self._refuse_open_door(now.room)
        self._compare_air(_taken(now.tracker, "tracker"), now.room)
        return {"rail_m": now.robot.rail_m, "air_temperature_k": now.room.air_temperature_k}

    def assemble(self) -> ShotRecord:
        """Give the record of the shot: all of it read since ``begin``."""
        now = self._begun()
        tracker = _taken(now.tracker, "tracker")
        truth, mask = self.truth_source.derive(as_stored(tracker))
        return ShotRecord(
            shot_id=now.shot.shot_id,
            attempt=now.attempt,
            trs_from_cam_nominal=now.shot.trs_from_cam_nominal,
            robot=_taken(now.robot, "robot"),
            tracker=tracker,
            room=_taken(now.room, "room"),
            frame=_taken(now.frame, "frame"),
            mask=mask,
            truth=truth,
        )

    def _refuse_open_door(self, room: RoomReading) -> None:
        if self.config.room.needs_closed_door and not room.is_door_closed:
            raise SafetyError("the door is open; close it", device=self.devices.room.name)

    def _compare_air(self, tracker: PoseReading, room: RoomReading) -> None:
        """Warn, once, if tracker and room disagree about the air: one of them reads wrong."""
        if tracker.air is None or self._has_warned_of_air:
            return
        difference_k = abs(tracker.air.temperature_k - room.air_temperature_k)
        difference_pa = abs(tracker.air.pressure_pa - room.air_pressure_pa)
        allowed = self.config.room
        if (
            difference_k > allowed.max_temperature_difference_k
            or difference_pa > allowed.max_pressure_difference_pa
        ):
            self._has_warned_of_air = True
            self.warn(
                f"{self.in_hand}: the tracker's air and the room's differ by {difference_k:.2f} K"
                f" and {difference_pa:.0f} Pa; check both sensors: distances are corrected by them"
            )

    def _begun(self) -> _Readings:
        return _taken(self._now, "shot")

    def _not_settled(self, shift_m: float, turn_rad: float, when: str) -> NotSettledError:
        settle = self.config.settle
        return NotSettledError(
            f"the T-MAC still moves {when}: {shift_m * 1e3:.3f} mm and {np.degrees(turn_rad):.4f}"
            f" deg between two looks (settle allows {settle.max_shift_m * 1e3:g} mm and"
            f" {settle.max_turn_deg:g} deg)",
            device=self.devices.tracker.name,
        )


def _taken(value: T | None, what: str) -> T:
    """Give what an earlier step must have left; steps out of order are a programming mistake."""
    if value is None:
        raise RuntimeError(f"no {what} yet: the steps of a shot run in the wrong order")
    return value


def _moved(a: PoseReading, b: PoseReading) -> tuple[float, float]:
    shift_m = np.linalg.norm(b.trk_from_tmac.translation - a.trk_from_tmac.translation)
    return float(shift_m), rotation_angle_rad(a.trk_from_tmac, b.trk_from_tmac)


def _is_still(shift_m: float, turn_rad: float, settle: SettleConfig) -> bool:
    return shift_m <= settle.max_shift_m and turn_rad <= np.radians(settle.max_turn_deg)
