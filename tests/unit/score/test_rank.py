"""Rank correlations, their intervals and probabilities, against SciPy and what is known."""

import numpy as np
import pytest
from scipy import stats

from tronlab.score.evaluation import rank
from tronlab.score.evaluation.rank import rank_correlation

N = 40


@pytest.fixture
def tied(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    x = np.round(rng.normal(size=N), 1)
    return x, np.round(0.4 * x + rng.normal(size=N), 1)


def test_is_that_of_scipy_with_ties_and_gaps(tied) -> None:
    x, y = tied
    found = rank_correlation(np.append(x, np.nan), np.append(y, 3.0))
    assert found.n == N
    assert found.rho == pytest.approx(stats.spearmanr(x, y).statistic, abs=1e-12)


def test_probability_is_that_of_a_permutation_test(tied) -> None:
    x, y = tied
    expected = stats.permutation_test(
        (y,),
        lambda y: stats.spearmanr(x, y).statistic,
        permutation_type="pairings",
        n_resamples=999,
        rng=np.random.default_rng(3),
    )
    spread = np.sqrt(expected.pvalue / 1000)
    assert rank_correlation(x, y).p == pytest.approx(expected.pvalue, abs=5 * spread)
    assert rank_correlation(x, x).p == 1 / (rank.N_PERMUTATIONS + 1)
    assert rank_correlation(x, -x).rho == pytest.approx(-1.0)


def test_weighted_ranks_are_those_of_repeated_values(tied, rng: np.random.Generator) -> None:
    columns, n_drawn = np.column_stack(tied), rng.integers(0, 3, N)
    found = rank._correlations(columns, n_drawn[None].astype(float))
    repeated = np.repeat(columns, n_drawn, axis=0)
    assert found[0] == pytest.approx(stats.spearmanr(repeated).statistic, abs=1e-12)


def test_partial_correlation_takes_off_what_others_explain(rng: np.random.Generator) -> None:
    z, a, b = rng.normal(size=(3, 200))
    both = rank_correlation(a + 3 * z, b + 3 * z)
    held = rank_correlation(a + 3 * z, b + 3 * z, given=np.column_stack([z, rng.normal(size=200)]))
    assert both.rho > 0.7
    assert both.p < 0.001
    assert abs(held.rho) < 0.2
    assert held.p > 0.01
    follows = rank_correlation(a + 3 * z, a + b + 3 * z, given=z[:, None])
    assert follows.rho > 0.4
    assert follows.p < 0.001


def test_partial_is_the_correlation_of_residual_ranks(tied, rng: np.random.Generator) -> None:
    x, y = tied
    z = rng.normal(size=(N, 2))
    ranks = [stats.rankdata(column) for column in (x, y, *z.T)]
    design = np.column_stack([np.ones(N), *ranks[2:]])
    left = [r - design @ np.linalg.lstsq(design, r, rcond=None)[0] for r in ranks[:2]]
    expected = np.corrcoef(left)[0, 1]
    assert rank_correlation(x, y, given=z).rho == pytest.approx(expected, abs=1e-9)


def test_interval_draws_whole_groups(rng: np.random.Generator) -> None:
    """Copies of pairs tell no more than the pairs: their interval is as wide."""
    x = rng.normal(size=30)
    y = x + rng.normal(size=30)
    single = rank_correlation(x, y).interval
    copies = rank_correlation(np.repeat(x, 4), np.repeat(y, 4), groups=np.repeat(np.arange(30), 4))
    naive = rank_correlation(np.repeat(x, 4), np.repeat(y, 4)).interval
    assert single
    assert naive
    assert copies.interval
    assert copies.interval.low == pytest.approx(single.low, abs=0.03)
    assert naive.high - naive.low < 0.7 * (single.high - single.low)


def _walks(rng: np.random.Generator, lengths: np.ndarray) -> np.ndarray:
    """Values that change slowly along each of some trajectories, and follow nothing."""
    return np.concatenate([rng.normal() + 0.3 * rng.normal(size=n).cumsum() for n in lengths])


def test_chance_is_as_frequent_as_said_only_if_groups_stay_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two quantities, each slow along trajectories of unequal lengths, with nothing in common."""
    monkeypatch.setattr(rank, "N_PERMUTATIONS", 199)
    monkeypatch.setattr(rank, "_interval", lambda *_: None)
    n_trials, n_whole, n_single = 300, 0, 0
    for seed in range(n_trials):
        rng = np.random.default_rng(seed)
        lengths = rng.integers(5, 9, 15)
        x, y = _walks(rng, lengths), _walks(rng, lengths)
        n_whole += rank_correlation(x, y, groups=np.repeat(np.arange(15), lengths)).p < 0.05
        n_single += rank_correlation(x, y).p < 0.05
    low, high = stats.binom.ppf([1e-3, 1 - 1e-3], n_trials, 0.05)
    assert low <= n_whole <= high
    assert n_single > 0.3 * n_trials


def test_groups_that_do_follow_are_found(rng: np.random.Generator) -> None:
    lengths = rng.integers(5, 9, 15)
    x = _walks(rng, lengths)
    groups = np.repeat(np.arange(15), lengths)
    assert rank_correlation(x, x + 0.5 * _walks(rng, lengths), groups=groups).p < 0.01


def test_what_every_group_has_along_it_is_not_taken_for_a_connection(
    rng: np.random.Generator,
) -> None:
    """Both rise along each trajectory; which trajectory it is does not matter."""
    along = np.tile(np.arange(8.0), 15)
    x, y = along + rng.normal(size=(2, 120))
    found = rank_correlation(x, y, groups=np.repeat(np.arange(15), 8))
    assert found.rho > 0.6
    assert found.p > 0.05
    assert rank_correlation(x, y).p < 0.001


def test_one_group_cannot_be_exchanged(tied) -> None:
    x, y = tied
    assert rank_correlation(x, y, groups=np.zeros(N)).p == 1.0


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    rho = 0.5
    truth = 6 / np.pi * np.arcsin(rho / 2)  # Spearman's of two normal variables
    n_held = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        x = rng.normal(size=50)
        interval = rank_correlation(x, rho * x + np.sqrt(1 - rho**2) * rng.normal(size=50)).interval
        n_held += bool(interval and interval.low < truth < interval.high)
    assert n_held >= stats.binom.ppf(0.001, 40, 0.93)


@pytest.mark.parametrize(
    ("x", "y"), [([1, 1, 1, 1], [1, 2, 3, 4]), ([1, 2], [1, 2]), ([np.nan] * 4, [1, 2, 3, 4])]
)
def test_what_cannot_be_known_is_not(x, y) -> None:
    found = rank_correlation(x, y)
    assert np.isnan(found.rho)
    assert np.isnan(found.p)
    assert found.interval is None


def test_few_groups_have_no_interval(tied) -> None:
    x, y = tied
    assert rank_correlation(x, y, groups=np.arange(N) % 4).interval is None


def test_what_is_given_may_tell_the_same_twice(tied, rng: np.random.Generator) -> None:
    x, y = tied
    z = rng.normal(size=N)
    once = rank_correlation(x, y, given=z[:, None])
    twice = rank_correlation(x, y, given=np.column_stack([z, np.exp(-z)]))
    assert twice.rho == pytest.approx(once.rho, abs=1e-9)
    assert twice.p == pytest.approx(once.p, abs=1e-3)
    assert np.isnan(rank_correlation(x, y, given=np.column_stack([x, z])).rho)
