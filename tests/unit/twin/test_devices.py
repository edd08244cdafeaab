from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import chi2

from tronlab.devices.protocols import MotionModel
from tronlab.devices.readings import RobotTarget
from tronlab.devices.registry import CLOCK_KEY, KINDS, DeviceContext, Devices
from tronlab.errors import (
    ConfigError,
    DeviceFaultError,
    DeviceTimeoutError,
    LimitError,
    NotConnectedError,
    TrackingLostError,
)
from tronlab.geometry.uncertainty import perturb, pose_difference
from tronlab.twin.devices import open_camera, open_robot, open_tracker

NO_ARM_NOISE = {"repeatability_sigma_m": 0.0, "repeatability_sigma_rad": 0.0}
NO_RAIL_NOISE = {"rail_repeatability_sigma_m": 0.0, "rail_backlash_m": 0.0}
N_DRAWS = 300


def assert_chi_square(whitened: np.ndarray) -> None:
    """Standard normal values: their sum of squares must be likely, neither too large nor small."""
    total = float((whitened**2).sum())
    low, high = chi2.ppf([1e-4, 1 - 1e-4], whitened.size)
    assert low < total < high


def targets(spec, look_at, *, n: int) -> list[RobotTarget]:
    """Give n targets that come and go along the rail."""
    return [spec.mounting.nominal.robot_target(look_at(z_m=1.0 + 0.5 * (i % 2))) for i in range(n)]


# --- robot ---


def test_robot_reads_what_was_commanded(bench, spec, look_at):
    b = bench()
    target = spec.mounting.nominal.robot_target(look_at(z_m=2.0))
    b.devices.robot.move(target, timeout_s=60.0)
    reading = b.devices.robot.read()
    assert reading.rail_m == target.rail_m
    np.testing.assert_allclose(
        reading.base_from_flange.as_matrix(), target.base_from_flange.as_matrix(), atol=1e-15
    )


def test_arm_repeats_within_its_sigma(bench, spec, look_at):
    b = bench(robot=NO_RAIL_NOISE)
    config, lab = b.world.config.robot, b.world.laboratory
    whitened = []
    for target in targets(spec, look_at, n=N_DRAWS):
        b.devices.robot.move(target, timeout_s=60.0)
        rail_from_flange = lab.trs_from_rail.inv() * b.world.truth.trs_from_flange
        actual = perturb(rail_from_flange, np.r_[0, 0, 0, -target.rail_m * lab.rail_axis])
        difference = pose_difference(target.base_from_flange, actual)
        whitened.append(difference / np.repeat([1e-4, 1e-4], 3))
    assert config.repeatability_sigma_m == config.repeatability_sigma_rad == 1e-4
    assert_chi_square(np.array(whitened)[:, :3])
    assert_chi_square(np.array(whitened)[:, 3:])


def test_rail_repeats_within_its_sigma_and_has_backlash_one_way(bench, spec, look_at):
    b = bench(robot=NO_ARM_NOISE)
    lab = b.world.laboratory
    errors = []
    for target in targets(spec, look_at, n=N_DRAWS):
        b.devices.robot.move(target, timeout_s=60.0)
        flange = (lab.trs_from_rail.inv() * b.world.truth.trs_from_flange).translation
        moved = flange - target.base_from_flange.translation
        errors.append(moved[0] / lab.rail_axis[0] - target.rail_m)
    forward, backward = np.array(errors[::2]), np.array(errors[1::2])
    assert_chi_square(forward / 2e-5)
    assert_chi_square((backward - 2e-4) / 2e-5)


def test_a_rail_that_stands_keeps_its_error(bench, spec, look_at):
    b = bench(robot=NO_ARM_NOISE)
    target = spec.mounting.nominal.robot_target(look_at(z_m=2.0))
    b.devices.robot.move(target, timeout_s=60.0)
    before = b.world.truth.trs_from_flange.as_matrix()
    b.devices.robot.move(target, timeout_s=60.0)
    np.testing.assert_array_equal(b.world.truth.trs_from_flange.as_matrix(), before)


def test_move_out_of_reach_moves_nothing(bench, spec, look_at):
    b = bench()
    far = spec.mounting.nominal.robot_target(look_at(z_m=8.0))
    before = b.world.state.read()
    for call in (b.devices.robot.check, lambda t: b.devices.robot.move(t, timeout_s=60.0)):
        with pytest.raises(LimitError, match=r"robot: (check|move): rail position is -3\.0\d+ m"):
            call(far)
    assert b.world.state.read() == before


def test_move_that_takes_too_long_is_a_timeout(bench, spec, look_at):
    b = bench()
    with pytest.raises(DeviceTimeoutError, match=r"robot: move: takes \d\.\d s, allowed 0\.5 s"):
        b.devices.robot.move(spec.mounting.nominal.robot_target(look_at(z_m=1.0)), timeout_s=0.5)


def test_moves_take_simulated_time(bench, spec, look_at):
    b = bench()
    b.devices.robot.move(spec.mounting.nominal.robot_target(look_at(z_m=2.0)), timeout_s=60.0)
    before_s = b.world.clock.now_s
    b.devices.robot.move(spec.mounting.nominal.robot_target(look_at(z_m=1.0)), timeout_s=60.0)
    speed = b.world.config.robot.rail_speed_m_per_s
    assert b.world.clock.now_s - before_s == pytest.approx(1.0 / speed)


# --- tracker ---


def test_points_scatter_by_their_stated_covariance(bench):
    b = bench()
    lab, config = b.world.laboratory, b.world.config.tracker
    whitened = []
    for _ in range(N_DRAWS):
        for name, p_trs in lab.p_targets_trs_m.items():
            reading = b.devices.tracker.measure_point(name, window_s=0.5)
            p_trk = lab.trk_from_trs.apply(p_trs)
            sigma_m = 15e-6 + 6e-6 * np.linalg.norm(p_trk)
            np.testing.assert_allclose(reading.covariance_m2, sigma_m**2 * np.eye(3), rtol=1e-9)
            whitened.append((reading.p_trk_m - p_trk) / sigma_m)
    assert (config.coordinate_sigma_m, config.coordinate_sigma_m_per_m) == (15e-6, 6e-6)
    assert_chi_square(np.array(whitened))


def test_poses_scatter_by_their_stated_covariance(bench, spec, look_at):
    b = bench()
    b.devices.robot.move(spec.mounting.nominal.robot_target(look_at(z_m=2.0)), timeout_s=60.0)
    truth = b.world.truth
    trk_from_tmac = truth.laboratory.trk_from_trs * truth.trs_from_tmac
    readings = [b.devices.tracker.measure_pose(window_s=0.5) for _ in range(N_DRAWS)]
    differences = np.array([pose_difference(trk_from_tmac, r.trk_from_tmac) for r in readings])
    sigma_m = 15e-6 + 6e-6 * np.linalg.norm(trk_from_tmac.translation)
    sigma = np.repeat([np.radians(0.01) / np.sqrt(3.0), sigma_m], 3)
    np.testing.assert_allclose(readings[0].covariance, np.diag(sigma**2), rtol=1e-9)
    assert_chi_square(differences[:, :3] / sigma[:3])
    assert_chi_square(differences[:, 3:] / sigma[3:])
    total = np.sqrt((differences[:, :3] ** 2).sum(axis=1).mean())
    assert total == pytest.approx(np.radians(0.01), rel=0.1)


def test_measured_chain_is_the_true_camera_pose_within_noise(bench, spec, look_at):
    """With the true hand-eye and frame, what is left is the tracker's noise over the lever."""
    b = bench()
    lab = b.world.laboratory
    tmac_from_cam = lab.flange_from_tmac.inv() * lab.flange_from_cam
    whitened = []
    for i in range(60):
        b.devices.robot.move(
            spec.mounting.nominal.robot_target(look_at(z_m=1.0 + 0.05 * i)), timeout_s=60.0
        )
        reading = b.devices.tracker.measure_pose(window_s=0.5)
        truth = (lab.trk_from_trs * b.world.truth.trs_from_cam).translation
        measured = (reading.trk_from_tmac * tmac_from_cam).translation
        lever = reading.trk_from_tmac.rotation.apply(tmac_from_cam.translation)
        sigma_rad, sigma_m = np.sqrt(reading.covariance[[0, 3], [0, 3]])
        covariance = sigma_m**2 * np.eye(3) + sigma_rad**2 * (
            (lever @ lever) * np.eye(3) - np.outer(lever, lever)
        )
        whitened.append(np.linalg.solve(np.linalg.cholesky(covariance), measured - truth))
    assert_chi_square(np.array(whitened))


def test_unknown_reflector_lists_the_known_ones(bench):
    with pytest.raises(LimitError, match="no reflector 'middle'; reflectors: top_left, bottom"):
        bench().devices.tracker.measure_point("middle", window_s=0.5)


@pytest.mark.parametrize("window_s", [0.0, -1.0, float("nan")])
def test_window_must_have_a_length(bench, window_s: float):
    devices = bench().devices
    with pytest.raises(LimitError, match=r"measure_pose: window is .* s, must be more than 0"):
        devices.tracker.measure_pose(window_s=window_s)
    with pytest.raises(LimitError, match="measure_point: window is"):
        devices.tracker.measure_point("lamp", window_s=window_s)


def test_a_moved_tracker_sees_all_from_where_it_stands_now(bench):
    """Pushed at the second measurement of a point, by 1 mm to the right of the model."""
    moved = {"device": "tracker", "call": "measure_point", "at": 2, "error": "moved"}
    b = bench(
        faults=[{**moved, "moved_m": (0.0, 1e-3, 0.0)}],
        tracker={"coordinate_sigma_m": 1e-9, "coordinate_sigma_m_per_m": 0.0},
    )
    tracker, trs_from_trk = b.devices.tracker, b.world.laboratory.trk_from_trs.inv()
    before = tracker.measure_point("top_left", window_s=0.5)
    pose_before = tracker.measure_pose(window_s=0.5).trk_from_tmac
    after = [tracker.measure_point("top_left", window_s=0.5) for _ in range(2)]
    pose_after = tracker.measure_pose(window_s=0.5).trk_from_tmac
    for shift_trk in (
        after[0].p_trk_m - before.p_trk_m,
        after[1].p_trk_m - before.p_trk_m,
        pose_after.translation - pose_before.translation,
    ):
        shift = trs_from_trk.rotation.apply(shift_trk)
        np.testing.assert_allclose(shift, [0.0, -1e-3, 0.0], atol=1e-8)


def test_a_longer_window_takes_longer_and_states_the_same_accuracy(bench):
    b = bench()
    start_s = b.world.clock.now_s
    short = b.devices.tracker.measure_pose(window_s=0.5)
    long = b.devices.tracker.measure_pose(window_s=4.0)
    assert short.time_s == pytest.approx(start_s + 0.25)
    assert long.time_s == pytest.approx(start_s + 0.5 + 2.0)
    np.testing.assert_array_equal(short.covariance, long.covariance)


# --- camera ---


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"exposure_s": 100.0}, r"exposure is 100 s, allowed 1e-05 to 60 s"),
        ({"exposure_s": float("nan")}, r"exposure is nan s"),
        ({"gain_db": -1.0}, r"gain is -1 dB, allowed 0 to 33 dB"),
        ({"pixel_format": "RGB8"}, r"pixel format is 'RGB8', allowed Mono8, Mono12"),
    ],
)
def test_camera_refuses_what_it_cannot_do_and_changes_nothing(bench, change, message):
    camera = bench().devices.camera
    good = {"exposure_s": 0.01, "gain_db": 3.0, "pixel_format": "Mono12"}
    camera.configure(**good)
    with pytest.raises(LimitError, match=f"camera: configure: {message}"):
        camera.configure(**{**good, **change})
    frame = camera.grab(timeout_s=1.0)
    assert (frame.exposure_s, frame.gain_db, frame.pixel_format) == (0.01, 3.0, "Mono12")


def test_frame_is_as_configured(bench):
    b = bench()
    b.devices.camera.configure(exposure_s=0.01, gain_db=0.0, pixel_format="Mono12")
    start_s = b.world.clock.now_s
    frame = b.devices.camera.grab(timeout_s=1.0)
    assert frame.image.shape == (64, 64)
    assert frame.image.dtype == np.uint16
    assert frame.image.max() <= 4095
    assert frame.time_s == pytest.approx(start_s + 0.005)
    assert b.devices.camera.grab(timeout_s=1.0).frame_id == frame.frame_id + 1


def test_exposure_longer_than_the_timeout_is_a_timeout(bench):
    camera = bench().devices.camera
    camera.configure(exposure_s=2.0, gain_db=0.0, pixel_format="Mono8")
    with pytest.raises(DeviceTimeoutError, match=r"grab: .* take 2\.050 s, allowed 1\.000 s"):
        camera.grab(timeout_s=1.0)


def test_image_noise_is_that_of_photons_and_reading(bench):
    b = bench(lens={"principal_point_sigma_px": 0.5, "psf_sigma_px": 0.0})
    b.devices.camera.configure(exposure_s=0.1, gain_db=0.0, pixel_format="Mono12")
    frames = np.array([b.devices.camera.grab(timeout_s=1.0).image for _ in range(40)], float)
    sensor = b.world.config.sensor
    electrons = float(b.world.radiance()[0, 0]) * sensor.electrons_per_radiance * 0.1
    code_per_e = 4095 / sensor.full_well_e
    assert frames.mean() == pytest.approx(electrons * code_per_e, rel=1e-3)
    variance = (electrons + sensor.read_noise_e**2) * code_per_e**2 + 1 / 12
    assert frames.var(axis=0, ddof=1).mean() == pytest.approx(variance, rel=0.02)


# --- room and operator ---


def test_room_says_what_is_configured(bench):
    b = bench(room={"air_temperature_k": 294.0, "is_door_closed": False})
    reading = b.devices.room.read()
    assert (reading.air_temperature_k, reading.is_door_closed) == (294.0, False)
    assert reading.time_s == b.world.clock.now_s


def test_board_is_placed_by_eye_and_anew_each_time(bench, spec):
    b = bench()
    nominal = spec.board.trs_from_board.pose
    differences = []
    for _ in range(N_DRAWS):
        b.devices.operator.perform("place_board")
        differences.append(pose_difference(nominal, b.world.truth.trs_from_board))
    whitened = np.array(differences) / np.repeat([np.radians(0.5), 0.005], 3)
    assert_chi_square(whitened)
    assert np.unique(whitened[:, 0]).size == N_DRAWS


# --- all ---


def session(devices: Devices, spec, look_at) -> list[bytes]:
    """Do a bit of everything and give every number that came of it."""
    devices.robot.move(spec.mounting.nominal.robot_target(look_at(z_m=2.0)), timeout_s=60.0)
    devices.operator.perform("place_board")
    point = devices.tracker.measure_point("top_left", window_s=0.5)
    pose = devices.tracker.measure_pose(window_s=0.5)
    frame = devices.camera.grab(timeout_s=1.0)
    return [
        point.p_trk_m.tobytes(),
        pose.trk_from_tmac.as_matrix().tobytes(),
        frame.image.tobytes(),
        np.array([point.time_s, pose.time_s, frame.time_s, devices.room.read().time_s]).tobytes(),
    ]


@pytest.mark.opencv
def test_same_seeds_and_calls_give_the_same_bits(bench, spec, look_at):
    once = session(bench(seed=7).devices, spec, look_at)
    again = session(bench(seed=7).devices, spec, look_at)
    other_run = session(bench(seed=8).devices, spec, look_at)
    assert once == again
    assert all(a != b for a, b in zip(once[:3], other_run[:3], strict=True))


def test_another_run_is_in_the_same_laboratory(bench):
    one, other = bench(seed=7).world, bench(seed=8).world
    assert one.serial == other.serial
    np.testing.assert_array_equal(
        one.truth.trs_from_cam.as_matrix(), other.truth.trs_from_cam.as_matrix()
    )


def test_one_device_does_not_disturb_the_noise_of_another(bench):
    quiet, busy = bench(seed=7).devices, bench(seed=7).devices
    busy.camera.grab(timeout_s=1.0)
    busy.operator.perform("place_board")
    np.testing.assert_array_equal(
        quiet.tracker.measure_point("lamp", window_s=0.5).p_trk_m,
        busy.tracker.measure_point("lamp", window_s=0.5).p_trk_m,
    )


def calls(devices: Devices, spec, look_at) -> list[tuple[str, Callable[[], object]]]:
    target = spec.mounting.nominal.robot_target(look_at(z_m=2.0))
    return [
        ("identify", devices.robot.identify),
        ("check", lambda: devices.robot.check(target)),
        ("move", lambda: devices.robot.move(target, timeout_s=60.0)),
        ("read", devices.robot.read),
        ("stop", devices.robot.stop),
        ("identify_target", devices.tracker.identify_target),
        ("measure_point", lambda: devices.tracker.measure_point("lamp", window_s=0.5)),
        ("measure_pose", lambda: devices.tracker.measure_pose(window_s=0.5)),
        (
            "configure",
            lambda: devices.camera.configure(exposure_s=0.01, gain_db=0.0, pixel_format="Mono8"),
        ),
        ("grab", lambda: devices.camera.grab(timeout_s=1.0)),
        ("read", devices.room.read),
        ("switch_lamp", lambda: devices.room.switch_lamp(on=False)),
        ("perform", lambda: devices.operator.perform("remove_board")),
    ]


def test_nothing_works_before_connect_nor_after_close(bench, spec, look_at):
    devices = bench(connect=False).devices
    for name, call in calls(devices, spec, look_at):
        with pytest.raises(NotConnectedError, match=rf"{name}: not connected; call connect\(\)"):
            call()
    for device in devices.all():
        device.connect()
    for _, call in calls(devices, spec, look_at):
        call()
    for device in devices.all():
        device.close()
        device.close()
    for _, call in calls(devices, spec, look_at):
        with pytest.raises(NotConnectedError):
            call()


def test_views_show_the_methods_of_their_protocol_and_nothing_else(bench):
    for kind, device in zip(KINDS, bench().devices.all(), strict=True):
        protocols = [KINDS[kind], *([MotionModel] if kind == "robot" else [])]
        allowed = {name for protocol in protocols for name in dir(protocol)}
        public = {name for name in dir(device) if not name.startswith("_")}
        assert public == {name for name in allowed if not name.startswith("_")}


def test_devices_of_a_laboratory_share_its_serial_number(bench):
    b = bench()
    identities = [device.identify() for device in b.devices.all()]
    identities.append(b.devices.tracker.identify_target())
    assert {identity.serial for identity in identities} == {b.world.serial}
    assert len({(identity.maker, identity.model) for identity in identities}) == 6


def test_scripted_faults_strike_their_call_and_the_next_succeeds(bench, spec, look_at):
    b = bench(
        faults=[
            {"device": "tracker", "call": "measure_pose", "at": 2, "error": "tracking_lost"},
            {"device": "robot", "call": "move", "at": 1, "error": "fault"},
            {"device": "camera", "call": "grab", "at": 1, "times": 2, "error": "timeout"},
        ]
    )
    target = spec.mounting.nominal.robot_target(look_at(z_m=2.0))
    before = b.world.state.read()
    with pytest.raises(DeviceFaultError, match="robot: move"):
        b.devices.robot.move(target, timeout_s=60.0)
    assert b.world.state.read() == before
    b.devices.robot.move(target, timeout_s=60.0)
    b.devices.tracker.measure_pose(window_s=0.5)
    with pytest.raises(TrackingLostError, match="tracker: measure_pose: the beam is broken"):
        b.devices.tracker.measure_pose(window_s=0.5)
    b.devices.tracker.measure_pose(window_s=0.5)
    for _ in range(2):
        with pytest.raises(DeviceTimeoutError, match="camera: grab"):
            b.devices.camera.grab(timeout_s=1.0)
    assert b.devices.camera.grab(timeout_s=1.0).frame_id == 1


def test_device_without_a_world_says_which_section_is_missing():
    with pytest.raises(ConfigError, match="world: simulated device 'arm' needs this section"):
        open_robot(DeviceContext("arm", {}, seed=1, world=None))


def test_device_with_options_is_refused(setup):
    message = r"devices\.camera\.options\.port: unknown key; known keys: world\n.*\.host: unknown"
    with pytest.raises(ConfigError, match=message):
        open_camera(DeviceContext("camera", {"port": 1, "host": "x"}, seed=1, world=setup))


def test_devices_of_one_rig_share_one_world(setup):
    shared: dict[str, object] = {}
    robot = open_robot(DeviceContext("robot", {}, seed=1, world=setup, shared=shared))
    tracker = open_tracker(DeviceContext("tracker", {}, seed=1, world=setup, shared=shared))
    assert robot._world is tracker._world
    assert shared[CLOCK_KEY] is robot._world.clock
