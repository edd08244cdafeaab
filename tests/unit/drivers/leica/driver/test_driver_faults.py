"""Measurements that fail: each error is named, and the next measurement works."""

import struct
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.leica.driver import LeicaTracker
from tronlab.errors import (
    DeviceError,
    DeviceFaultError,
    LimitError,
    NotReadyError,
    TrackingLostError,
)

START = 49
STOP = 52
POINT_LASER = 58
POINT_LASER_HVD = 59
FIND = 63


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (lambda peer: peer.reply(START) + peer.error(64, 701), TrackingLostError),
        (lambda peer: peer.error(64, 701) + peer.reply(START), TrackingLostError),
        (lambda peer: peer.reply(START, status=701), TrackingLostError),
        (lambda peer: peer.error(START, 93), TrackingLostError),
        (lambda peer: peer.reply(START) + peer.error(START, 93), TrackingLostError),
        (lambda peer: peer.reply(START) + peer.pose(status=93), TrackingLostError),
        (lambda peer: peer.reply(START, status=37), TrackingLostError),
        (lambda peer: peer.reply(START) + peer.event(99), TrackingLostError),
        (lambda peer: peer.reply(START, status=10012), NotReadyError),
        (lambda peer: peer.reply(START, status=1), NotReadyError),
        (lambda peer: peer.reply(START) + peer.error(START, 10009), NotReadyError),
        (lambda peer: peer.reply(START, status=75), DeviceFaultError),
        (lambda peer: peer.reply(START, status=31999), DeviceFaultError),
        (lambda peer: peer.reply(START) + peer.error(64, 31999), DeviceFaultError),
        (lambda peer: peer.reply(START, status=12), LimitError),
        (lambda peer: peer.reply(START, status=11), LimitError),
    ],
)
def test_measurement_that_fails_raises_its_error_and_the_next_one_works(
    peer, tracker: LeicaTracker, answer: Callable[[Any], bytes], expected: type[DeviceError]
):
    tracker.measure_pose(window_s=0.1)
    peer.answers[START] = answer(peer)
    with pytest.raises(DeviceError, match=r"^tracker: measure_pose: ") as failure:
        tracker.measure_pose(window_s=0.1)
    assert type(failure.value) is expected
    peer.answers[START] = peer.reply(START) + peer.pose()
    np.testing.assert_array_equal(
        tracker.measure_pose(window_s=0.1).trk_from_tmac.translation, peer.p_tmac
    )
    assert peer.n_clients == 1


@pytest.mark.parametrize("code", [75, 76, 100, 31999])
def test_code_is_carried_through(peer, tracker: LeicaTracker, code: int):
    peer.answers[START] = peer.reply(START, status=code)
    with pytest.raises(DeviceFaultError, match=rf"StartMeasurement: .*code {code}") as fault:
        tracker.measure_pose(window_s=0.1)
    assert fault.value.code == code


def test_measurement_that_an_error_ends_runs_no_longer(peer, tracker: LeicaTracker):
    """An error that answers no command need not have ended it: its result would come later."""
    peer.answers[START] = peer.reply(START) + peer.error(64, 94)
    with pytest.raises(DeviceFaultError, match=r"measure_pose: no temperature .*code 94"):
        tracker.measure_pose(window_s=0.1)
    assert peer.told(START, STOP) == [START, STOP]


def test_search_in_vain_names_every_place_and_what_to_do(peer, tracker: LeicaTracker):
    peer.answers[START] = peer.reply(START) + peer.pose((2.0, 1.0, 0.0))
    tracker.measure_pose(window_s=0.1)
    peer.mask &= ~128
    peer.answers[FIND] = peer.reply(FIND, status=701)
    with pytest.raises(TrackingLostError, match=r"drive it back to one of these places") as lost:
        tracker.measure_pose(window_s=0.1)
    for place in (
        "nothing found where the beam points: ",
        "nothing found within 0.3 m of [2.0, 1.0, 0.0] m: ",
        "nothing found within 0.3 m of [2.5, 0.25, -0.25] m: FindReflector: the beam is broken",
    ):
        assert place in str(lost.value)


def test_lost_beam_is_searched_where_it_points_then_where_it_was_then_at_home(
    peer, tracker: LeicaTracker
):
    away = (2.0, 1.0, 0.0)
    peer.answers[START] = peer.reply(START) + peer.pose(away)
    tracker.measure_pose(window_s=0.1)
    peer.locks_when_searched(128, at=peer.p_tmac)
    peer.requests.clear()
    tracker.measure_pose(window_s=0.1)
    moves = [(c, body) for c, body in peer.requests if c in {POINT_LASER, FIND}]
    assert [c for c, _ in moves] == [FIND, POINT_LASER, FIND, POINT_LASER, FIND]
    assert moves[1][1] == struct.pack("<3d", *away)
    assert moves[3][1] == struct.pack("<3d", *peer.p_tmac)


def test_search_in_vain_is_repeated_where_the_beam_was_lost(peer, tracker: LeicaTracker):
    tracker.measure_pose(window_s=0.1)
    peer.mask &= ~128
    peer.answers[FIND] = peer.reply(FIND, status=701)
    for _ in range(2):
        with pytest.raises(TrackingLostError):
            tracker.measure_pose(window_s=0.1)
        peer.mask &= ~128
    points = peer.told(POINT_LASER, POINT_LASER_HVD)
    assert points == [POINT_LASER, POINT_LASER, POINT_LASER_HVD, POINT_LASER, POINT_LASER]
    hz_rad, vt_rad, distance_m = struct.unpack("<3d", peer.last(POINT_LASER_HVD))
    assert (hz_rad, vt_rad) == (0.25, 1.5)
    assert distance_m == pytest.approx(np.linalg.norm(peer.p_tmac))


def test_beam_broken_while_idle_is_searched_before_the_next_measurement(
    peer, tracker: LeicaTracker
):
    tracker.measure_pose(window_s=0.1)
    peer.say(peer.error(64, 701))
    while not tracker.notices():
        time.sleep(0.01)
    tracker.measure_pose(window_s=0.1)
    assert peer.told(FIND, POINT_LASER) == [FIND]


def test_search_that_fails_with_an_unknown_number_is_carried_through(peer, tracker: LeicaTracker):
    peer.mask &= ~128
    peer.answers[FIND] = peer.reply(FIND, status=733)
    with pytest.raises(DeviceFaultError, match=r"measure_pose: FindReflector: .*733") as fault:
        tracker.measure_pose(window_s=0.1)
    assert fault.value.code == 733


def test_tracker_that_stays_busy_is_not_ready(peer, tracker: LeicaTracker):
    peer.tracker_status = 1
    with pytest.raises(NotReadyError, match="busy") as refusal:
        tracker.measure_pose(window_s=0.1)
    assert refusal.value.code == 1


def test_invalid_pose_status_is_told(peer, tracker: LeicaTracker):
    peer.tracker_status = 3
    with pytest.raises(TrackingLostError, match="6-D values are not valid where the beam points"):
        tracker.measure_pose(window_s=0.1)
    assert not peer.told(POINT_LASER, FIND)


def test_search_that_finds_something_else_goes_on_elsewhere(peer, tracker: LeicaTracker):
    """A target that does not make the tracker ready, though it has its probe, is not the T-MAC."""
    away = (2.0, 1.0, 0.0)
    peer.answers[START] = peer.reply(START) + peer.pose(away)
    tracker.measure_pose(window_s=0.1)
    peer.tracker_status = 0

    def point_laser(body: bytes) -> bytes:
        peer.tracker_status = 2 if body == struct.pack("<3d", *peer.p_tmac) else 0
        return peer.reply(POINT_LASER)

    peer.answers[POINT_LASER] = point_laser
    tracker.follow_target()
    assert peer.told(FIND) == [FIND] * 3
