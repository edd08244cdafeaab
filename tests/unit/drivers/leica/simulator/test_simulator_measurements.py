"""What the simulated tracker measures, read at literal offsets, against the scene."""

import math
import time

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

SIGMA_M = 15e-6
SIGMA_RAD = 1e-4
LOOSE_M = 6 * SIGMA_M
HVD_LAMP = (math.atan2(1.0, 3.5), math.acos(1.9 / math.hypot(1.0, 3.5, 1.9)))


@pytest.fixture
def client(rig):
    rig.client.prepare()
    return rig.client


def point_at(client, p_m):
    client.do(58, "3d", *p_m)


def measure_point(client) -> np.ndarray:
    return client.measure(types=(2,)).floats(20)


def measured_pose(packet) -> RigidTransform:
    w, x, y, z = packet.floats(184, 4)
    return RigidTransform.from_components(packet.floats(48), Rotation.from_quat([x, y, z, w]))


def test_point_is_where_the_scene_has_it(rig, client):
    point_at(client, rig.scene.reflectors["top_left"])
    packet = client.measure(types=(2,))
    assert packet.size == 156
    assert packet.at(8, "3I") == (0, 0, 0)
    assert packet.floats(20) == pytest.approx(rig.scene.reflectors["top_left"], abs=LOOSE_M)
    assert packet.floats(44) == pytest.approx([SIGMA_M] * 3, rel=1e-6)
    assert packet.at(68, "d") == pytest.approx(SIGMA_M * math.sqrt(3), rel=1e-6)
    assert packet.floats(100) == pytest.approx([SIGMA_M] * 3, rel=1e-6)
    assert packet.floats(132) == pytest.approx([21.5, 987.0, 41.0])


def test_extended_statistics_have_covariances(rig, client):
    client.do(80, "2I", 1, 0)
    point_at(client, rig.scene.reflectors["lamp"])
    packet = client.measure(types=(9,))
    assert packet.size == 204
    assert packet.floats(20) == pytest.approx(rig.scene.reflectors["lamp"], abs=LOOSE_M)
    assert packet.floats(44) == pytest.approx([SIGMA_M] * 3, rel=1e-6)
    assert packet.floats(76) == pytest.approx([0, 0, 0], abs=1e-14)
    assert packet.floats(124) == pytest.approx([SIGMA_M] * 3, rel=1e-6)
    assert packet.floats(180) == pytest.approx([21.5, 987.0, 41.0])


def test_noise_is_that_of_the_scene(rig, client):
    point_at(client, rig.scene.reflectors["top_left"])
    client.do(30, "2i2I", 1, 400, 0, 0)
    client.do(24, "I", 1)
    client.do(49)
    values: list[np.ndarray] = []
    while len(values) < 400:
        packet = client.receive_data(3)
        values += [packet.floats(48 + 36 * i + 12) for i in range(packet.at(12, "i"))]
    errors = (np.array(values) - rig.scene.reflectors["top_left"]) / SIGMA_M
    low, high = chi2.ppf([1e-4, 1 - 1e-4], errors.size)
    assert low < float(np.sum(errors**2)) < high
    assert np.abs(errors.mean(axis=0)).max() < 4 / math.sqrt(len(values))


def test_stationary_measurement_takes_its_time(rig, client):
    point_at(client, rig.scene.reflectors["lamp"])
    client.do(28, "iI", 300, 1)
    begin_s = time.monotonic()
    client.measure(types=(2,))
    assert time.monotonic() - begin_s >= 0.3


def test_wrong_reflector_means_wrong_distance(rig, client):
    p_m = rig.scene.reflectors["top_left"]
    point_at(client, p_m)
    client.do(40, "i", 4)
    seen = measure_point(client)
    assert np.linalg.norm(seen) - np.linalg.norm(p_m) == pytest.approx(-0.00958, abs=LOOSE_M)
    assert seen / np.linalg.norm(seen) == pytest.approx(p_m / np.linalg.norm(p_m), abs=4e-5)


def test_the_reflector_active_at_start_is_not_the_mounted_one(rig):
    client = rig.client
    assert client.do(41).at(16, "i") == 2
    client.send_command(42)
    listed = [client.receive() for _ in range(4)]
    assert {packet.at(16, "i") for packet in listed} == {4}
    names = {packet.at(20, "i"): packet.text(36, 64) for packet in listed}
    assert names[7] == "CCR-1.5in"
    assert names[2] == "CCR-0.5in"


def test_wrong_air_means_wrong_distance(rig, client):
    """Air 1.5 K warmer and 26.25 hPa thinner than the standard: 1.4 and 7.0 ppm."""
    p_m = rig.scene.reflectors["top_left"]
    client.do(47, "9I", 0, 0, 0, 0, 0, 0, 0, 1, 0)
    point_at(client, p_m)
    client.do(20, "3d", 20.0, 1013.25, 50.0)
    seen = measure_point(client)
    ppm = 1e6 * (np.linalg.norm(seen) / np.linalg.norm(p_m) - 1)
    assert ppm == pytest.approx(-8.4, abs=1e6 * LOOSE_M / np.linalg.norm(p_m))
    client.do(20, "3d", 21.5, 987.0, 41.0)
    assert measure_point(client) == pytest.approx(p_m, abs=LOOSE_M)


def test_refraction_is_computed_or_set(rig, client):
    computed = client.do(23).floats(16, 2)
    assert computed[0] == pytest.approx(1 + 263.0e-6, abs=0.3e-6)
    assert computed[1] > computed[0]
    assert client.ask(22, "2d", 1.00027, 1.00027).status == 35
    client.do(120, "Ii", 1, 1)
    assert client.ask(22, "2d", 1.0, 1.00027).status == 12
    assert client.ask(22, "2d", 1.00027, 1.0004).status == 14
    client.do(22, "2d", 1.00027, 1.000275)
    assert tuple(client.do(23).floats(16, 2)) == (1.00027, 1.000275)


@pytest.mark.parametrize(
    ("unit", "m"), [(0, 1.0), (1, 1e-3), (2, 1e-6), (3, 0.3048), (4, 0.9144), (5, 0.0254)]
)
def test_lengths_come_in_the_units_asked_for(rig, client, unit, m):
    p_m = rig.scene.reflectors["lamp"]
    client.do(5, "5I", unit, 0, 0, 0, 0)
    point_at(client, p_m / m)
    packet = client.measure(types=(2,))
    assert packet.floats(20) * m == pytest.approx(p_m, abs=LOOSE_M)
    assert packet.floats(44) * m == pytest.approx([SIGMA_M] * 3, rel=1e-6)


@pytest.mark.parametrize(("unit", "rad"), [(0, 1.0), (1, math.pi / 180), (2, math.pi / 200)])
def test_angles_come_in_the_units_asked_for(rig, client, unit, rad):
    client.do(5, "5I", 0, unit, 0, 0, 0)
    point_at(client, rig.scene.reflectors["lamp"])
    assert client.do(66).floats(16, 2) * rad == pytest.approx(HVD_LAMP, abs=1e-12)


@pytest.mark.parametrize(
    ("units", "expected"),
    [
        ((0, 0), (21.5, 987.0)),
        ((1, 1), (70.7, 987.0)),
        ((0, 2), (21.5, 98.7)),
        ((0, 3), (21.5, 740.31)),
        ((0, 4), (21.5, 14.3152)),
        ((0, 5), (21.5, 396.244)),
        ((0, 6), (21.5, 29.1461)),
    ],
)
def test_air_comes_in_the_units_asked_for(client, units, expected):
    client.do(5, "5I", 0, 0, *units, 0)
    assert client.do(21).floats(16) == pytest.approx((*expected, 41.0), rel=1e-5)


def test_environment_is_taken_in_the_units_in_force(client):
    client.do(120, "Ii", 1, 0)
    client.do(5, "5I", 0, 0, 1, 4, 0)
    client.do(20, "3d", 68.0, 14.5, 30.0)
    client.do(5, "5I", 0, 0, 0, 1, 0)
    assert client.do(21).floats(16) == pytest.approx([20.0, 999.7398, 30.0], rel=1e-6)


CARTESIAN = {0: (1, 1, 1), 1: (-1, 1, 1), 2: (1, -1, 1), 3: (1, 1, -1)}


@pytest.mark.parametrize("kind", CARTESIAN)
def test_left_handed_systems_have_one_axis_flipped(rig, client, kind):
    p_m = rig.scene.reflectors["lamp"]
    client.do(26, "I", kind)
    point_at(client, p_m * CARTESIAN[kind])
    assert measure_point(client) == pytest.approx(p_m * CARTESIAN[kind], abs=LOOSE_M)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        (4, (math.atan2(1.0, 3.5), math.hypot(1.0, 3.5), 1.9)),
        (5, (math.atan2(3.5, 1.0), math.hypot(1.0, 3.5), 1.9)),
        (6, (math.atan2(1.0, 3.5), HVD_LAMP[1], math.hypot(1.0, 3.5, 1.9))),
        (7, (math.atan2(3.5, 1.0), HVD_LAMP[1], math.hypot(1.0, 3.5, 1.9))),
    ],
)
def test_polar_systems(client, kind, expected):
    client.do(26, "I", kind)
    point_at(client, expected)
    packet = client.measure(types=(2,))
    assert packet.floats(20) == pytest.approx(expected, abs=LOOSE_M)
    radius = expected[1] if kind < 6 else expected[2] * math.sin(expected[1])
    assert packet.at(44, "d") == pytest.approx(SIGMA_M / radius, rel=1e-4)


def test_orientation_and_transformation_apply_only_when_switched_on(rig, client):
    p_m = rig.scene.reflectors["lamp"]
    client.do(12, "6d", 1.0, 2.0, 3.0, 0.0, 0.0, math.pi / 2)
    client.do(14, "7d", 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0)
    point_at(client, p_m)
    assert measure_point(client) == pytest.approx(p_m, abs=LOOSE_M)
    client.do(47, "9I", 2, 0, 1, 0, 0, 0, 0, 1, 0)
    world = np.array([1.0 - p_m[1], 2.0 + p_m[0], 3.0 + p_m[2]])
    assert measure_point(client) == pytest.approx(world, abs=LOOSE_M)
    client.do(47, "9I", 2, 1, 1, 0, 0, 0, 0, 1, 0)
    packet = client.measure(types=(2,))
    assert packet.floats(20) == pytest.approx(2 * (world - [0.5, 0, 0]), abs=2 * LOOSE_M)
    assert packet.floats(44) == pytest.approx([2 * SIGMA_M] * 3, rel=1e-6)
    assert client.do(15).floats(16, 7) == pytest.approx([0.5, 0, 0, 0, 0, 0, 2.0])
    point_at(client, packet.floats(20))
    assert measure_point(client) == pytest.approx(2 * (world - [0.5, 0, 0]), abs=2 * LOOSE_M)


def test_pose_is_where_the_scene_has_it(rig, client):
    client.do(24, "I", 6)
    point_at(client, rig.scene.trk_from_tmac.translation)
    packet = client.measure(types=(4,))
    assert packet.size == 376
    assert packet.at(8, "I") == 0
    assert packet.at(12, "I") == 6
    assert packet.at(24, "i") & 0b1111111 == 1
    assert packet.at(28, "i") == 3
    difference = measured_pose(packet).inv() * rig.scene.trk_from_tmac
    assert difference.translation == pytest.approx([0, 0, 0], abs=LOOSE_M)
    assert difference.rotation.magnitude() < 6 * SIGMA_RAD
    assert np.linalg.norm(packet.floats(184, 4)) == pytest.approx(1.0, abs=1e-12)
    assert packet.floats(72) == pytest.approx([SIGMA_M] * 3, rel=1e-6)
    assert packet.at(96, "d") == pytest.approx(SIGMA_M * math.sqrt(3), rel=1e-6)
    assert packet.floats(240) == pytest.approx([SIGMA_RAD] * 3, rel=1e-6)
    assert packet.at(264, "d") == pytest.approx(SIGMA_RAD * math.sqrt(3), rel=1e-6)
    assert packet.floats(352) == pytest.approx([21.5, 987.0, 41.0])


def test_pose_comes_in_the_units_and_the_orientation_asked_for(rig, client):
    client.do(24, "I", 6)
    point_at(client, rig.scene.trk_from_tmac.translation)
    client.do(12, "6d", 1.0, 0.0, 0.0, 0.3, -0.2, 1.0)
    client.do(47, "9I", 2, 0, 1, 0, 0, 0, 0, 1, 0)
    client.do(5, "5I", 1, 1, 0, 0, 0)
    packet = client.measure(types=(4,))
    station = RigidTransform.from_components(
        [1.0, 0.0, 0.0], Rotation.from_euler("xyz", [0.3, -0.2, 1.0])
    )
    expected = station * rig.scene.trk_from_tmac
    assert packet.floats(48) / 1000 == pytest.approx(expected.translation, abs=LOOSE_M)
    w, x, y, z = packet.floats(184, 4)
    turned = Rotation.from_quat([x, y, z, w]).inv() * expected.rotation
    assert turned.magnitude() < 6 * SIGMA_RAD
    assert packet.floats(240) == pytest.approx([math.degrees(SIGMA_RAD)] * 3, rel=1e-6)


def test_beam_follows_the_tmac(rig, client):
    client.do(24, "I", 6)
    point_at(client, rig.scene.trk_from_tmac.translation)
    moved = RigidTransform.from_translation([0.7, -0.5, 0.2]) * rig.scene.trk_from_tmac
    rig.scene.trk_from_tmac = moved
    assert client.measure(types=(4,)).floats(48) == pytest.approx(moved.translation, abs=LOOSE_M)
    assert client.do(124).floats(16) == pytest.approx(moved.translation, abs=1e-9)


def test_continuous_points_stop_at_the_count(rig, client):
    client.do(47, "9I", 2, 0, 0, 0, 1, 0, 0, 1, 0)
    point_at(client, rig.scene.reflectors["lamp"])
    client.do(24, "I", 1)
    client.do(30, "2i2I", 10, 45, 0, 0)
    client.do(120, "Ii", 400, 10)
    client.do(49)
    packets = [packet for packet in client.receive_event(28) if packet.type == 3]
    assert len(packets) > 1
    assert all(packet.size == 48 + 36 * packet.at(12, "i") for packet in packets)
    assert sum(packet.at(12, "i") for packet in packets) == 45
    times_s = [
        packet.at(48 + 36 * i + 4, "i") + 1e-6 * packet.at(48 + 36 * i + 8, "i")
        for packet in packets
        for i in range(packet.at(12, "i"))
    ]
    assert np.diff(times_s) == pytest.approx(np.full(44, 0.01), abs=2e-6)
    client.receive_event(27)


def test_extended_continuous_points(rig, client):
    point_at(client, rig.scene.reflectors["lamp"])
    client.do(80, "2I", 0, 1)
    client.do(24, "I", 1)
    client.do(30, "2i2I", 5, 3, 0, 0)
    client.do(49)
    packet = client.receive_data(10)
    assert packet.size == 48 + 92 * 3
    assert packet.floats(48 + 92 * 2 + 36) == pytest.approx([SIGMA_M] * 3, rel=1e-6)


def test_continuous_poses_run_until_stopped(rig, client):
    client.do(24, "I", 7)
    point_at(client, rig.scene.trk_from_tmac.translation)
    client.do(30, "2i2I", 20, 0, 0, 0)
    client.do(120, "Ii", 400, 10)
    client.do(49)
    for _ in range(3):
        packet = client.receive_data(5)
        n = packet.at(12, "i")
        assert packet.size == 68 + 212 * n
        assert packet.at(24, "i") == 3
        for start in range(68, packet.size, 212):
            assert packet.at(start + 8, "i") & 0b1111111 == 1
            w, x, y, z = packet.floats(start + 100, 4)
            turned = Rotation.from_quat([x, y, z, w]).inv() * rig.scene.trk_from_tmac.rotation
            assert turned.magnitude() < 6 * SIGMA_RAD
            assert packet.floats(start + 20) == pytest.approx(
                rig.scene.trk_from_tmac.translation, abs=LOOSE_M
            )
    client.do(52)
    assert client.do(2).at(16, "I") == 2
    client.do(49)
    assert client.receive_data(5).at(12, "i") > 0
    client.do(52)


def test_distance_mode_measures_when_the_tmac_has_moved(rig, client):
    client.do(24, "I", 8)
    point_at(client, rig.scene.trk_from_tmac.translation)
    client.do(32, "di2I", 0.05, 2, 0, 0)
    client.do(120, "Ii", 400, 10)
    client.do(49)
    assert client.receive_data(5).at(12, "i") == 1
    with pytest.raises(TimeoutError):
        client.receive(timeout_s=0.3)
    step = RigidTransform.from_translation([0.06, 0, 0])
    rig.scene.trk_from_tmac = step * rig.scene.trk_from_tmac
    assert client.receive_data(5).at(12, "i") == 1
    assert client.do(2).at(16, "I") == 2


def test_faces_differ_a_little_and_not_in_distance(rig, client):
    p_m = rig.scene.reflectors["top_left"]
    point_at(client, p_m)
    rig.server.tracker._collimation_rad, rig.server.tracker._index_rad = 1e-4, 2e-4
    first = measure_point(client)
    client.do(53)
    assert client.do(98).at(16, "I") == 2
    second = measure_point(client)
    distance_m = np.linalg.norm(p_m)
    across_m = distance_m * math.hypot(2e-4, 4e-4)
    assert np.linalg.norm(second - first) == pytest.approx(across_m, abs=LOOSE_M)
    assert np.linalg.norm(second) == pytest.approx(np.linalg.norm(first), abs=LOOSE_M)
    client.do(53)
    assert client.do(98).at(16, "I") == 1


def test_faces_of_a_well_adjusted_tracker_stay_within_the_allowed_difference(rig):
    tracker = rig.server.tracker
    worst_rad = 2 * math.hypot(tracker._collimation_rad, tracker._index_rad)
    assert 0 < worst_rad < 12e-6


def test_bird_bath_check_gives_a_small_drift(client):
    packet = client.do(87)
    assert packet.size == 64
    assert packet.floats(16) == pytest.approx([0.0, math.radians(125.0), 0.21])
    assert 0 < np.abs(packet.floats(40)).max() < 1e-3
    assert measure_point(client)[2] == pytest.approx(0.21 * math.cos(math.radians(125)), abs=1e-4)


def test_nivel_gives_two_small_tilts(client):
    client.do(51)
    packet = client.receive_data(6)
    assert packet.size == 40
    assert np.abs(packet.floats(16, 2)).max() < 2e-4
    assert packet.at(32, "d") == pytest.approx(21.5)
    again = (client.do(51), client.receive_data(6))[1]
    assert again.data == packet.data


def test_live_positions_of_reflector_and_tmac(rig, client):
    client.do(47, "9I", 2, 0, 0, 0, 0, 1, 0, 1, 0)
    point_at(client, rig.scene.reflectors["lamp"])
    live = client.receive_data(7)
    assert live.size == 36
    assert live.floats(12) == pytest.approx(rig.scene.reflectors["lamp"], abs=1e-9)
    client.do(24, "I", 6)
    point_at(client, rig.scene.trk_from_tmac.translation)
    live = client.receive_data(11)
    assert live.size == 108
    assert live.floats(28) == pytest.approx(rig.scene.trk_from_tmac.translation, abs=1e-9)
    x, y, z, w = rig.scene.trk_from_tmac.rotation.as_quat()
    assert live.floats(52, 4) == pytest.approx([w, x, y, z], abs=1e-9)
