"""Nearest time stamps, against looking at every pair."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tronlab.dataset.exchange.association import associate
from tronlab.errors import DatasetError

times = st.lists(st.integers(0, 60), max_size=12).map(lambda t: np.array(t, dtype=np.float64))


@settings(max_examples=50)
@given(times, times, st.integers(0, 5), st.integers(-4, 4))
def test_each_time_takes_the_nearest(a: np.ndarray, b: np.ndarray, limit: int, offset: int) -> None:
    pairs = associate(a, b, max_difference_s=limit, offset_b_s=offset)
    near = [i for i, t in enumerate(a) if b.size and np.abs(b + offset - t).min() <= limit]
    assert pairs.i_a.tolist() == near
    for i, j, difference in zip(pairs.i_a, pairs.i_b, pairs.difference_s, strict=True):
        assert difference == b[j] + offset - a[i]
        assert abs(difference) == np.abs(b + offset - a[i]).min()


def test_the_earlier_of_two_equally_near_counts() -> None:
    assert associate([2.0], [3.0, 1.0], max_difference_s=1.0).difference_s.tolist() == [-1.0]


def test_times_and_limits_that_cannot_be() -> None:
    with pytest.raises(DatasetError, match="not finite"):
        associate([np.nan], [1.0], max_difference_s=1.0)
    with pytest.raises(DatasetError, match="largest difference is -1 s"):
        associate([1.0], [1.0], max_difference_s=-1)
