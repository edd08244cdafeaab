"""Streams of poses from a scripted peer."""

import itertools
import struct

import numpy as np
import pytest

from drivers.leica.driver import LeicaTracker
from tronlab.errors import (
    DeviceError,
    DeviceTimeoutError,
    LimitError,
    TrackingLostError,
)

START = 49
STOP = 52
SET_MODE = 24
SET_CONTINUOUS = 30


def test_stream_gives_as_many_poses_as_asked_for(peer, tracker: LeicaTracker):
    peer.answers[START] = (
        peer.reply(START)
        + peer.stream([peer.p_tmac, peer.p_tmac])
        + peer.event(25)
        + peer.stream([(1.0, 2.0, 3.0)])
        + peer.event(28)
    )
    readings = list(tracker.stream_poses(interval_s=0.02, n=3))
    assert [r.tracker_time_s for r in readings] == pytest.approx([100.0, 100.02, 100.0])
    np.testing.assert_array_equal(readings[-1].trk_from_tmac.translation, [1.0, 2.0, 3.0])
    assert np.linalg.eigvalsh(readings[0].covariance).min() > 0
    assert peer.last(SET_CONTINUOUS) == struct.pack("<iiII", 20, 3, 0, 0)
    assert peer.last(SET_MODE) == struct.pack("<I", 7)
    assert peer.told(STOP) == [STOP]


def test_endless_stream_ends_when_it_is_closed(peer, tracker: LeicaTracker):
    peer.answers[START] = peer.reply(START) + peer.stream([peer.p_tmac] * 5)
    poses = tracker.stream_poses(interval_s=0.02)
    first = list(itertools.islice(poses, 4))
    assert len(first) == 4
    with pytest.raises(DeviceError, match="measure_pose: stream_poses is running"):
        tracker.measure_pose(window_s=0.1)
    poses.close()
    assert peer.told(STOP) == [STOP]
    peer.answers[START] = peer.reply(START) + peer.pose()
    tracker.measure_pose(window_s=0.1)


def test_stream_whose_beam_breaks_is_lost(peer, tracker: LeicaTracker):
    peer.answers[START] = peer.reply(START) + peer.stream([peer.p_tmac]) + peer.error(64, 701)
    poses = tracker.stream_poses(interval_s=0.02)
    with pytest.raises(TrackingLostError, match="stream_poses: the beam is broken"):
        list(poses)


def test_stop_ends_a_stream_and_lets_the_next_measurement_begin(peer, tracker: LeicaTracker):
    peer.answers[START] = peer.reply(START) + peer.stream([peer.p_tmac])
    poses = tracker.stream_poses(interval_s=0.02)
    next(poses)
    tracker.stop()
    with pytest.raises(DeviceError, match=r"stream_poses: stopped by stop\(\)"):
        next(poses)
    peer.answers[START] = peer.reply(START) + peer.pose()
    tracker.measure_pose(window_s=0.1)


def test_stream_with_a_bad_pose_is_lost(peer, tracker: LeicaTracker):
    peer.answers[START] = peer.reply(START) + peer.stream([peer.p_tmac], point_status=3)
    with pytest.raises(TrackingLostError, match="point status 3"):
        next(tracker.stream_poses(interval_s=0.02))


def test_stream_that_dries_up_times_out(peer, tracker: LeicaTracker):
    peer.answers[START] = peer.reply(START) + peer.stream([peer.p_tmac])
    with pytest.raises(DeviceTimeoutError, match="stream_poses"):
        list(tracker.stream_poses(interval_s=0.02))


@pytest.mark.parametrize(
    ("interval_s", "n"), [(0.0, 1), (0.0005, 1), (0.0015, 1), (200, 1), (1, -1), (1, 2**31)]
)
def test_stream_that_cannot_be_is_refused(tracker: LeicaTracker, interval_s: float, n: int):
    with pytest.raises(LimitError, match=r"stream_poses: .*allowed"):
        tracker.stream_poses(interval_s=interval_s, n=n)
