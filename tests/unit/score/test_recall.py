"""Recall at joint thresholds, and intervals of shares."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tronlab.errors import ScoreError
from tronlab.score.evaluation.recall import Threshold, parse_threshold, recall, wilson_interval


@pytest.mark.parametrize(
    ("n_hits", "n", "low", "high"),
    # R. G. Newcombe, Two-sided confidence intervals for the single proportion, Statistics in
    # Medicine 17 (1998) 857, table I, method 3.
    [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_intervals_are_those_that_newcombe_published(n_hits, n, low, high):
    interval = wilson_interval(n_hits / n, n)
    assert (interval.low, interval.high) == pytest.approx((low, high), abs=5e-5)


@given(st.integers(0, 200), st.integers(1, 200))
def test_ends_are_where_the_score_test_just_rejects(n_hits, n):
    share = min(n_hits, n) / n
    interval = wilson_interval(share, n)
    assert 0.0 <= interval.low <= share <= interval.high <= 1.0
    z = stats.norm.ppf(0.975)
    for p in (interval.low, interval.high):
        if 0.0 < p < 1.0:
            assert abs(share - p) == pytest.approx(z * np.sqrt(p * (1 - p) / n), rel=1e-6)


def test_it_holds_a_share_as_often_as_stated_on_average():
    n = 61
    intervals = [wilson_interval(k / n, n) for k in range(n + 1)]
    shares = np.linspace(0.02, 0.98, 97)
    held = [
        sum(
            float(stats.binom.pmf(k, n, p))
            for k, interval in enumerate(intervals)
            if interval.low <= p <= interval.high
        )
        for p in shares
    ]
    assert np.mean(held) == pytest.approx(0.95, abs=0.005)
    assert min(held) > 0.85


def test_both_errors_must_be_within_and_shots_without_a_pose_are_within_none():
    rows = pd.DataFrame(
        {
            "shot_id": range(5),
            "status": ["ok", "ok", "ok", "no_pose", "timeout"],
            "position_error_pct_los": [0.1, 0.1, 3.0, np.nan, 0.0],
            "rotation_error_deg": [0.1, 9.0, 0.1, np.nan, 0.0],
        }
    )
    shares = recall(rows, [Threshold(0.1, 0.1), Threshold(3.0, 10.0)])
    assert [(share.n_hits, share.n) for share in shares] == [(1, 5), (3, 5)]
    assert shares[0].interval == wilson_interval(0.2, 5)
    # A repeat of each shot is no further shot.
    repeated = recall(pd.concat([rows, rows]), [Threshold(0.1, 0.1)])[0]
    assert (repeated.n_hits, repeated.n, repeated.interval) == (2, 10, shares[0].interval)
    nothing = recall(rows.iloc[:0], [Threshold(1.0, 1.0)])[0]
    assert np.isnan(nothing.value)
    assert (nothing.interval.low, nothing.interval.high) == (0.0, 1.0)


def test_thresholds_are_read_or_refused():
    assert parse_threshold("0.1, 0.05") == Threshold(0.1, 0.05)
    for odd in ("1", "1,2,3", "a,b", "-1,1", "1,nan", "1,inf"):
        with pytest.raises(ScoreError, match=r"as 0\.1,0\.05"):
            parse_threshold(odd)
