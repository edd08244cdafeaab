"""Measuring reflectors that a scripted peer plays, and checks of the tracker with them."""

import struct

import numpy as np
import pytest

from drivers.leica.driver import LeicaTracker
from tronlab.errors import (
    DeviceFaultError,
    LimitError,
    TrackingLostError,
)

START = 49
CHANGE_FACE = 53
POINT_LASER = 58
POINT_LASER_HVD = 59
FIND = 63
SET_MODE = 24
SET_STATIONARY = 28
SET_REFLECTOR = 40
GET_REFLECTOR = 41
CHECK_BIRDBATH = 87


@pytest.fixture
def seeing_reflector(peer, tracker: LeicaTracker) -> LeicaTracker:
    peer.answers[START] = peer.reply(START) + peer.point()
    return tracker


def stated(p_trk):
    """Give the covariance of the accuracy a rig file need not state: 15 um + 6 um/m."""
    return (15e-6 + 6e-6 * np.linalg.norm(p_trk)) ** 2 * np.eye(3)


def test_point_is_measured_with_the_right_reflector(peer, seeing_reflector: LeicaTracker):
    reading = seeing_reflector.measure_point("top_left", window_s=2.0)
    assert reading.target == "top_left"
    np.testing.assert_array_equal(reading.p_trk_m, peer.p_top_left)
    expected = np.diag([4e-10, 4e-10, 16e-10])
    expected[0, 1] = expected[1, 0] = 1e-10
    expected += stated(peer.p_top_left)
    np.testing.assert_allclose(reading.covariance_m2, expected, rtol=1e-12)
    assert peer.told(SET_MODE, SET_REFLECTOR, GET_REFLECTOR, POINT_LASER, FIND, START) == [
        *(SET_MODE, SET_REFLECTOR, GET_REFLECTOR, POINT_LASER, FIND, START)
    ]
    assert peer.last(SET_REFLECTOR) == struct.pack("<i", 7)
    assert peer.last(SET_STATIONARY) == struct.pack("<iI", 2000, 1)
    assert peer.last(POINT_LASER) == struct.pack("<3d", *peer.p_top_left)


def test_point_with_standard_statistics_has_no_covariances(peer, tracker: LeicaTracker):
    packet = bytearray(156)
    peer.put(packet, 0, "iII", 156, 2, 0)
    peer.put(packet, 20, "3d", *peer.p_top_left)
    peer.put(packet, 44, "3d", 1e-5, 2e-5, 3e-5)
    peer.answers[START] = peer.reply(START) + bytes(packet)
    reading = tracker.measure_point("top_left", window_s=0.5)
    expected = np.diag([1e-10, 4e-10, 9e-10]) + stated(peer.p_top_left)
    np.testing.assert_allclose(reading.covariance_m2, expected)


def test_reflector_that_stays_another_one_is_refused(peer, seeing_reflector: LeicaTracker):
    peer.answers[SET_REFLECTOR] = peer.reply(SET_REFLECTOR)
    peer.reflector = 4
    with pytest.raises(DeviceFaultError, match=r"CCR-1.5in \(id 7\), but id 4 is sel") as fault:
        seeing_reflector.measure_point("top_left", window_s=0.5)
    assert fault.value.code == 23
    assert not peer.told(START)


def test_unknown_reflector_is_refused(peer, tracker: LeicaTracker):
    n = len(peer.requests)
    with pytest.raises(LimitError, match=r"measure_point: no reflector 'left'; .* has: top_left"):
        tracker.measure_point("left", window_s=0.5)
    with pytest.raises(LimitError, match="select_reflector: no reflector of type 'ball'"):
        tracker.select_reflector("ball")
    assert len(peer.requests) == n


def test_reflectors_are_listed(tracker: LeicaTracker):
    assert [(r.id, r.name) for r in tracker.reflectors()] == [(4, "RRR-0.5in"), (7, "CCR-1.5in")]


def test_point_measured_elsewhere_is_another_reflector(peer, tracker: LeicaTracker):
    peer.answers[START] = peer.reply(START) + peer.point((3.0, 2.0, 1.2))
    with pytest.raises(LimitError, match=r"'top_left' measured 0.200 m from .* allowed 0.05 m"):
        tracker.measure_point("top_left", window_s=0.5)


def test_reflector_that_is_not_there_is_lost(peer, seeing_reflector: LeicaTracker):
    peer.mask &= ~2048
    with pytest.raises(TrackingLostError, match=r"measure_point: .* within 0.05 m of \[3.0, 2.0"):
        seeing_reflector.measure_point("top_left", window_s=0.5)


def test_second_measurement_points_where_the_first_one_was(peer, seeing_reflector: LeicaTracker):
    measured = (3.01, 2.0, 1.0)
    peer.answers[START] = peer.reply(START) + peer.point(measured)
    for _ in range(2):
        seeing_reflector.measure_point("top_left", window_s=0.5)
    assert peer.last(POINT_LASER) == struct.pack("<3d", *measured)


def test_beam_goes_back_to_a_tmac_it_was_on_before_anyone_measured_it(peer, tracker: LeicaTracker):
    """An earlier session left it there, and the robot need not be at home: the head knows."""
    tracker.follow_target()
    peer.mask &= ~128
    peer.answers[START] = peer.reply(START) + peer.point()
    peer.requests.clear()
    tracker.measure_point("top_left", window_s=0.5)
    moves = peer.told(SET_MODE, POINT_LASER, POINT_LASER_HVD)
    assert moves == [SET_MODE, POINT_LASER, SET_MODE, POINT_LASER_HVD]
    assert peer.last(SET_MODE) == struct.pack("<I", 6)
    assert peer.last(POINT_LASER_HVD)[:16] == struct.pack("<2d", 0.25, 1.5)


def test_beam_goes_back_to_the_tmac_when_a_reflector_is_not_found(peer, tracker: LeicaTracker):
    """Else the robot would move on without it."""
    tracker.follow_target()
    peer.mask &= ~128
    peer.answers[FIND] = lambda _: peer.reply(
        FIND, status=701 if peer.last(SET_MODE)[0] == 0 else 0
    )
    with pytest.raises(TrackingLostError, match=r"nothing found within 0.05 m of \[3.0, 2.0"):
        tracker.measure_point("top_left", window_s=0.5)
    assert peer.last(SET_MODE) == struct.pack("<I", 6)
    assert peer.last(POINT_LASER_HVD)[:16] == struct.pack("<2d", 0.25, 1.5)


def test_tmac_that_has_gone_does_not_spoil_a_point(peer, tracker: LeicaTracker):
    tracker.follow_target()
    peer.mask &= ~128
    peer.answers[START] = peer.reply(START) + peer.point()
    peer.answers[FIND] = lambda _: peer.reply(
        FIND, status=701 if peer.last(SET_MODE)[0] == 6 else 0
    )
    assert tracker.measure_point("top_left", window_s=0.5).target == "top_left"
    with pytest.raises(TrackingLostError):
        tracker.follow_target()


def change_faces(peer, *, offset_m: float, turns: bool = True) -> None:
    def change(_: bytes) -> bytes:
        peer.face = 3 - peer.face if turns else peer.face
        return peer.reply(CHANGE_FACE)

    def measure(_: bytes) -> bytes:
        shift = offset_m if peer.face == 2 else 0.0
        return peer.reply(START) + peer.point((3.0, 2.0, 1.0 + shift))

    peer.answers |= {CHANGE_FACE: change, START: measure}


@pytest.mark.parametrize(("offset_m", "is_good"), [(20e-6, True), (200e-6, False)])
def test_two_faces_are_compared_across_the_beam(
    peer, tracker: LeicaTracker, offset_m: float, is_good: bool
):
    change_faces(peer, offset_m=offset_m)
    check = tracker.two_face_check("top_left", window_s=0.5)
    length_m = np.linalg.norm(peer.p_top_left)
    across = offset_m * np.hypot(3.0, 2.0) / length_m
    assert check.difference_m == pytest.approx(across, rel=1e-3)
    assert check.allowed_m == pytest.approx(30e-6 + 12e-6 * length_m, rel=1e-3)
    assert check.is_good is is_good
    assert peer.face == 1


def test_distance_has_no_faces(peer, tracker: LeicaTracker):
    change_faces(peer, offset_m=0.0)
    longer = 1.001 * np.array(peer.p_top_left)
    peer.answers[START] = lambda _: (
        peer.reply(START) + peer.point(longer if peer.face == 2 else peer.p_top_left)
    )
    assert tracker.two_face_check("top_left").difference_m == pytest.approx(0.0, abs=1e-9)


def test_face_is_changed_back_when_the_second_measurement_fails(peer, tracker: LeicaTracker):
    change_faces(peer, offset_m=0.0)
    peer.answers[START] = lambda _: (
        peer.reply(START, status=93) if peer.face == 2 else peer.reply(START) + peer.point()
    )
    with pytest.raises(TrackingLostError, match="two_face_check"):
        tracker.two_face_check("top_left")
    assert peer.face == 1


def test_head_that_does_not_turn_over_is_an_error(peer, tracker: LeicaTracker):
    change_faces(peer, offset_m=0.0, turns=False)
    with pytest.raises(DeviceFaultError, match="did not turn over"):
        tracker.two_face_check("top_left")


def test_drift_of_the_home_reflector(peer, tracker: LeicaTracker):
    peer.answers[CHECK_BIRDBATH] = peer.reply(
        CHECK_BIRDBATH, struct.pack("<6d", 1.0, 2.0, 3.0, 4e-6, -5e-6, 6e-6)
    )
    drift = tracker.drift_check()
    assert (drift.hz_rad, drift.vt_rad, drift.distance_m) == (4e-6, -5e-6, 6e-6)


def test_beam_goes_back_to_the_tmac_after_the_drift_check(peer, tracker: LeicaTracker):
    tracker.follow_target()

    def go_home(_: bytes) -> bytes:
        peer.tracker_status = 0
        return peer.reply(CHECK_BIRDBATH, bytes(48))

    def point_laser(body: bytes) -> bytes:
        peer.tracker_status = 2 if body == struct.pack("<3d", *peer.p_tmac) else 0
        return peer.reply(POINT_LASER)

    peer.answers |= {CHECK_BIRDBATH: go_home, POINT_LASER: point_laser}
    tracker.drift_check()
    assert peer.told(POINT_LASER) == [POINT_LASER]
    assert peer.tracker_status == 2
