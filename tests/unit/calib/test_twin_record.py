"""The committed record of the twin: made for the rig file as it is, and true."""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from tronlab.calib.camera.projection import free_intrinsics, intrinsics_of
from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.rig import Rig, load_rig
from tronlab.geometry.uncertainty import pose_difference
from tronlab.twin.truth import TrueLaboratory, build_laboratory
from tronlab.twin.world import World

ROOT = Path(__file__).parents[3]
REMAKE = "the twin's rig file changed: python calibration/calibrate_twin.py"


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(ROOT / "campaigns/rigs/twin.yaml")


@pytest.fixture(scope="module")
def record() -> CalibrationRecord:
    return CalibrationRecord.load(ROOT / "calibration/records/twin.json")


@pytest.fixture(scope="module")
def truth(rig: Rig) -> TrueLaboratory:
    assert rig.config.world is not None
    return build_laboratory(rig.config.laboratory, rig.config.world)


def nees(error: np.ndarray, covariance: np.ndarray) -> float:
    return float(error @ np.linalg.solve(covariance, error))


def test_it_is_for_the_rig_file_as_it_is(rig: Rig, record: CalibrationRecord) -> None:
    record.check_rig(rig.name)
    devices = rig.open_devices(0)
    devices.tracker.connect()
    assert record.devices["tmac"] == devices.tracker.identify_target(), REMAKE
    assert record.devices["tracker"] == devices.tracker.identify(), REMAKE
    serial = devices.tracker.identify().serial
    assert record.devices["camera"].serial == serial, REMAKE


def test_frame_hand_eye_and_camera_are_true(
    record: CalibrationRecord, truth: TrueLaboratory
) -> None:
    frame, camera, hand_eye = (
        record.results.frame,
        record.results.camera,
        record.results.hand_eye,
    )
    assert frame is not None
    assert camera is not None
    assert hand_eye is not None
    frame_error = pose_difference(frame.trs_from_trk, truth.trk_from_trs.inv())
    assert nees(frame_error, frame.covariance) < chi2.ppf(0.999, 6)
    tmac_from_cam = truth.flange_from_tmac.inv() * truth.flange_from_cam
    hand_eye_error = pose_difference(hand_eye.tmac_from_cam, tmac_from_cam)
    assert nees(hand_eye_error, hand_eye.covariance) < chi2.ppf(0.999, 6)
    free = free_intrinsics(camera.model)
    error = intrinsics_of(camera.camera) - intrinsics_of(truth.camera)
    assert nees(error[free], camera.covariance[np.ix_(free, free)]) < chi2.ppf(0.999, len(free))


def test_points_are_projected_where_they_are_seen(
    record: CalibrationRecord, truth: TrueLaboratory
) -> None:
    rays = truth.camera.ray_table()
    error_px = np.linalg.norm(record.camera.pixels(rays) - truth.camera.pixels(rays), axis=-1)
    assert np.median(error_px) < 0.1
    assert error_px.max() < 0.4


def test_the_light_is_where_it_is(record: CalibrationRecord, truth: TrueLaboratory) -> None:
    lamp = record.results.lamp
    assert lamp is not None
    assert nees(lamp.p_trs_m - truth.p_light_trs_m, lamp.covariance_m2) < chi2.ppf(0.999, 3)


def test_robot_and_rail_stand_where_they_do(
    record: CalibrationRecord, truth: TrueLaboratory
) -> None:
    robot = record.results.robot
    assert robot is not None
    rail = pose_difference(robot.trs_from_rail, truth.trs_from_rail)
    tmac = pose_difference(robot.flange_from_tmac, truth.flange_from_tmac)
    error = np.concatenate([rail, truth.rail_axis - robot.rail_axis, tmac])
    assert nees(error, robot.covariance) < chi2.ppf(0.999, 15)


def test_the_pose_of_shots_is_true(rig: Rig, record: CalibrationRecord) -> None:
    """Shots share the errors of one record, so that each is held to chi-square by itself."""
    assert rig.config.world is not None
    devices = rig.open_devices(seed=7)
    world: World = devices.tracker._world
    devices.tracker.connect()
    for _ in range(30):
        reading = devices.tracker.measure_pose(window_s=1.0)
        trs_from_cam, covariance = record.trs_from_cam(reading)
        error = pose_difference(trs_from_cam, world.truth.trs_from_cam)
        assert nees(error, covariance) < chi2.ppf(0.9999, 6)
        assert np.sqrt(np.trace(covariance[3:, 3:])) < 0.3e-3  # the robot stands 5 m off
        assert np.degrees(np.sqrt(np.trace(covariance[:3, :3]))) < 0.015
