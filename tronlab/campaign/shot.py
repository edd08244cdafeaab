"""One shot, step by step, with blocking devices; the engine decides when each step runs."""

from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.brightness import LightModel
from tronlab.campaign.config import CampaignConfig
from tronlab.campaign.drift import DriftWatch
from tronlab.campaign.gate import Evidence, Gate, Judgement
from tronlab.campaign.settling import Motion, confirm_rest, wait_for_rest
from tronlab.dataset.records import (
    DriftRecord,
    ErrorClass,
    QualityFlag,
    ShotRecord,
    ShotTiming,
    Truth,
)
from tronlab.devices.clock import Clock
from tronlab.devices.readings import Frame, PoseReading, RobotReading, RoomReading
from tronlab.devices.registry import Devices
from tronlab.errors import DeviceError, QualityError, SafetyError
from tronlab.geometry.poses import FloatArray, pose_from_xyz_quat, xyz_quat_from_pose
from tronlab.geometry.uncertainty import compose_covariance
from tronlab.planning.shots import RangeFinder, Shot, range_los_m
from tronlab.render.mask import model_mask
from tronlab.terrain.config import Registration
from tronlab.terrain.heightmap import HeightMap
from tronlab.terrain.registration import registration_covariance

T = TypeVar("T")

_NO_FAILURES: Mapping[ErrorClass, int] = MappingProxyType({})
_BREAK_S = 1.0
"""Between two shots nothing is lost below this: the last one is written, the next one begun."""


def as_stored(reading: PoseReading) -> PoseReading:
    """Give a reading as the dataset will give it back: a quaternion rounds otherwise than a matrix.

    Truth that is derived from it can be recomputed from the dataset bit for bit.
    """
    numbers = xyz_quat_from_pose(reading.trk_from_tmac)
    return replace(reading, trk_from_tmac=pose_from_xyz_quat(numbers))


@dataclass(frozen=True)
class TruthSource:
    """Derives what a shot should be judged by from the tracker's reading.

    Truth is where the camera is with respect to the terrain model that cores know: its covariance
    has the registration of that model beside those of calibration and reading.
    """

    calibration: CalibrationRecord
    heightmap: HeightMap
    range_finder: RangeFinder
    registration: Registration
    """Of the height map."""

    def derive(self, reading: PoseReading) -> tuple[Truth, NDArray[np.bool_]]:
        """Give ground truth and mask of a shot from its raw T-MAC reading."""
        trs_from_cam, covariance = self.calibration.trs_from_cam(reading)
        covariance = compose_covariance(
            RigidTransform.identity(), self._registration_covariance, trs_from_cam, covariance
        )
        mask = model_mask(self.heightmap, self.calibration.camera, trs_from_cam)
        truth = Truth(
            trs_from_cam=trs_from_cam,
            covariance=covariance,
            range_los_m=range_los_m(
                self.range_finder, trs_from_cam, ground_trs_m=self.heightmap.mean_height_trs_m
            ),
            usable_fraction=float(mask.mean()),
        )
        return truth, mask

    @cached_property
    def _registration_covariance(self) -> FloatArray:
        return registration_covariance(self.heightmap, self.registration)


@dataclass
class _Readings:
    """What is known of the shot in hand."""

    shot: Shot
    attempt: int
    n_failures: Mapping[ErrorClass, int]
    lost_s: float
    is_in_place: bool = False
    """The robot has reached its target."""
    settled: Motion | None = None
    """Between the last two looks before the measurement."""
    tracker: PoseReading | None = None
    frame: Frame | None = None
    confirmed: Motion | None = None
    """During the exposure."""
    robot: RobotReading | None = None
    room: RoomReading | None = None
    truth: Truth | None = None
    mask: NDArray[np.bool_] | None = None
    judgement: Judgement | None = None
    durations_s: dict[str, float] = field(default_factory=dict[str, float])
    """By step; a step that is done again counts again."""


@dataclass
class ShotTaker:
    """Takes one shot at a time. Each step blocks, and gives small numbers for the live view."""

    devices: Devices
    config: CampaignConfig
    truth_source: TruthSource
    drift_watch: DriftWatch | None = None
    """Who measures the reflectors anew; None: nobody."""
    light: LightModel | None = None
    """Who predicts how bright the model is; None: the lamp is not watched."""
    warn: Callable[[str], None] = lambda text: None
    """Told of what is odd but no error."""
    session: int = 1
    """Which session of the dataset the shots are taken in."""
    gate: Gate = field(init=False)
    in_hand: str = field(default="no shot yet", init=False)
    """Which shot or drift check, and which attempt at it, for messages."""
    _now: _Readings | None = field(default=None, init=False)
    _done_s: float | None = field(default=None, init=False)
    """When the last record was given, or else the run began; drift checks since are left out."""
    _free_since_s: float = field(default=0.0, init=False)
    """Likewise of the last shot before the one in hand: a record may be refused."""
    _has_warned_of_air: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self.gate = Gate(self.config.gate)

    @property
    def clock(self) -> Clock:
        """Get the laboratory's clock: all waiting goes by it."""
        return self.devices.clock

    @property
    def is_in_place(self) -> bool:
        """Get whether the robot has reached the target of the shot in hand."""
        return self._now is not None and self._now.is_in_place

    @property
    def objections(self) -> Mapping[QualityFlag, str]:
        """Get what the gate holds against the shot in hand, by flag; empty before ``judge``."""
        return self._now.judgement.objections if self._now and self._now.judgement else {}

    def begin(
        self, shot: Shot, attempt: int, *, n_failures: Mapping[ErrorClass, int] = _NO_FAILURES
    ) -> None:
        """Forget the last shot: nothing of it can be paired with this one.

        Args:
            shot: The shot to take.
            attempt: From 1.
            n_failures: Attempts at it that came to nothing, by why.
        """
        self._now = _Readings(
            shot=shot,
            attempt=attempt,
            n_failures=dict(n_failures),
            lost_s=self._lost_s(is_first=attempt == 1),
        )
        self.in_hand = f"shot {shot.shot_id}, attempt {attempt}"

    def begin_check(self, n_shots_before: int, attempt: int) -> None:
        """Forget the last shot: a drift check comes."""
        self._now = None
        self.in_hand = f"drift check after {n_shots_before} shots, attempt {attempt}"

    def check_drift(self, n_shots_before: int) -> DriftRecord:
        """Measure the reflectors, against where the calibration record has them."""
        begin_s = self.clock.monotonic_s
        record = _taken(self.drift_watch, "drift watch").check(n_shots_before)
        duration_s = self.clock.monotonic_s - begin_s
        self._free_since_s += duration_s
        if self._done_s is not None:
            self._done_s += duration_s
        return record

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
        with self._timed("move_s"):
            self.devices.robot.move(now.shot.robot_target, timeout_s=self.config.robot.timeout_s)
        now.is_in_place = True

    def settle(self) -> dict[str, float]:
        """Look at the T-MAC until two looks in a row agree.

        Raises:
            NotSettledError: They did not within ``settle.timeout_s``.
        """
        now = self._begun()
        with self._timed("settle_s"):
            now.settled = wait_for_rest(self.devices.tracker, self.config.settle, self.clock)
        return {"shift_m": now.settled.shift_m, "turn_rad": now.settled.turn_rad}

    def measure(self) -> dict[str, float]:
        """Measure the T-MAC: the raw reading the ground truth follows from."""
        now = self._begun()
        with self._timed("tracker_s"):
            now.tracker = self.devices.tracker.measure_pose(window_s=self.config.tracker.window_s)
        x_m, y_m, z_m = (float(v) for v in now.tracker.trk_from_tmac.translation)
        return {"tmac_trk_x_m": x_m, "tmac_trk_y_m": y_m, "tmac_trk_z_m": z_m}

    def grab(self) -> dict[str, float]:
        """Take the image."""
        now = self._begun()
        with self._timed("camera_s"):
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
        now = self._begun()
        with self._timed("confirm_s"):
            now.confirmed = confirm_rest(
                _taken(now.tracker, "tracker"), self.devices.tracker, self.config.settle
            )
        return {
            "exposure_shift_m": now.confirmed.shift_m,
            "exposure_turn_rad": now.confirmed.turn_rad,
        }

    def read(self) -> dict[str, float]:
        """Read robot and room.

        Raises:
            SafetyError: The door is open: light, and maybe a person, came in.
        """
        now = self._begun()
        with self._timed("read_s"):
            now.robot = self.devices.robot.read()
            now.room = self.devices.room.read()
        self._refuse_open_door(now.room)
        self._compare_air(_taken(now.tracker, "tracker"), now.room)
        return {"rail_m": now.robot.rail_m, "air_temperature_k": now.room.air_temperature_k}

    def judge(self) -> dict[str, float]:
        """Derive the truth, and see whether the shot is good enough.

        Raises:
            QualityError: It is not, and the gate wants it taken again.
        """
        now = self._begun()
        now.truth, now.mask = self.truth_source.derive(as_stored(_taken(now.tracker, "tracker")))
        now.judgement = self.gate.judge(self._evidence(now, truth=now.truth, mask=now.mask))
        retakes_left = self.config.gate.max_retakes - now.n_failures.get("quality", 0)
        if now.judgement.wants_retake and retakes_left > 0:
            raise QualityError(now.judgement.text, device=self.devices.camera.name)
        return {"n_flags": len(now.judgement.quality.flags)}

    def assemble(self) -> ShotRecord:
        """Give the record of the shot, all of it read since ``begin``: with this it is done."""
        now = self._begun()
        judgement = _taken(now.judgement, "judgement")
        record = ShotRecord(
            shot_id=now.shot.shot_id,
            attempt=now.attempt,
            trs_from_cam_nominal=now.shot.trs_from_cam_nominal,
            robot=_taken(now.robot, "robot"),
            tracker=_taken(now.tracker, "tracker"),
            room=_taken(now.room, "room"),
            frame=_taken(now.frame, "frame"),
            mask=_taken(now.mask, "mask"),
            truth=_taken(now.truth, "truth"),
            quality=judgement.quality,
            timing=ShotTiming(lost_s=now.lost_s, **now.durations_s),
            n_failures=now.n_failures,
            session=self.session,
        )
        self.gate.accept(judgement)
        self._done_s = self.clock.monotonic_s
        return record

    def _evidence(self, now: _Readings, *, truth: Truth, mask: NDArray[np.bool_]) -> Evidence:
        return Evidence(
            frame=_taken(now.frame, "frame"),
            mask=mask,
            truth=truth,
            trs_from_cam_nominal=now.shot.trs_from_cam_nominal,
            tracker=_taken(now.tracker, "tracker"),
            room=_taken(now.room, "room"),
            settled=_taken(now.settled, "settled pose"),
            confirmed=_taken(now.confirmed, "confirmation"),
            predicted_radiance=self._predicted_radiance(truth),
        )

    def _predicted_radiance(self, truth: Truth) -> float | None:
        if self.light is None or self.config.gate.brightness == "off":
            return None
        return self.light.mean_radiance(truth.trs_from_cam)

    @contextmanager
    def _timed(self, part: str) -> Generator[None]:
        """Note how long a part of the shot in hand takes."""
        durations_s, begin_s = self._begun().durations_s, self.clock.monotonic_s
        yield
        durations_s[part] = durations_s.get(part, 0.0) + self.clock.monotonic_s - begin_s

    def _lost_s(self, *, is_first: bool) -> float:
        """Give the time since the last shot, or the begin of the run, if something went wrong."""
        now_s = self.clock.monotonic_s
        if self._done_s is None:
            self._done_s = self._free_since_s = now_s
        if is_first:
            self._free_since_s = self._done_s
        since_s = now_s - self._free_since_s
        return 0.0 if is_first and since_s < _BREAK_S else since_s

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


def _taken(value: T | None, what: str) -> T:
    """Give what an earlier step must have left; steps out of order are a programming mistake."""
    if value is None:
        raise RuntimeError(f"no {what} yet: the steps of a shot run in the wrong order")
    return value
