"""Measuring a T-MAC that a scripted peer plays; initialising before that."""

import struct
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.leica.driver import LeicaTracker
from tronlab.errors import (
    DeviceFaultError,
    LimitError,
    NotReadyError,
    ProtocolError,
    TrackingLostError,
)

START = 49
POINT_LASER = 58
FIND = 63
SYSTEM_STATUS = 1
INITIALIZE = 7
SET_MODE = 24
SET_STATIONARY = 28
SET_SEARCH = 43
PROBE_INFO = 119


def test_pose_is_rotation_of_the_probe_in_the_tracker(peer, tracker: LeicaTracker):
    before_s = time.time()
    reading = tracker.measure_pose(window_s=0.1)
    assert before_s <= reading.time_s <= time.time()
    np.testing.assert_array_equal(reading.trk_from_tmac.translation, peer.p_tmac)
    w, x, y, z = peer.quaternion_wxyz
    expected = Rotation.from_quat([x, y, z, w]).as_matrix()
    np.testing.assert_allclose(reading.trk_from_tmac.rotation.as_matrix(), expected, atol=1e-12)
    assert reading.air is not None
    assert reading.air.temperature_k == pytest.approx(294.15)
    assert peer.last(SET_STATIONARY) == struct.pack("<iI", 100, 1)
    assert peer.last(SET_MODE) == struct.pack("<I", 6)


def test_covariance_of_a_pose_is_rotation_first_and_has_the_stated_accuracy(make, peer):
    scatter = np.diag([1e-8, 4e-8, 9e-8, 4e-10, 4e-10, 16e-10])
    scatter[1, 2] = scatter[2, 1] = 1e-9
    scatter[3, 4] = scatter[4, 3] = 1e-10
    accuracy = {"coordinate_sigma_m": 1e-5, "coordinate_sigma_m_per_m": 2e-5}
    tracker = make(accuracy={**accuracy, "rotation_sigma_deg": 0.02})
    tracker.connect()
    covariance = tracker.measure_pose(window_s=0.1).covariance
    sigma_m = 1e-5 + 2e-5 * np.sqrt(sum(p**2 for p in peer.p_tmac))
    stated = np.repeat([np.radians(0.02) ** 2 / 3, sigma_m**2], 3)
    np.testing.assert_allclose(covariance, scatter + np.diag(stated), rtol=1e-12)


def test_head_stands_still_while_the_tmac_is_seen(peer, tracker: LeicaTracker):
    for _ in range(3):
        tracker.measure_pose(window_s=0.1)
    assert not peer.told(POINT_LASER, FIND, INITIALIZE)
    assert len(peer.told(SET_MODE)) == 1


def test_unseen_tmac_is_searched_at_home(peer, tracker: LeicaTracker):
    peer.locks_when_searched(128)
    tracker.measure_pose(window_s=0.1)
    assert peer.last(POINT_LASER) == struct.pack("<3d", *peer.p_tmac)
    radius_m, timeout_ms = struct.unpack("<di", peer.last(SET_SEARCH))
    assert (radius_m, timeout_ms) == (0.3, 300)
    (distance_m,) = struct.unpack("<d", peer.last(FIND))
    assert distance_m == pytest.approx(np.linalg.norm(peer.p_tmac))


def test_tmac_that_is_nowhere_is_lost(peer, tracker: LeicaTracker):
    peer.tracker_status = 0
    peer.answers[FIND] = peer.reply(FIND, status=701)
    with pytest.raises(TrackingLostError, match=r"measure_pose: no T-MAC: .*the beam is broken"):
        tracker.measure_pose(window_s=0.1)
    assert not peer.told(START)


def test_beam_that_finds_a_target_without_t_mac_misses_the_probe(peer, tracker: LeicaTracker):
    peer.mask &= ~128
    peer.answers[PROBE_INFO] = peer.reply(PROBE_INFO, status=75)
    with pytest.raises(DeviceFaultError, match=r"GetMeasurementProbeInfo: probe mis") as fault:
        tracker.measure_pose(window_s=0.1)
    assert fault.value.code == 75
    assert peer.told(FIND) == [FIND]


def test_missing_measurement_camera_is_named(peer, tracker: LeicaTracker):
    peer.mask &= ~(128 | 16)
    with pytest.raises(DeviceFaultError, match="no measurement camera") as fault:
        tracker.measure_pose(window_s=0.1)
    assert fault.value.code == 67


def test_another_probe_is_no_tmac(peer, tracker: LeicaTracker):
    peer.answers[PROBE_INFO] = peer.reply(
        PROBE_INFO, struct.pack("<iiiI10i", 1, 7, 9, 2, *[0] * 10)
    )
    with pytest.raises(DeviceFaultError, match=r"measure_pose: probe missing: .*type 2"):
        tracker.measure_pose(window_s=0.1)


def test_identify_target_names_the_tmac(tracker: LeicaTracker):
    identity = tracker.identify_target()
    assert (identity.maker, identity.model) == ("Leica", "T-MAC front")
    assert (identity.serial, identity.firmware) == ("877", "1.7")


@pytest.mark.parametrize(
    ("bits", "text"),
    [
        (0b1_0000_0101, "too few LEDs"),
        (0b0000_1001, "residual too high"),
        (0b0000_0011, "error"),
        (0b0110_0001, "values frozen, distance out of range"),
        (0b0000_0000, "no 6-D status"),
    ],
)
def test_undetermined_rotation_is_refused(peer, tracker: LeicaTracker, bits: int, text: str):
    peer.answers[START] = peer.reply(START) + peer.pose(rotation_status=bits)
    with pytest.raises(TrackingLostError, match=text):
        tracker.measure_pose(window_s=0.1)


def test_harmless_rotation_bits_are_accepted(peer, tracker: LeicaTracker):
    peer.answers[START] = peer.reply(START) + peer.pose(rotation_status=0b1_1111_1111_1000_0001)
    tracker.measure_pose(window_s=0.1)


@pytest.mark.parametrize(
    ("result", "text"),
    [
        (lambda peer: peer.pose(q=(0.5, 0.5, 0.5, 0.6)), "norm"),
        (lambda peer: peer.pose(q=(float("nan"), 0, 0, 1)), "no tracker measures"),
        (lambda peer: peer.pose((float("inf"), 0, 0)), "no tracker measures"),
        (lambda peer: peer.pose(std=0.0), "covariance of position is not positive"),
        (lambda peer: peer.point(), "type 9, expected 4"),
    ],
)
def test_pose_that_makes_no_sense_is_a_protocol_error(
    peer, tracker: LeicaTracker, result: Callable[[Any], bytes], text: str
):
    peer.answers[START] = peer.reply(START) + result(peer)
    with pytest.raises(ProtocolError, match=rf"measure_pose: .*{text}") as problem:
        tracker.measure_pose(window_s=0.1)
    assert problem.value.received == result(peer)
    assert problem.value.sent == bytes.fromhex("0c000000 00000000 31000000")


@pytest.mark.parametrize("window_s", [0.0, 0.0999, 100.1, -1.0, float("nan")])
def test_window_out_of_range_is_refused_before_anything_is_sent(
    peer, tracker: LeicaTracker, window_s: float
):
    n = len(peer.requests)
    with pytest.raises(LimitError, match=r"measure_pose: window .* allowed 0.1 to 100 s"):
        tracker.measure_pose(window_s=window_s)
    assert len(peer.requests) == n


def not_initialised(peer) -> None:
    processor = [4]

    def initialise(_: bytes) -> bytes:
        processor[0] = 5
        return peer.reply(INITIALIZE)

    peer.answers |= {
        SYSTEM_STATUS: lambda _: peer.reply(
            SYSTEM_STATUS,
            struct.pack("<IIIIiiiIii", 0, processor[0], 3, 2, 3, 6, 412, 2, 0, 2345),
        ),
        INITIALIZE: initialise,
    }


def test_first_measurement_initialises_once(peer, make):
    not_initialised(peer)
    tracker = make()
    tracker.connect()
    assert not peer.told(INITIALIZE)
    tracker.measure_pose(window_s=0.1)
    tracker.measure_pose(window_s=0.1)
    assert peer.told(INITIALIZE) == [INITIALIZE]


def test_initialising_can_be_forbidden(peer, make):
    not_initialised(peer)
    tracker = make(initialize="never")
    tracker.connect()
    with pytest.raises(NotReadyError, match=r"not initialised; call initialize\(\)") as refusal:
        tracker.measure_pose(window_s=0.1)
    assert refusal.value.code == 39
    tracker.initialize()
    tracker.measure_pose(window_s=0.1)


def test_tracker_that_forgot_its_initialisation_gets_it_again(peer, tracker: LeicaTracker):
    tracker.measure_pose(window_s=0.1)
    not_initialised(peer)
    peer.answers[START] = peer.reply(START, status=39)
    with pytest.raises(NotReadyError):
        tracker.measure_pose(window_s=0.1)
    peer.answers[START] = peer.reply(START) + peer.pose()
    tracker.measure_pose(window_s=0.1)
    assert peer.told(INITIALIZE) == [INITIALIZE]


def test_initialise_has_a_time_limit_of_its_own(peer, make):
    tracker = make(timeout_s=0.2)
    tracker.connect()

    def slow(_: bytes) -> bytes:
        time.sleep(0.4)
        return peer.reply(INITIALIZE)

    peer.answers[INITIALIZE] = slow
    tracker.initialize()
    assert peer.told(INITIALIZE)
