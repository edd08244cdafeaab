"""Durations of synchronous motions against what mechanics says."""

import numpy as np
import pytest

from tronlab.kinematics.ptp import ptp_duration_s

ONE = np.ones(1)


def duration_s(*travel: float, speed=(1.0, 2.0), acceleration=(1.0, 1.0)) -> float:
    return ptp_duration_s(
        np.array(travel), speed=np.array(speed), acceleration=np.array(acceleration)
    )


def test_long_way_is_speed_up_go_on_slow_down():
    # v / a = 1 s of speeding up over 0.5, as much to slow down, 9 between at 1 a second.
    assert duration_s(10.0, 0.0) == pytest.approx(1.0 + 9.0 + 1.0)


def test_short_way_never_reaches_full_speed():
    # Half the way at acceleration 1: t = sqrt(2 * 0.125), twice.
    assert duration_s(0.25, 0.0) == pytest.approx(2 * np.sqrt(0.25))


def test_slowest_axis_sets_the_time_whichever_way_axes_turn():
    alone_s = duration_s(0.0, 30.0)
    assert duration_s(-1.0, -30.0) == pytest.approx(alone_s)
    assert duration_s(10.0, -1.0) == pytest.approx(duration_s(10.0, 0.0))


def test_who_stays_takes_no_time():
    assert duration_s(0.0, 0.0) == 0.0


def test_there_and_back_take_as_long():
    assert duration_s(0.3, -0.7) == duration_s(-0.3, 0.7)
