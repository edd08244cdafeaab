"""Spearman's rank correlation, with its interval and the probability of one as large by chance.

Ranks are those of ``scipy.stats.rankdata``: ties have the mean of the places they take. A partial
correlation is that of the ranks with what ranks of other quantities explain linearly taken off
(Conover, Practical Nonparametric Statistics, 3rd ed., 1999, section 5.4).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.score.evaluation.resampling import MIN_SHOTS, Interval, bca_interval, replicates

N_PERMUTATIONS = 9999
_SEED = 20260119
_SAME = 1e-9
"""Part of a variance that is rounding: what is left of a quantity that others explain wholly."""


@dataclass(frozen=True, slots=True)
class RankCorrelation:
    """How far one quantity follows another, whatever the form of the curve."""

    n: int
    """Pairs of finite values."""
    rho: float
    """-1 to 1; NaN if one of the two is the same everywhere, or explained wholly by what is given,
    or for fewer than three pairs."""
    interval: Interval | None
    """95 %; None with fewer than ``MIN_SHOTS`` groups, or if ``rho`` is not known."""
    p: float
    """Probability of one as far, either way, from what other pairings of the groups give, if a
    group's values of the one had nothing to do with its values of the other; NaN if ``rho`` is not
    known. Never below one over the factorial of the number of groups."""


def rank_correlation(
    x: ArrayLike, y: ArrayLike, *, given: ArrayLike | None = None, groups: ArrayLike | None = None
) -> RankCorrelation:
    """Correlate ranks.

    Values of one group, as along a trajectory, are not independent of one another. The interval is
    a BCa bootstrap that draws whole groups. The probability is that of a permutation test that
    pairs each group's ``x`` with another group's ``y`` and leaves the order within groups alone:
    groups may be exchanged, single values may not (Winkler, Webster, Vidaurre, Nichols, Smith,
    NeuroImage 123 (2015) 253, whole-block exchangeability). What the order within groups does to
    both alike stays in every pairing; so the distance counts from the mean of all pairings, which
    is 0 without groups. Where groups differ in length, a value is paired with that at the nearest
    relative place of the other group, which is approximate. Of ``N_PERMUTATIONS`` random pairings,
    and the given one itself, those as far count (Phipson, Smyth, Stat. Appl. Genet. Mol. Biol. 9
    (2010) 39). With ``given`` it is what these do not explain of ``y`` that is paired anew
    (Freedman, Lane, J. Bus. Econ. Stat. 1 (1983) 292), which is approximate too.

    Args:
        x: Shape (n,); pairs that are not finite are left out.
        y: Shape (n,).
        given: Quantities that both may follow, shape (n, k); None: none.
        groups: To which group each pair belongs, shape (n,), any type; pairs of a group in their
            order along it. None: each to its own.
    """
    a, b = np.asarray(x, np.float64), np.asarray(y, np.float64)
    z = np.empty((len(a), 0)) if given is None else np.asarray(given, np.float64)
    columns = np.column_stack([a, b, z])
    is_finite = np.isfinite(columns).all(axis=1)
    columns = columns[is_finite]
    labels = np.arange(len(a)) if groups is None else np.asarray(groups)
    place = _places(labels)[is_finite]
    group = np.unique(labels[is_finite], return_inverse=True)[1]
    rho = float(_correlations(columns, np.ones((1, len(columns))))[0])
    if not np.isfinite(rho):
        return RankCorrelation(len(columns), np.nan, None, np.nan)
    return RankCorrelation(
        len(columns), rho, _interval(columns, group, rho), _probability(columns, group, place, rho)
    )


def _interval(columns: FloatArray, group: NDArray[np.intp], rho: float) -> Interval | None:
    n_groups = int(group.max()) + 1
    if n_groups < MIN_SHOTS:
        return None
    drawn = replicates(n_groups, lambda n: _correlations(columns, n[:, group]), seed=_SEED)
    # What leaving a group out does, for the acceleration.
    without = _correlations(columns, (1.0 - np.eye(n_groups))[:, group])
    left = without[np.isfinite(without)]
    return bca_interval(rho, drawn[np.isfinite(drawn)], left.mean() - left)


def _probability(
    columns: FloatArray, group: NDArray[np.intp], place: FloatArray, rho: float
) -> float:
    ranks = np.column_stack([_ranks(column, np.ones((1, len(column))))[0] for column in columns.T])
    given = np.column_stack([np.ones(len(ranks)), ranks[:, 2:]])
    x, y = (_left_over(ranks[:, i], given) for i in (0, 1))
    pairings = y[_pairings(group, place)]
    pairings -= pairings @ given @ np.linalg.pinv(given)
    size = np.linalg.norm(pairings, axis=1)
    # A pairing that leaves nothing of y to correlate says as little as one of 0.
    found = np.divide(pairings @ x, size * np.linalg.norm(x), out=0.0 * size, where=size > _SAME)
    centre = (found.sum() + rho) / (N_PERMUTATIONS + 1)
    # Pairings as good as the given one may differ from it by rounding.
    n_as_far = int((np.abs(found - centre) >= abs(rho - centre) - _SAME).sum())
    return (n_as_far + 1) / (N_PERMUTATIONS + 1)


def _pairings(group: NDArray[np.intp], place: FloatArray) -> NDArray[np.intp]:
    """Exchange whole groups at random; give whose ``y`` each pair gets, shape (n_pairings, n)."""
    partner = np.empty((len(group), int(group.max()) + 1), np.intp)
    """Of each pair, its counterpart in each group: that at the nearest place."""
    for i in range(partner.shape[1]):
        members = np.flatnonzero(group == i)
        partner[:, i] = members[np.abs(place[:, None] - place[members]).argmin(axis=1)]
    groups = np.tile(np.arange(partner.shape[1]), (N_PERMUTATIONS, 1))
    exchanged = np.random.default_rng(_SEED).permuted(groups, axis=1)
    return partner[np.arange(len(group)), exchanged[:, group]]


def _places(labels: NDArray[Any]) -> FloatArray:
    """Give the relative place of each pair in its group, 0 to 1, shape (n,)."""
    place = np.empty(len(labels))
    for label in np.unique(labels):
        members = np.flatnonzero(labels == label)
        place[members] = (np.arange(len(members)) + 0.5) / len(members)
    return place


def _left_over(values: FloatArray, given: FloatArray) -> FloatArray:
    return values - given @ np.linalg.lstsq(given, values, rcond=None)[0]


def _correlations(columns: FloatArray, weights: FloatArray) -> FloatArray:
    """Give the correlation of the first two columns' ranks, the others taken off, of each draw.

    Args:
        columns: Shape (n, 2 + k).
        weights: How often each row is drawn, shape (n_draws, n).

    Returns:
        Shape (n_draws,); NaN where it is not defined.
    """
    n_columns = columns.shape[1]
    if len(columns) <= n_columns:
        return np.full(len(weights), np.nan)
    ranks = np.stack([_ranks(column, weights) for column in columns.T], axis=1)
    total = weights.sum(axis=1)[:, None]
    ranks -= ((ranks * weights[:, None]).sum(axis=2) / total)[:, :, None]
    products = (ranks * weights[:, None]) @ ranks.swapaxes(1, 2)
    size = np.sqrt(np.einsum("dii->di", products))
    found = np.full(len(weights), np.nan)
    is_varied = (size > 0.0).all(axis=1)
    size = size[is_varied]
    correlation = products[is_varied] / size[:, :, None] / size[:, None]
    # What is given may tell the same twice, as range and usable fraction nearly do.
    given = np.linalg.pinv(correlation[:, 2:, 2:], rcond=_SAME, hermitian=True)
    left = correlation[:, :2, :2] - correlation[:, :2, 2:] @ given @ correlation[:, 2:, :2]
    variance = np.einsum("dii->di", left)
    is_left = (variance > _SAME).all(axis=1)
    partial = left[is_left, 0, 1] / np.sqrt(variance[is_left].prod(axis=1))
    found[np.flatnonzero(is_varied)[is_left]] = np.clip(partial, -1.0, 1.0)
    return found


def _ranks(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Rank values that are drawn several times, shape (n_draws, n): ties have their mean place."""
    unique, place = np.unique(values, return_inverse=True)
    n_at = weights @ (place[:, None] == np.arange(len(unique)))
    ranks = np.cumsum(n_at, axis=1) - 0.5 * (n_at - 1.0)
    return ranks[:, place]
