import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tronlab.trajectory.cone_programme import Flight
from tronlab.trajectory.path_sampling import equally_spaced, path_length_m, points_at

GRAVITY = 1.62


def braking(acceleration: float, duration_s: float, *, sideways: float = 0.0) -> Flight:
    """A fall from rest, thrown sideways, that ends in the origin."""
    time_s = np.linspace(0.0, duration_s, 9)
    net = np.array([sideways, 0.0, acceleration - GRAVITY])
    start_m = -net * duration_s**2 / 2
    return Flight(
        time_s=time_s,
        position_m=start_m + np.outer(time_s**2 / 2, net),
        velocity_m_per_s=np.outer(time_s, net),
        acceleration_m_per_s2=np.tile([sideways, 0.0, acceleration], (9, 1)),
        slack_m_per_s2=np.full(9, acceleration),
        mass_kg=np.full(9, 1000.0),
        velocity_increment_m_per_s=0.0,
        miss_m_per_s=0.0,
        is_accurate=True,
    )


def test_straight_fall_in_closed_form() -> None:
    flight = braking(0.62, 40.0)
    points = equally_spaced(flight, 100.0, gravity_m_per_s2=GRAVITY)
    assert path_length_m(flight, gravity_m_per_s2=GRAVITY) == pytest.approx(800.0)
    np.testing.assert_allclose(points.position_m[:, 2], np.arange(800, -1, -100), atol=1e-2)
    np.testing.assert_allclose(points.time_s, np.sqrt(2 * np.arange(0, 801, 100)), rtol=1e-4)
    np.testing.assert_allclose(points.thrust_direction, np.tile([0, 0, 1], (9, 1)), atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(spacing_m=st.floats(3.0, 400.0), sideways=st.floats(-0.5, 0.5))
def test_points_are_equally_far_apart_and_end_at_the_landing(
    spacing_m: float, sideways: float
) -> None:
    flight = braking(0.5, 40.0, sideways=sideways)
    points = equally_spaced(flight, spacing_m, gravity_m_per_s2=GRAVITY)
    np.testing.assert_allclose(points.position_m[-1], 0.0, atol=1e-6)
    assert np.all(np.diff(points.time_s) > 0)
    # the path is straight: constant force from rest
    apart_m = np.linalg.norm(np.diff(points.position_m, axis=0), axis=1)
    np.testing.assert_allclose(apart_m, spacing_m, rtol=1e-2)
    left_m = np.linalg.norm(points.position_m[0] - flight.position_m[0])
    assert left_m < spacing_m * 1.01


def test_points_between_nodes_follow_a_thrust_that_grows() -> None:
    """With thrust linear in time, position is a cubic: integrated here in many small steps."""
    flight = braking(1.0, 8.0)
    u0, u1 = flight.acceleration_m_per_s2[0], np.array([0.3, 0.1, 2.0])
    flight.acceleration_m_per_s2[1] = u1
    n = 20_000
    step_s = flight.time_s[1] / n
    u = u0 + (u1 - u0) * ((np.arange(n) + 0.5) / n)[:, None]
    velocity = np.cumsum((u - [0, 0, GRAVITY]) * step_s, axis=0)
    moved_m = np.sum(velocity * step_s, axis=0)
    end = points_at(flight, np.array([flight.time_s[1] - 1e-9]), gravity_m_per_s2=GRAVITY)
    np.testing.assert_allclose(end.position_m[0] - flight.position_m[0], moved_m, atol=1e-4)
    np.testing.assert_allclose(end.thrust_direction[0], u1 / np.linalg.norm(u1), atol=1e-6)
