"""Statistics against numpy, their intervals against theory."""

import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from tronlab.score.evaluation.resampling import MIN_SHOTS, bca_interval, replicates
from tronlab.score.evaluation.statistics import (
    QUANTILES,
    STATISTICS,
    Sample,
    between_seeds,
    estimates,
    statistics,
    summarise,
    weighted_mean,
    weighted_quantiles,
)

SHARES = np.array([0.0, 0.25, 0.5, 0.9, 1.0])


def table(errors, *, core="akaze", seed=0, status="ok"):
    return pd.DataFrame(
        {
            "core": core,
            "shot_id": np.arange(len(errors)),
            "seed": seed,
            "status": status,
            "position_error_pct_los": errors,
            "rotation_error_deg": np.asarray(errors) / 2,
        }
    )


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0, 100), st.integers(0, 4)), min_size=1, max_size=12).filter(
        lambda drawn: any(n for _, n in drawn)
    )
)
def test_drawn_statistics_are_those_of_the_drawn_values(drawn):
    values, counts = (np.array(x, dtype=np.float64) for x in zip(*sorted(drawn), strict=True))
    weights = np.stack([counts, np.ones_like(counts)])
    every = np.repeat(values, counts.astype(int))
    for found, expected in zip(
        weighted_quantiles(values, weights, SHARES), (every, values), strict=True
    ):
        np.testing.assert_allclose(found, np.quantile(expected, SHARES), atol=1e-12)
    np.testing.assert_allclose(
        weighted_mean(values, weights), [every.mean(), values.mean()], atol=1e-12
    )


def test_estimates_are_those_of_numpy(rng):
    values = rng.lognormal(size=200)
    found = estimates(Sample.of([*values, np.nan, np.inf]))
    assert tuple(found) == STATISTICS
    for name, q in QUANTILES.items():
        assert found[name].value == pytest.approx(np.percentile(values, 100 * q))
    assert found["mean"].value == pytest.approx(values.mean())
    assert found["rms"].value == pytest.approx(np.sqrt((values**2).mean()))
    assert (found["max"].value, found["max"].interval) == (values.max(), None)
    assert statistics(values) == {name: found[name].value for name in STATISTICS}
    ids = np.arange(200)
    assert estimates(Sample.of(values, ids)) == estimates(Sample.of(values[::-1], ids[::-1]))
    assert set(statistics([]).values()) == {None}


def test_the_mean_is_held_as_often_as_stated():
    """Norms of Gaussian position errors, which are skewed; the true mean is sigma sqrt(8/pi)."""
    rng, n_trials, n_shots = np.random.default_rng(5), 300, 61
    n_held = 0
    for seed in range(n_trials):
        norms = np.sort(np.linalg.norm(rng.normal(size=(n_shots, 3)), axis=1))
        drawn = replicates(n_shots, lambda w, v=norms: weighted_mean(v, w), seed=seed % 3)
        interval = bca_interval(norms.mean(), drawn, norms - norms.mean())
        n_held += interval.low <= np.sqrt(8.0 / np.pi) <= interval.high
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], n_trials, 0.94)
    assert low <= n_held <= high


def test_the_interval_is_that_of_scipy(rng):
    values = np.sort(rng.lognormal(size=80))
    ours = estimates(Sample.of(values))["mean"].interval
    by_scipy = stats.bootstrap(
        (values,), np.mean, n_resamples=9999, method="BCa", rng=rng
    ).confidence_interval
    width = by_scipy.high - by_scipy.low
    assert ours is not None
    np.testing.assert_allclose([ours.low, ours.high], by_scipy, atol=0.06 * width)


def test_shots_that_differ_widen_what_their_repeats_do_not(rng):
    """With errors that are a shot's own, repeats add nothing: the cluster bootstrap knows."""
    of_shots = rng.lognormal(size=60)
    once = estimates(Sample.of(of_shots))["mean"].interval
    repeated = estimates(Sample.of(np.tile(of_shots, 5), np.tile(np.arange(60), 5)))
    naive = estimates(Sample.of(np.tile(of_shots, 5)))["mean"].interval
    interval = repeated["mean"].interval
    assert once is not None
    assert naive is not None
    assert interval is not None
    np.testing.assert_allclose([interval.low, interval.high], [once.low, once.high], rtol=1e-9)
    assert naive.high - naive.low < 0.6 * (once.high - once.low)


@pytest.mark.parametrize(
    ("n_shots", "bounded"), [(20, {"median", "p75"}), (61, {"median", "p75", "p90"})]
)
def test_few_shots_do_not_bound_high_percentiles(rng, n_shots, bounded):
    found = estimates(Sample.of(rng.lognormal(size=n_shots)))
    upper = {name: found[name].interval.high for name in QUANTILES}
    assert {name for name, high in upper.items() if np.isfinite(high)} == bounded


def test_too_few_shots_have_no_interval_and_equal_ones_a_point():
    few = estimates(Sample.of(np.arange(MIN_SHOTS - 1.0)))
    assert {estimate.interval for estimate in few.values()} == {None}
    same = estimates(Sample.of(np.full(30, 0.5)))
    assert (same["mean"].interval.low, same["mean"].interval.high) == (0.5, 0.5)
    assert np.isnan(estimates(Sample.of([]))["mean"].value)


def test_summary_counts_everything_and_is_json():
    seeds = [table([1.0, 2.0, np.nan, 4.0, 5.0, 6.0], seed=seed) for seed in (0, 1)]
    seeds[1].loc[2, "status"] = seeds[0].loc[2, "status"] = "no_pose"
    seeds[1]["position_error_pct_los"] += 1.0
    blind = table([np.nan] * 3, core="blind", status="error")
    summary = summarise(pd.concat([*seeds, blind]))
    assert list(summary) == ["akaze", "blind"]
    akaze = summary["akaze"]
    counts = [akaze[name] for name in ("n_shots", "n_answers", "n_ok", "seeds")]
    assert counts == [6, 12, 10, [0, 1]]
    assert akaze["position_error_pct_los"]["mean"] == pytest.approx(4.1)
    low, high = akaze["position_error_pct_los"]["intervals"]["mean"]
    assert low < 4.1 < high
    assert akaze["position_error_pct_los"]["intervals"]["p99"][1] is None
    spread = akaze["position_error_pct_los"]["between_seeds"]
    assert spread["mean"] == pytest.approx(np.std([3.6, 4.6], ddof=1))
    assert akaze["rotation_error_deg"]["between_seeds"]["max"] == 0.0
    assert summary["blind"]["position_error_pct_los"]["mean"] is None
    assert summary["blind"]["position_error_pct_los"]["intervals"] == {}
    json.dumps(summary, allow_nan=False)
    one = between_seeds(table([1.0, 2.0]), "rotation_error_deg")
    assert set(one.values()) == {None}
