"""Minimum-fuel powered descent by lossless convexification, with free flight time.

Acikmese and Ploen (JGCD 30(5), 2007, "Convex programming approach to powered descent guidance for
Mars landing") replace thrust and mass by the acceleration u = T/m and z = ln m, and the thrust's
magnitude by a slack s >= |u|. The set of u becomes convex, and the optimum still has s = |u|; so
it has with the thrust's direction limited (Acikmese, Carson and Blackmore, IEEE TCST 21(6), 2013).
For a fixed flight time that is a second-order cone programme, ``cone_programme``.

The flight time is found by a line search. Landing counts as an exact penalty there: where no
landing is possible in the time, the cost grows with what is missed, so that the search has a slope
to follow wherever it begins (after the minimum landing error of Blackmore, Acikmese and Scharf,
JGCD 33(4), 2010).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tronlab.geometry.poses import FloatArray
from tronlab.trajectory.cone_programme import Flight, solve_fixed_time
from tronlab.trajectory.config import DescentStart, Lander

LANDED_M_PER_S = 1e-5
"""A smaller miss is rounding: 1 mm and 0.01 mm/s at full scale after 100 s."""


@dataclass(frozen=True, slots=True)
class _Accuracy:
    """How closely the flight time is sought."""

    n_steps: int
    tolerance: float
    """Relative accuracy of the flight time."""


_COARSE = _Accuracy(n_steps=40, tolerance=2e-2)
_FINE = _Accuracy(n_steps=80, tolerance=2e-4)
"""With twice as many steps the fuel of the paper's descent changes by less than 0.01 %."""
_AROUND = 1.06
"""The fine search looks so far around the coarse one's flight time, as a ratio."""
_SHORTEST_S = 1.0
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


@lru_cache(maxsize=4096)
def land(start: DescentStart, lander: Lander) -> Flight | None:
    """Find the descent of least fuel to a landing at rest in the origin.

    Args:
        start: Where it begins.
        lander: What it may do.

    Returns:
        The descent; None if there is none within the lander's limits.

    Raises:
        ConfigError: Clarabel is not installed.
    """
    all_times_s = _SHORTEST_S, _burn_time_s(lander)
    coarse = _search(start, lander, _COARSE, all_times_s)
    if coarse is None:
        return None
    around_s = coarse.time_s[-1] / _AROUND, min(coarse.time_s[-1] * _AROUND, all_times_s[1])
    fine = _search(start, lander, _FINE, around_s, before=coarse)
    if fine is None:
        return _search(start, lander, _FINE, all_times_s, before=coarse)
    return fine


@lru_cache(maxsize=4096)
def limits_in_the_way(start: DescentStart, lander: Lander) -> tuple[str, ...]:
    """Name the limits without which a lander could land that cannot.

    Each limit is taken away alone; where only several together would do, there is none.

    Args:
        start: A start for which ``land`` gives None.
        lander: What it may do.

    Returns:
        Keys of the lander with their values, as ``max_tilt_deg 10``.
    """
    least_n, greatest_n = lander.thrust_n
    without = {
        f"max_tilt_deg {lander.max_tilt_deg:g}": {"max_tilt_deg": 89.0},
        f"min_glide_slope_deg {lander.min_glide_slope_deg:g}": {"min_glide_slope_deg": 0.0},
        f"thrust_n[0] {least_n:g}": {"thrust_n": (0.01 * least_n, greatest_n)},
        f"thrust_n[1] {greatest_n:g}": {"thrust_n": (least_n, 10 * greatest_n)},
        f"dry_mass_kg {lander.dry_mass_kg:g}": {"dry_mass_kg": 0.1 * lander.dry_mass_kg},
    }
    return tuple(
        limit
        for limit, changes in without.items()
        if _can_land(start, lander.model_copy(update=changes))
    )


def _can_land(start: DescentStart, lander: Lander) -> bool:
    return _search(start, lander, _COARSE, (_SHORTEST_S, _burn_time_s(lander))) is not None


def _search(
    start: DescentStart,
    lander: Lander,
    accuracy: _Accuracy,
    range_s: tuple[float, float],
    *,
    before: Flight | None = None,
) -> Flight | None:
    """Find the best flight time within a range; None where the lander lands in none of those tried.

    The masses of the descent before are the reference about which thrust limits are linear.
    """
    landings: list[Flight] = []

    def cost(log_time: float) -> float:
        time_s = math.exp(log_time)
        reference_kg = _reference_kg(lander, time_s, accuracy.n_steps, before)
        flight = solve_fixed_time(start, lander, time_s, reference_kg=reference_kg)
        if flight is None:
            return math.inf
        if flight.is_accurate and flight.miss_m_per_s <= LANDED_M_PER_S:
            landings.append(flight)
        return flight.cost_m_per_s

    _minimise(cost, *(math.log(time_s) for time_s in range_s), tolerance=accuracy.tolerance)
    return min(landings, key=lambda flight: flight.cost_m_per_s, default=None)


def _burn_time_s(lander: Lander) -> float:
    """Give how long the fuel lasts at the least thrust."""
    fuel_kg = lander.mass_kg - lander.dry_mass_kg
    return fuel_kg * lander.exhaust_velocity_m_per_s / lander.thrust_n[0]


def _reference_kg(lander: Lander, time_s: float, n_steps: int, before: Flight | None) -> FloatArray:
    """Give the mass expected over time: as in the descent before, else with the greatest thrust."""
    share = np.linspace(0.0, 1.0, n_steps + 1)
    if before is not None:
        return np.interp(share, np.linspace(0.0, 1.0, before.mass_kg.size), before.mass_kg)
    flow_kg_per_s = lander.thrust_n[1] / lander.exhaust_velocity_m_per_s
    return np.maximum(lander.mass_kg - flow_kg_per_s * time_s * share, lander.dry_mass_kg)


def _minimise(cost: Callable[[float], float], low: float, high: float, *, tolerance: float) -> None:
    """Close in by golden sections on the least of a function that has one valley.

    Where it is infinite at both inner points, the valley is below them: no descent keeps to the
    limits for longer than fuel and height last.
    """
    left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    cost_left, cost_right = cost(left), cost(right)
    while high - low > tolerance:
        if cost_left <= cost_right:
            high, right, cost_right = right, left, cost_left
            left = high - _GOLDEN * (high - low)
            cost_left = cost(left)
        else:
            low, left, cost_left = left, right, cost_right
            right = low + _GOLDEN * (high - low)
            cost_right = cost(right)
