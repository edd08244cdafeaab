from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.devices.clock import SimulatedClock
from tronlab.devices.registry import Devices
from tronlab.geometry.uncertainty import pose_difference
from tronlab.render.photometry import Lambert
from tronlab.terrain.heightmap import HeightMap
from tronlab.twin.world import World, WorldSetup

EXACT_ROBOT = {
    "repeatability_sigma_m": 0.0,
    "repeatability_sigma_rad": 0.0,
    "rail_repeatability_sigma_m": 0.0,
    "rail_backlash_m": 0.0,
}


def drive(devices: Devices, spec, trs_from_cam: RigidTransform) -> None:
    devices.robot.move(spec.mounting.nominal.robot_target(trs_from_cam), timeout_s=60.0)


def test_camera_pose_is_the_chain_of_true_transforms(bench, spec, look_at):
    b = bench(robot=EXACT_ROBOT)
    drive(b.devices, spec, look_at(z_m=2.5, tilt_x_deg=10.0))
    lab, at = b.world.truth.laboratory, b.devices.robot.read()
    rail_from_base = np.eye(4)
    rail_from_base[:3, 3] = at.rail_m * lab.rail_axis
    chain = (
        lab.trs_from_rail.as_matrix()
        @ rail_from_base
        @ at.base_from_flange.as_matrix()
        @ lab.flange_from_cam.as_matrix()
    )
    np.testing.assert_allclose(b.world.truth.trs_from_cam.as_matrix(), chain, atol=1e-12)


def test_nominal_mounting_gets_the_camera_close_to_where_it_shall_be(bench, spec, look_at):
    b = bench()
    goal = look_at(z_m=3.0, tilt_y_deg=-15.0)
    drive(b.devices, spec, goal)
    difference = pose_difference(goal, b.world.truth.trs_from_cam)
    assert 1e-4 < np.linalg.norm(difference[3:]) < 0.06
    assert 1e-4 < np.linalg.norm(difference[:3]) < np.radians(2.0)


def test_the_camera_renders_from_its_true_pose(bench, spec, look_at):
    b = bench()
    drive(b.devices, spec, look_at(z_m=1.5))
    b.devices.camera.grab(timeout_s=1.0)
    np.testing.assert_array_equal(
        b.renderer.poses[-1].as_matrix(), b.world.truth.trs_from_cam.as_matrix()
    )


def test_a_view_is_rendered_once_as_long_as_nothing_changes(bench, spec, look_at):
    b = bench()
    drive(b.devices, spec, look_at(z_m=1.5))
    first = b.devices.camera.grab(timeout_s=1.0).image
    second = b.devices.camera.grab(timeout_s=1.0).image
    assert len(b.renderer.poses) == 1
    assert (first != second).any()
    drive(b.devices, spec, look_at(z_m=1.6))
    b.devices.camera.grab(timeout_s=1.0)
    assert len(b.renderer.poses) == 2


@pytest.mark.opencv
def test_board_is_seen_only_while_it_is_placed(bench, spec, look_at):
    b = bench()
    drive(b.devices, spec, look_at(z_m=1.5))
    without = b.world.radiance().copy()
    b.devices.operator.perform("place_board")
    with_board = b.world.radiance().copy()
    b.devices.operator.perform("remove_board")
    assert (with_board != without).mean() > 0.1
    np.testing.assert_array_equal(b.world.radiance(), without)


@pytest.mark.opencv
def test_board_is_found_where_the_true_camera_sees_it(bench, look_at):
    import cv2

    b = bench(coarseness=2)
    spec = b.world.spec
    drive(b.devices, spec, look_at(z_m=1.4, tilt_x_deg=-15.0, x_m=1.25))
    b.devices.operator.perform("place_board")
    b.devices.camera.configure(exposure_s=0.02, gain_db=0.0, pixel_format="Mono8")
    image = b.devices.camera.grab(timeout_s=1.0).image
    board = spec.board
    charuco = cv2.aruco.CharucoBoard(
        (board.columns, board.rows),
        board.square_m,
        board.marker_m,
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary)),
    )
    corners, ids, _, _ = cv2.aruco.CharucoDetector(charuco).detectBoard(image)
    assert len(ids) == (board.columns - 1) * (board.rows - 1)
    p_board = charuco.getChessboardCorners()[ids.ravel()]
    truth = b.world.truth
    cam_from_board = truth.trs_from_cam.inv() * truth.trs_from_board
    uv = truth.laboratory.camera.project(cam_from_board.apply(p_board))
    residuals = corners.reshape(-1, 2) - uv
    assert np.sqrt((residuals**2).mean()) < 0.1
    assert np.abs(residuals.mean(axis=0)).max() < 0.05


def test_dark_room_gives_no_light(bench):
    b = bench()
    b.devices.room.switch_lamp(on=False)
    assert not b.world.radiance().any()
    assert not b.devices.room.read().is_lamp_on
    b.devices.room.switch_lamp(on=True)
    assert b.world.radiance().all()


def test_terrain_has_its_albedo_and_stray_light(bench):
    b = bench()
    surface = b.world.config.surface
    expected = surface.albedo * b.renderer.radiance + surface.stray_radiance_w_per_m2_sr
    np.testing.assert_allclose(b.world.radiance(), expected, rtol=1e-6)


def test_terrain_is_loaded_once_and_when_the_camera_is_connected(spec, config):
    n_loaded = 0

    def load() -> HeightMap:
        nonlocal n_loaded
        n_loaded += 1
        return HeightMap(np.zeros((3, 3), np.float32), 0.1, np.zeros(3))

    world = World(
        WorldSetup(config, spec, load),
        make_renderer=lambda _: None,  # type: ignore[arg-type,return-value]
    )
    assert n_loaded == 0
    world.prepare_view()
    assert n_loaded == 1


def test_real_renderer_sees_a_lit_flat_model_on_black_cloth(spec, config, look_at):
    """A flat Lambert model: the radiance of its pixels is albedo I cos / (pi d^2)."""
    flat = HeightMap(np.zeros((23, 43), np.float32), 0.1, np.zeros(3))
    surface = config.surface.model_copy(update={"photometry": Lambert(), "rays_per_pixel": 1})
    config = config.model_copy(update={"surface": surface})
    world = World(WorldSetup(config, spec, lambda: flat))
    world.state.change(lamp_level=1.0)
    target = spec.mounting.nominal.robot_target(look_at(z_m=3.5))
    world.stand_robot(target, actual=target)
    image = world.radiance()

    lab, trs_from_cam = world.truth.laboratory, world.truth.trs_from_cam
    p_trs = np.array([[1.0, 2.0, 0.0], [0.3, 1.0, 0.0], [2.0, 3.5, 0.0]])
    uv = np.rint(lab.camera.project(trs_from_cam.inv().apply(p_trs))).astype(int)
    rays = np.column_stack([lab.camera.rays(uv), np.ones(3)])
    directions = trs_from_cam.rotation.apply(rays)
    depth = -trs_from_cam.translation[2] / directions[:, 2]
    to_lamp = lab.p_light_trs_m - (trs_from_cam.translation + depth[:, None] * directions)
    falloff = to_lamp[:, 2] / np.linalg.norm(to_lamp, axis=1) ** 3
    radiance = surface.albedo * config.lamp.intensity_w_per_sr / np.pi * falloff
    expected = radiance + surface.stray_radiance_w_per_m2_sr
    np.testing.assert_allclose(image[uv[:, 1], uv[:, 0]], expected, rtol=1e-4)
    assert image[0, 0] == pytest.approx(surface.stray_radiance_w_per_m2_sr)


def test_simulated_time_passes_only_when_told():
    clock = SimulatedClock(100.0)
    assert clock.now_s == 100.0
    clock.advance(2.5)
    assert clock.now_s == 102.5


@pytest.mark.parametrize("z_m", np.linspace(4.0, 1.0, 7))
@pytest.mark.parametrize("tilt_deg", [-25.0, 0.0, 25.0])
@pytest.mark.parametrize("lateral_m", [-0.4, 0.0, 0.4])
def test_twin_yaml_reaches_the_straight_line_and_what_calibration_needs(
    bench_robot, spec, look_at: Callable[..., RigidTransform], z_m, tilt_deg, lateral_m
):
    for tilts in ({"tilt_x_deg": tilt_deg}, {"tilt_y_deg": tilt_deg}):
        for moved in ({"x_m": 1.08 + lateral_m}, {"y_m": 2.08 + lateral_m}):
            bench_robot.check(
                spec.mounting.nominal.robot_target(look_at(z_m=z_m, **moved, **tilts))
            )


@pytest.fixture(scope="module")
def bench_robot(spec, config):
    from tronlab.devices.registry import DeviceContext
    from tronlab.twin.devices import open_robot

    setup = WorldSetup(config, spec, lambda: HeightMap(np.zeros((2, 2)), 0.1, np.zeros(3)))
    robot = open_robot(DeviceContext("robot", {}, seed=1, world=setup))
    robot.connect()
    return robot


def test_twin_yaml_camera_is_nominally_upright_before_the_model(spec, look_at):
    """Rail x towards the model, base upright, camera 1.1 to 1.2 m above the robot's base."""
    mounting = spec.mounting
    trs_from_rail = mounting.trs_from_rail.pose.rotation.as_matrix()
    expected = [[0, 0, -1], [0, -1, 0], [-1, 0, 0]]
    np.testing.assert_allclose(trs_from_rail, expected, atol=1e-12)
    base_from_cam = (
        mounting.nominal.robot_target(look_at(z_m=2.0)).base_from_flange
        * mounting.flange_from_cam.pose
    )
    assert 1.1 < base_from_cam.translation[2] < 1.25
    np.testing.assert_allclose(base_from_cam.rotation.apply([0, 0, 1]), [1, 0, 0], atol=1e-9)
    cam_from_tmac = mounting.flange_from_cam.pose.inv() * mounting.flange_from_tmac.pose
    assert 0.15 < np.linalg.norm(cam_from_tmac.translation) < 0.20


def test_the_room_is_dark_until_the_lamp_is_switched_on(setup):
    assert not World(setup).truth.is_lamp_on


@pytest.mark.parametrize(("true_m", "expected_m"), [(None, 0.03), (0.0, 0.0), (0.08, 0.08)])
def test_the_lamp_is_as_large_as_it_really_is(config, spec, true_m, expected_m):
    spec = spec.model_copy(update={"lamp": spec.lamp.model_copy(update={"radius_m": 0.03})})
    lamp = config.lamp.model_copy(update={"radius_m": true_m})
    setup = WorldSetup(
        config=config.model_copy(update={"lamp": lamp}),
        laboratory=spec,
        load_heightmap=lambda: pytest.fail("no image is taken"),
    )
    assert World(setup).lamp.radius_m == expected_m
