"""Points of a descent, equally spaced along its path."""

from dataclasses import dataclass

import numpy as np

from tronlab.geometry.poses import FloatArray
from tronlab.trajectory.cone_programme import Flight

_N_CHORDS = 32
"""Chords of the path between two times of the flight: its length is right within 1e-6."""


@dataclass(frozen=True, slots=True)
class PathPoints:
    """Points of a descent at full scale, local vertical frame, in the order they are flown."""

    time_s: FloatArray
    position_m: FloatArray
    """Shape (n, 3)."""
    thrust_direction: FloatArray
    """Unit vectors, shape (n, 3)."""


def path_length_m(flight: Flight, *, gravity_m_per_s2: float) -> float:
    """Give the length of the path."""
    return float(_path(flight, gravity_m_per_s2)[1][-1])


def equally_spaced(flight: Flight, spacing_m: float, *, gravity_m_per_s2: float) -> PathPoints:
    """Give the points at whole multiples of a length of path before the landing.

    Args:
        flight: A descent.
        spacing_m: Length of path between two points.
        gravity_m_per_s2: What bends the path between two times of the flight.
    """
    times_s, lengths_m = _path(flight, gravity_m_per_s2)
    to_go_m = lengths_m[-1] - lengths_m
    n_points = int(to_go_m[0] / spacing_m) + 1
    wanted_m = spacing_m * np.arange(n_points)[::-1]
    return points_at(
        flight,
        np.interp(wanted_m, to_go_m[::-1], times_s[::-1]),
        gravity_m_per_s2=gravity_m_per_s2,
    )


def points_at(flight: Flight, time_s: FloatArray, *, gravity_m_per_s2: float) -> PathPoints:
    """Give the points of a descent at given times.

    Args:
        flight: A descent, whose acceleration by thrust is linear between two of its times.
        time_s: When, within the flight, shape (n,).
        gravity_m_per_s2: Of the body landed on.
    """
    node = np.clip(np.searchsorted(flight.time_s, time_s, side="right") - 1, 0, flight.n_steps - 1)
    since_s = (time_s - flight.time_s[node])[:, None]
    here, there = flight.acceleration_m_per_s2[node], flight.acceleration_m_per_s2[node + 1]
    change = (there - here) / (flight.time_s[1] - flight.time_s[0])
    gravity = np.array([0.0, 0.0, -gravity_m_per_s2])
    thrust = here + change * since_s
    return PathPoints(
        time_s=time_s,
        position_m=flight.position_m[node]
        + flight.velocity_m_per_s[node] * since_s
        + (here + gravity) * since_s**2 / 2
        + change * since_s**3 / 6,
        thrust_direction=thrust / np.linalg.norm(thrust, axis=1, keepdims=True),
    )


def _path(flight: Flight, gravity_m_per_s2: float) -> tuple[FloatArray, FloatArray]:
    """Give times, dense, and the length of path flown until then."""
    times_s = np.linspace(0.0, flight.time_s[-1], _N_CHORDS * flight.n_steps + 1)
    positions_m = points_at(flight, times_s, gravity_m_per_s2=gravity_m_per_s2).position_m
    chords_m = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    return times_s, np.concatenate([[0.0], np.cumsum(chords_m)])
