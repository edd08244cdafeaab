"""The driver against the simulated tracker, whose byte tables were written independently."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from drivers.leica.driver import LeicaTracker, open_tracker
from drivers.leica.simulator.scene import StaticScene
from drivers.leica.simulator.server import TrackerServer
from drivers.leica.simulator.tracker import Machine
from tronlab.devices.protocols import PoseTracker
from tronlab.devices.registry import DeviceContext
from tronlab.errors import (
    AccessDeniedError,
    DeviceError,
    DeviceFaultError,
    DeviceTimeoutError,
    LimitError,
    NotConnectedError,
    NotReadyError,
    TrackingLostError,
)
from tronlab.geometry.uncertainty import pose_difference
from tronlab.twin.state import FOR_EVER, ArmedFaults

QUICK = Machine(initialize_s=0.05, slew_rad_per_s=100.0, face_turn_s=0.05, search_m_per_s=10.0)
WINDOW_S = 0.1
PERFECT = {"coordinate_sigma_m": 0.0, "coordinate_sigma_m_per_m": 0.0, "rotation_sigma_deg": 0.0}
"""Stated accuracy of the static scene's tracker: its noise is all scatter, which it reports."""


@pytest.fixture
def faults() -> ArmedFaults:
    return ArmedFaults()


@pytest.fixture
def scene(rng: np.random.Generator) -> StaticScene:
    return StaticScene(rng)


@pytest.fixture
def server(scene: StaticScene, faults: ArmedFaults) -> Iterator[TrackerServer]:
    server = TrackerServer(scene, faults, machine=QUICK)
    yield server
    server.close()


@pytest.fixture
def make(server: TrackerServer, scene: StaticScene) -> Iterator[Callable[..., LeicaTracker]]:
    made: list[LeicaTracker] = []

    def make_one(*, reflector_type: str = "CCR-1.5in", **options: Any) -> LeicaTracker:
        host, port = server.address
        assert scene.trk_from_tmac is not None
        values = {
            "host": host,
            "port": port,
            "reflectors": {
                name: {"p_trk_m": [float(v) + 0.004 for v in p], "type": reflector_type}
                for name, p in scene.reflectors.items()
            },
            "tmac": {"p_trk_m": [float(v) for v in scene.trk_from_tmac.translation + 0.02]},
            "timeout_s": 1.0,
            "lock_timeout_s": 0.3,
            "move_timeout_s": 6.0,
        }
        context = DeviceContext(name="tracker", options=values | options, seed=0, world=None)
        made.append(open_tracker(context))
        return made[-1]

    yield make_one
    for tracker in made:
        tracker.close()


@pytest.fixture
def tracker(make: Callable[..., LeicaTracker]) -> LeicaTracker:
    tracker = make()
    tracker.connect()
    return tracker


def moved(pose: RigidTransform, by_m: list[float]) -> RigidTransform:
    return RigidTransform.from_components(pose.translation + by_m, pose.rotation)


def test_it_is_a_pose_tracker(tracker: LeicaTracker):
    assert isinstance(tracker, PoseTracker)


def test_identity_comes_over_the_wire(tracker: LeicaTracker, scene: StaticScene):
    identity = tracker.identify()
    assert identity.maker == "Leica"
    assert "AT901" in identity.model
    assert identity.serial == str(scene.serial)
    assert tracker.identify() == identity
    assert tracker.identify_target().serial == str(scene.serial)


def test_air_of_the_weather_station(tracker: LeicaTracker, scene: StaticScene):
    air = tracker.weather()
    assert air.temperature_k == pytest.approx(scene.air.temperature_k, abs=0.01)
    assert air.pressure_pa == pytest.approx(scene.air.pressure_pa, abs=1.0)
    assert air.relative_humidity == pytest.approx(scene.air.relative_humidity, abs=0.001)


def test_points_scatter_about_the_truth_by_their_covariance(
    make: Callable[..., LeicaTracker], scene: StaticScene
):
    tracker = make(accuracy=PERFECT)
    tracker.connect()
    chi_square = 0.0
    for name, p_trk in scene.reflectors.items():
        reading = tracker.measure_point(name, window_s=WINDOW_S)
        off_m = reading.p_trk_m - p_trk
        chi_square += float(off_m @ np.linalg.solve(reading.covariance_m2, off_m))
    assert 2.0 < chi_square < 30.0  # 12 degrees of freedom: 0.06 % and 99.7 %


def test_poses_scatter_about_the_truth_by_their_covariance(
    make: Callable[..., LeicaTracker], scene: StaticScene
):
    tracker = make(accuracy=PERFECT)
    tracker.connect()
    assert scene.trk_from_tmac is not None
    chi_square = 0.0
    for _ in range(5):
        reading = tracker.measure_pose(window_s=WINDOW_S)
        off = pose_difference(reading.trk_from_tmac, scene.trk_from_tmac)
        chi_square += float(off @ np.linalg.solve(reading.covariance, off))
        assert reading.air is not None
        assert reading.air.pressure_pa == pytest.approx(scene.air.pressure_pa, abs=1.0)
    assert 11.0 < chi_square < 60.0  # 30 degrees of freedom: 0.06 % and 99.9 %


def test_pose_follows_any_rotation(tracker: LeicaTracker, scene: StaticScene):
    assert scene.trk_from_tmac is not None
    for angles_deg in ([0, 0, 0], [90, 0, 0], [-40, 60, 120], [180, 10, 0]):
        scene.trk_from_tmac = RigidTransform.from_components(
            scene.trk_from_tmac.translation, Rotation.from_euler("ZYX", angles_deg, degrees=True)
        )
        reading = tracker.measure_pose(window_s=WINDOW_S)
        off = pose_difference(reading.trk_from_tmac, scene.trk_from_tmac)
        assert np.abs(off[:3]).max() < 6e-4


def test_beam_follows_the_robot_far_away(tracker: LeicaTracker, scene: StaticScene):
    assert scene.trk_from_tmac is not None
    tracker.identify_target()
    tracker.measure_point("lamp", window_s=WINDOW_S)
    scene.trk_from_tmac = moved(scene.trk_from_tmac, [0.5, -1.0, 0.4])
    reading = tracker.measure_pose(window_s=WINDOW_S)
    np.testing.assert_allclose(
        reading.trk_from_tmac.translation, scene.trk_from_tmac.translation, atol=1e-4
    )


def test_beam_follows_the_robot_after_checks_of_the_tracker(
    tracker: LeicaTracker, scene: StaticScene
):
    assert scene.trk_from_tmac is not None
    tracker.follow_target()
    tracker.drift_check()
    tracker.two_face_check("lamp", window_s=WINDOW_S)
    scene.trk_from_tmac = moved(scene.trk_from_tmac, [0.5, -1.0, 0.4])
    tracker.measure_pose(window_s=WINDOW_S)


def test_wrong_kind_of_reflector_gives_a_wrong_distance(
    make, scene: StaticScene, tracker: LeicaTracker
):
    right = tracker.measure_point("top_left", window_s=WINDOW_S)
    tracker.close()
    wrong = make(reflector_type="GP-1.5in")
    wrong.connect()
    reading = wrong.measure_point("top_left", window_s=WINDOW_S)
    distances = [np.linalg.norm(r.p_trk_m) for r in (right, reading)]
    assert abs(distances[0] - distances[1]) > 1e-3


def test_two_faces_agree_on_a_tracker_that_is_well_adjusted(tracker: LeicaTracker):
    check = tracker.two_face_check("top_left", window_s=WINDOW_S)
    assert 0.0 < check.difference_m < 200e-6
    assert check.distance_m == pytest.approx(np.sqrt(9 + 4 + 1.21), abs=0.02)
    assert tracker.status().face == 1


def test_two_faces_of_a_badly_adjusted_tracker_are_told(
    scene: StaticScene, faults: ArmedFaults, make, server: TrackerServer
):
    bad = TrackerServer(scene, faults, machine=replace(QUICK, two_face_sigma_rad=1e-3))
    try:
        tracker = make(port=bad.address[1])
        tracker.connect()
        assert not tracker.two_face_check("top_left", window_s=WINDOW_S).is_good
        tracker.close()
    finally:
        bad.close()


def test_drift_is_small_on_a_quiet_tracker(tracker: LeicaTracker):
    drift = tracker.drift_check()
    assert 0.0 < abs(drift.hz_rad) < 1e-3
    assert abs(drift.distance_m) < 1e-4


def test_stream_of_poses(tracker: LeicaTracker, scene: StaticScene):
    assert scene.trk_from_tmac is not None
    readings = list(tracker.stream_poses(interval_s=0.01, n=20))
    assert len(readings) == 20
    times = [reading.tracker_time_s for reading in readings]
    assert np.diff(times).min() > 0.0
    for reading in readings:
        off = pose_difference(reading.trk_from_tmac, scene.trk_from_tmac)
        assert np.abs(off[:3]).max() < 6e-4
        assert np.abs(off[3:]).max() < 1e-4
    tracker.measure_pose(window_s=WINDOW_S)


@pytest.mark.parametrize(
    ("fault", "times", "expected"),
    [
        ("tracker.beam_broken", FOR_EVER, TrackingLostError),
        ("tracker.beam_breaks", 1, TrackingLostError),
        ("tracker.warming_up", FOR_EVER, NotReadyError),
        ("tracker.busy", FOR_EVER, NotReadyError),
        ("tracker.pose_invalid", FOR_EVER, TrackingLostError),
        ("tracker.probe_missing", FOR_EVER, DeviceFaultError),
        ("tracker.unknown_code", 1, DeviceFaultError),
        ("tracker.error_packet", 1, NotReadyError),
    ],
)
def test_fault_raises_its_error_and_the_next_measurement_works(
    tracker: LeicaTracker,
    faults: ArmedFaults,
    fault: str,
    times: int,
    expected: type[DeviceError],
):
    tracker.measure_pose(window_s=WINDOW_S)
    faults.arm(fault, times=times)
    with pytest.raises(DeviceError, match=r"^tracker: measure_pose: ") as failure:
        tracker.measure_pose(window_s=WINDOW_S)
    assert type(failure.value) is expected
    faults.arm(fault, times=0)
    tracker.measure_pose(window_s=WINDOW_S)


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        ("tracker.warming_up", 10012),
        ("tracker.busy", 1),
        ("tracker.probe_missing", 75),
        ("tracker.unknown_code", 31999),
        ("tracker.error_packet", 10009),
    ],
)
def test_number_of_the_fault_is_carried_through(
    tracker: LeicaTracker, faults: ArmedFaults, fault: str, code: int
):
    tracker.measure_pose(window_s=WINDOW_S)
    faults.arm(fault)
    with pytest.raises(DeviceFaultError) as failure:
        tracker.measure_pose(window_s=WINDOW_S)
    assert failure.value.code == code


@pytest.mark.parametrize(
    ("fault", "expected"),
    [("tracker.silent", DeviceTimeoutError), ("tracker.disconnect", NotConnectedError)],
)
def test_lost_connection_comes_back_after_close_and_connect(
    tracker: LeicaTracker, faults: ArmedFaults, fault: str, expected: type[DeviceError]
):
    tracker.measure_pose(window_s=WINDOW_S)
    faults.arm(fault, times=1)
    with pytest.raises(expected, match="measure_pose"):
        tracker.measure_pose(window_s=WINDOW_S)
    faults.arm(fault, times=0)
    with pytest.raises(NotConnectedError, match="call connect"):
        tracker.measure_pose(window_s=WINDOW_S)
    tracker.close()
    tracker.connect()
    tracker.measure_pose(window_s=WINDOW_S)


@pytest.mark.parametrize("fault", ["tracker.split", "tracker.events"])
def test_harmless_disturbances_change_nothing(
    tracker: LeicaTracker, faults: ArmedFaults, fault: str
):
    faults.arm(fault)
    tracker.close()
    tracker.connect()
    tracker.measure_point("top_left", window_s=WINDOW_S)
    tracker.measure_pose(window_s=WINDOW_S)
    assert len(list(tracker.stream_poses(interval_s=0.01, n=5))) == 5


def test_warming_up_refuses_the_connection(make, faults: ArmedFaults):
    faults.arm("tracker.warming_up")
    with pytest.raises(NotReadyError, match=r"connect: the laser: not warmed up") as refusal:
        make().connect()
    assert refusal.value.code == 10012


def test_reflector_that_stays_another_one_is_refused(make, faults: ArmedFaults):
    tracker = make(reflector_type="GP-1.5in")
    tracker.connect()
    faults.arm("tracker.wrong_reflector")
    with pytest.raises(DeviceFaultError, match="distances would be wrong") as fault:
        tracker.measure_point("top_left", window_s=WINDOW_S)
    assert fault.value.code == 23


def test_fault_that_refuses_clients(make, faults: ArmedFaults):
    faults.arm("tracker.refuse_client", times=1)
    tracker = make()
    with pytest.raises(AccessDeniedError):
        tracker.connect()
    tracker.connect()


def test_second_client_is_refused_and_the_first_goes_on(tracker: LeicaTracker, make):
    with pytest.raises(AccessDeniedError, match="another client"):
        make().connect()
    tracker.identify()


def test_beam_broken_while_idle_is_told_and_mended(tracker: LeicaTracker, faults: ArmedFaults):
    tracker.measure_pose(window_s=WINDOW_S)
    tracker.notices()
    faults.arm("tracker.beam_broken")
    notices: list[Any] = []
    while not any(notice.is_error for notice in notices):
        notices += tracker.notices()
    assert next(notice.code for notice in notices if notice.is_error) == 701
    faults.arm("tracker.beam_broken", times=0)
    tracker.measure_pose(window_s=WINDOW_S)


def test_tmac_that_moved_while_the_beam_was_broken_is_found_nearby(
    tracker: LeicaTracker, faults: ArmedFaults, scene: StaticScene
):
    assert scene.trk_from_tmac is not None
    tracker.measure_pose(window_s=WINDOW_S)
    faults.arm("tracker.beam_broken")
    with pytest.raises(TrackingLostError):
        tracker.measure_pose(window_s=WINDOW_S)
    scene.trk_from_tmac = moved(scene.trk_from_tmac, [0.0, 0.15, 0.0])
    faults.arm("tracker.beam_broken", times=0)
    reading = tracker.measure_pose(window_s=WINDOW_S)
    np.testing.assert_allclose(
        reading.trk_from_tmac.translation, scene.trk_from_tmac.translation, atol=1e-4
    )


def test_tmac_is_found_again_where_the_beam_broke_on_its_way(
    tracker: LeicaTracker, faults: ArmedFaults, scene: StaticScene
):
    """Far from where it was measured; and something stood there still at the first search."""
    assert scene.trk_from_tmac is not None
    tracker.measure_pose(window_s=WINDOW_S)
    scene.trk_from_tmac = moved(scene.trk_from_tmac, [0.5, -1.0, 0.4])
    faults.arm("tracker.beam_broken")
    for _ in range(2):
        with pytest.raises(TrackingLostError):
            tracker.measure_pose(window_s=WINDOW_S)
    scene.trk_from_tmac = moved(scene.trk_from_tmac, [0.0, 0.1, 0.0])
    faults.arm("tracker.beam_broken", times=0)
    tracker.measure_pose(window_s=WINDOW_S)


def test_tmac_is_found_again_after_the_tracker_was_started_anew(
    tracker: LeicaTracker, server: TrackerServer
):
    """Initialising leaves the beam elsewhere: where it points then is no place of the T-MAC."""
    tracker.measure_pose(window_s=WINDOW_S)
    server.tracker.is_initialised = False
    server.tracker.leave()
    tracker.measure_pose(window_s=WINDOW_S)


def test_tmac_that_has_gone_is_lost(tracker: LeicaTracker, scene: StaticScene):
    scene.trk_from_tmac = None
    with pytest.raises((TrackingLostError, DeviceFaultError), match="identify_target"):
        tracker.identify_target()


def test_reflector_that_is_elsewhere_is_lost(tracker: LeicaTracker, scene: StaticScene):
    scene.reflectors["top_left"] = scene.reflectors["top_left"] + [0.0, 0.5, 0.0]
    with pytest.raises(TrackingLostError, match="measure_point"):
        tracker.measure_point("top_left", window_s=WINDOW_S)
    with pytest.raises(LimitError, match="no reflector 'left'"):
        tracker.measure_point("left", window_s=WINDOW_S)


def test_air_by_hand(make):
    air = {"temperature_k": 290.0, "pressure_pa": 101_000.0, "relative_humidity": 0.3}
    tracker = make(air=air)
    tracker.connect()
    weather = tracker.weather()
    assert weather.temperature_k == pytest.approx(290.0)
    assert weather.pressure_pa == pytest.approx(101_000.0)
