"""Fake devices that log what they are asked, and draw into the image where the robot stands."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from recorded_session import RecordedSession
from records import make_record, make_results
from scipy.spatial.transform import RigidTransform

from tronlab.calib.inputs import FrameInput, Inputs, PointInput
from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.config import CampaignConfig
from tronlab.campaign.drift import open_watch
from tronlab.campaign.shot import ShotTaker, TruthSource
from tronlab.devices.clock import SimulatedClock
from tronlab.devices.laboratory import ReflectorsSpec
from tronlab.devices.readings import (
    AirReading,
    DeviceIdentity,
    Frame,
    PointReading,
    PoseReading,
    RobotReading,
    RobotTarget,
    RoomReading,
)
from tronlab.devices.registry import Devices
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.planning.shots import Plan, Shot
from tronlab.terrain.config import Registration
from tronlab.terrain.heightmap import HeightMap

COVARIANCE_M2 = ((1e-10, 0.0, 0.0), (0.0, 1e-10, 0.0), (0.0, 0.0, 1e-10))
REFLECTORS_M = {"top_left": (0.0, 0, 0), "bottom_left": (2.0, 0, 0), "top_right": (0.0, 4.0, 0)}
CAMERA = CameraModel(width_px=16, height_px=12, fx_px=12.0, fy_px=12.0, cx_px=7.5, cy_px=5.5)


@dataclass
class Laboratory:
    """What the fakes share: the log of calls, where the robot stands, and scripted failures."""

    log: list[str] = field(default_factory=list[str])
    rail_m: float = 0.0
    failures: dict[tuple[str, int], Exception] = field(
        default_factory=dict[tuple[str, int], Exception]
    )
    """By call and its number, from 1."""
    on_call: Callable[[str], None] = lambda call: None
    shifts_m: list[float] = field(default_factory=list[float])
    """How far the T-MAC seems to have moved at each look, until there are no more."""
    doors: list[bool] = field(default_factory=list[bool])
    """Whether the door is closed at each look, until there are no more; then it is."""
    air: AirReading | None = None
    """What the tracker says of the air."""
    drift_m: float = 0.0
    """How far all reflectors seem to have moved, along each axis."""

    def call(self, name: str) -> None:
        self.log.append(name)
        self.on_call(name)
        failure = self.failures.get((name, self.log.count(name)))
        if failure is not None:
            raise failure


@dataclass
class Fake:
    laboratory: Laboratory
    name: str

    def connect(self) -> None:
        self.laboratory.call(f"connect {self.name}")

    def close(self) -> None:
        self.laboratory.call(f"close {self.name}")

    def identify(self) -> DeviceIdentity:
        return DeviceIdentity(maker="Fake", model=self.name, serial="1", firmware="")


class FakeRobot(Fake):
    def check(self, target: RobotTarget) -> None: ...

    def move(self, target: RobotTarget, *, timeout_s: float) -> None:
        self.laboratory.call("move")
        self.laboratory.rail_m = target.rail_m

    def read(self) -> RobotReading:
        self.laboratory.call("read_robot")
        return RobotReading(self.laboratory.rail_m, RigidTransform.identity(), 0.0)

    def stop(self) -> None:
        self.laboratory.call("stop")


class FakeTracker(Fake):
    def identify_target(self) -> DeviceIdentity:
        return DeviceIdentity(maker="Fake", model="tmac", serial="1", firmware="")

    def measure_point(self, target: str, *, window_s: float) -> PointReading:
        self.laboratory.call("point")
        p_trk_m = np.array(REFLECTORS_M[target]) + self.laboratory.drift_m
        return PointReading(target, p_trk_m, 1e-10 * np.eye(3), 5.0)

    def measure_pose(self, *, window_s: float) -> PoseReading:
        self.laboratory.call("look" if window_s < 1 else "measure")
        shift_m = self.laboratory.shifts_m.pop(0) if self.laboratory.shifts_m else 0.0
        position = [0.0, shift_m, self.laboratory.rail_m]
        pose = RigidTransform.from_translation(position)
        return PoseReading(pose, 1e-12 * np.eye(6), 0.0, air=self.laboratory.air)


class FakeCamera(Fake):
    def configure(self, *, exposure_s: float, gain_db: float, pixel_format: str) -> None:
        self.laboratory.call("configure")

    def grab(self, *, timeout_s: float) -> Frame:
        self.laboratory.call("grab")
        grey = round(self.laboratory.rail_m)
        image = np.full(CAMERA.shape, grey, np.uint8)
        return Frame(image, "Mono8", 0.01, 0.0, self.laboratory.log.count("grab"), 0.0)


class FakeRoom(Fake):
    def read(self) -> RoomReading:
        self.laboratory.call("read_room")
        is_door_closed = self.laboratory.doors.pop(0) if self.laboratory.doors else True
        return RoomReading(293.0, 1e5, 0.4, is_door_closed, True, 0.0)

    def switch_lamp(self, *, on: bool) -> None: ...


class FakeOperator(Fake):
    def perform(self, task: str) -> None: ...


class FlatGround:
    """The plane Z = 0."""

    def range_along_m(self, p_trs_m: FloatArray, direction_trs: FloatArray) -> float:
        return float(p_trs_m[2])


@pytest.fixture
def laboratory() -> Laboratory:
    return Laboratory()


@pytest.fixture
def devices(laboratory: Laboratory) -> Devices:
    return Devices(
        robot=FakeRobot(laboratory, "robot"),
        tracker=FakeTracker(laboratory, "tracker"),
        camera=FakeCamera(laboratory, "camera"),
        room=FakeRoom(laboratory, "room"),
        operator=FakeOperator(laboratory, "operator"),
        clock=SimulatedClock(0.0),
    )


@pytest.fixture
def config() -> CampaignConfig:
    return CampaignConfig.model_validate(
        {
            "name": "fake",
            "rig": Path(__file__),
            "calibration": Path(__file__),
            "trajectory": {
                "kind": "straight_line",
                "start_trs_m": (0, 0, 4),
                "end_trs_m": (0, 0, 1),
                "n_points": 4,
            },
            "camera": {"exposure_s": 0.01},
            "settle": {"wait_s": 0.25, "timeout_s": 2.0},
        }
    )


@pytest.fixture
def calibration() -> CalibrationRecord:
    results = make_results(
        camera=CAMERA,
        tmac_from_cam=RigidTransform.from_matrix(np.diag([1.0, -1.0, -1.0, 1.0])),
        sigma_rad=0.0,
        sigma_m=0.0,
    )
    points = {
        name: PointInput(p_trk_m=p_m, covariance_m2=COVARIANCE_M2, time_s=0.0)
        for name, p_m in REFLECTORS_M.items()
    }
    reflectors = ReflectorsSpec(
        bottom_left_m=REFLECTORS_M["bottom_left"], top_right_m=REFLECTORS_M["top_right"]
    )
    frame = FrameInput(measured_utc="2026-01-02T03:04:05Z", reflectors=reflectors, points=points)
    return make_record(results, rig_name="fake", inputs=Inputs(frame=frame))


@pytest.fixture
def heightmap() -> HeightMap:
    return HeightMap(np.zeros((5, 5), np.float32), 0.5, np.array([-1.0, -1.0, 0.0]))


@pytest.fixture
def taker(
    devices: Devices,
    config: CampaignConfig,
    calibration: CalibrationRecord,
    heightmap: HeightMap,
) -> ShotTaker:
    return ShotTaker(
        devices=devices,
        config=config,
        truth_source=TruthSource(calibration, heightmap, FlatGround(), Registration()),
        drift_watch=open_watch(devices.tracker, calibration, config.drift, advice="measure anew"),
    )


@pytest.fixture
def plan() -> Plan:
    """Four shots; the rail stands at ten times the shot's id."""
    return Plan(
        tuple(
            Shot(
                shot_id=shot_id,
                trs_from_cam_nominal=RigidTransform.from_translation([0, 0, 10.0 * shot_id]),
                robot_target=RobotTarget(10.0 * shot_id, RigidTransform.identity()),
            )
            for shot_id in (1, 2, 3, 4)
        )
    )


@pytest.fixture
def session(taker: ShotTaker, plan: Plan) -> RecordedSession:
    return RecordedSession(taker, plan)
