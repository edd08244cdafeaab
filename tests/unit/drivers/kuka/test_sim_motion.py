"""Profiles and paths of the simulated controller."""

import numpy as np
import pytest

from drivers.kuka.simulator.command import Refused
from drivers.kuka.simulator.machine import HOME, KR16, flange_of
from drivers.kuka.simulator.motion import (
    AxisPath,
    Brake,
    LinePath,
    Trapezoid,
    axis_path,
    axis_profile,
    line_profile,
)

DOWN_MM = np.array([0.0, 0.0, -0.1])


def shifted(metres):
    from scipy.spatial.transform import RigidTransform

    return RigidTransform.from_translation(metres) * flange_of(HOME)


@pytest.mark.parametrize(
    "profile", [Trapezoid(0.5, 2.0), Trapezoid(10.0, 2.0)], ids=["full speed", "short"]
)
def test_progress_is_the_integral_of_its_speed(profile):
    times = np.linspace(0.0, profile.duration_s, 4001)
    progress, speed = np.array([profile.at(t) for t in times]).T
    assert (progress[0], speed[0]) == (0.0, 0.0)
    assert (progress[-1], speed[-1]) == (1.0, 0.0)
    assert speed.max() <= profile.speed + 1e-12
    assert np.abs(np.diff(speed)).max() <= profile.acceleration * times[1] + 1e-9
    assert np.trapezoid(speed, times) == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(np.gradient(progress, times)[1:-1], speed[1:-1], atol=1e-3)


def test_braking_stops_on_the_way_and_at_once():
    whole = Trapezoid(0.5, 2.0)
    progress, speed = whole.at(1.0)
    brake = Brake(progress, speed, whole.acceleration)
    assert brake.at(0.0) == (progress, speed)
    end, end_speed = brake.at(brake.duration_s + 1.0)
    assert end_speed == pytest.approx(0.0)
    assert end == pytest.approx(progress + speed**2 / (2 * whole.acceleration))
    assert end < 1.0


def test_slowest_axis_sets_the_time_and_no_axis_exceeds_its_speed():
    end = HOME + np.array([10.0, 0.0, -5.0, 0.0, 0.0, 60.0, 400.0])
    path = axis_path(HOME, end)
    profile = axis_profile(path, KR16, speed=0.5, ramp=1.0)
    steps = np.linspace(0.0, profile.duration_s, 500)
    axes = np.array([path.at(profile.at(t)[0]) for t in steps])
    speeds = np.abs(np.gradient(axes, steps, axis=0)).max(axis=0)
    assert (speeds <= 0.5 * KR16.speeds * (1 + 1e-6)).all()
    assert (speeds / KR16.speeds)[6] == pytest.approx(
        min(0.5, np.sqrt(0.4 * 0.5) / 1.0), rel=0.02
    )  # the rail is the slowest here
    np.testing.assert_array_equal(axes[-1], end)


def test_a_faster_robot_does_every_move_in_so_much_less_time():
    start, end = np.zeros(7), np.array([30.0, -20.0, 50.0, 5.0, 90.0, 10.0, 1500.0])
    for path_end in (end, end * [1, 1, 1, 1, 1, 1, 0]):
        path = AxisPath(start, path_end)
        times_s = [
            axis_profile(path, machine, speed=0.7, ramp=0.4).duration_s
            for machine in (KR16, KR16.faster(20.0))
        ]
        assert times_s[0] == pytest.approx(20.0 * times_s[1], rel=1e-9)


def test_rail_that_is_where_it_shall_be_does_not_move_at_all():
    end = HOME + np.array([1.0, 0, 0, 0, 0, 0, 1e-9])
    assert axis_path(HOME, end).at(1.0)[6] == HOME[6]


def test_motion_to_where_the_robot_stands_takes_no_time_to_speak_of():
    assert axis_profile(AxisPath(HOME, HOME), KR16, speed=0.1, ramp=0.1).duration_s < 0.01


def test_line_is_straight_and_keeps_the_flange_turned_as_it_was():
    goal = shifted([0.05, -0.2, 0.1])
    path = LinePath(HOME, goal, 40.0, KR16)
    start = flange_of(HOME).translation
    along = (goal.translation - start) / np.linalg.norm(goal.translation - start)
    for progress in np.linspace(0.0, 1.0, 23):
        axes = path.at(progress)
        pose = flange_of(axes)
        off = pose.translation - start
        assert np.linalg.norm(off - (off @ along) * along) < 1e-9
        assert (pose.rotation.inv() * goal.rotation).magnitude() < 1e-9
        assert axes[6] == pytest.approx(40.0 * progress)
    np.testing.assert_allclose(flange_of(path.at(1.0)).as_matrix(), goal.as_matrix(), atol=1e-9)


def test_line_is_no_faster_than_path_speed_and_axes_allow():
    path = LinePath(HOME, shifted([0.0, -0.3, 0.0]), 0.0, KR16)
    profile = line_profile(path, KR16, speed=1.0, ramp=1.0)
    times = np.linspace(0.0, profile.duration_s, 300)
    axes = np.array([path.at(profile.at(t)[0]) for t in times])
    speeds = np.abs(np.gradient(axes, times, axis=0)).max(axis=0)
    assert (speeds <= KR16.speeds * 1.01).all()
    assert path.length_mm * profile.speed <= KR16.path_speed_mm_per_s * (1 + 1e-9)


def test_line_out_of_reach_is_refused_before_it_is_begun():
    with pytest.raises(Refused):
        LinePath(HOME, shifted([2.0, 0.0, 0.0]), 0.0, KR16)
