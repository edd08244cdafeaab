from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tronlab.devices.readings import Posture
from tronlab.planning.order import least_motion, motion_s


def postures_at(places) -> list[Posture]:
    return [Posture(float(x), np.array([y, z, 0.0, 0.0, 0.0, 0.0])) for x, y, z in places]


def slowest_axis_s(a: Posture, b: Posture) -> float:
    return max(abs(b.rail_m - a.rail_m) / 0.5, float(np.abs(b.axes_rad - a.axes_rad).max()))


def uphill_is_slower_s(a: Posture, b: Posture) -> float:
    return slowest_axis_s(a, b) * (2.0 if b.rail_m > a.rail_m else 1.0)


@given(
    st.lists(st.tuples(*[st.integers(0, 5)] * 3), min_size=1, max_size=14),
    st.sampled_from([slowest_axis_s, uphill_is_slower_s]),
)
@settings(max_examples=60, deadline=None)
def test_each_posture_once_and_never_slower_than_the_trajectory(places, duration_s):
    postures = postures_at(places)
    order = least_motion(postures, duration_s)
    assert sorted(order) == list(range(len(postures)))
    found_s = motion_s([postures[i] for i in order], duration_s)
    assert found_s <= motion_s(postures, duration_s)


@pytest.mark.parametrize("seed", range(6))
def test_small_plans_are_within_a_few_percent_of_the_best_of_all_orders(seed):
    postures = postures_at(np.random.default_rng(seed).uniform(0, 1, (7, 3)))
    best_s = min(motion_s(order, slowest_axis_s) for order in permutations(postures))
    order = least_motion(postures, slowest_axis_s)
    assert motion_s([postures[i] for i in order], slowest_axis_s) <= 1.03 * best_s


def test_a_shuffled_grid_is_nearly_walked_line_by_line():
    grid = np.array([[x, y, 0.0] for x in range(15) for y in range(20)], dtype=float)
    postures = postures_at(np.random.default_rng(0).permutation(grid))

    def distance(a: Posture, b: Posture) -> float:
        return float(np.hypot(b.rail_m - a.rail_m, b.axes_rad[0] - a.axes_rad[0]))

    order = least_motion(postures, distance)
    assert motion_s([postures[i] for i in order], distance) < 1.06 * 299  # each leg 1 at the best


def test_equal_postures_keep_their_order():
    assert least_motion(postures_at([(0, 0, 0)] * 5), slowest_axis_s) == (0, 1, 2, 3, 4)
