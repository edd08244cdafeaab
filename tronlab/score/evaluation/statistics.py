"""Statistics of the scores of a core, with intervals.

A core may answer a shot several times, with other seeds: statistics are over all its answers,
intervals are of the shots.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.score.evaluation.resampling import (
    CONFIDENCE,
    MIN_SHOTS,
    Estimate,
    Interval,
    bca_interval,
    replicates,
)

METRICS = ("position_error_pct_los", "rotation_error_deg")
"""Columns of the table of scores that ``summary.json`` has statistics of."""
QUANTILES: Mapping[str, float] = MappingProxyType(
    {"median": 0.5, "p75": 0.75, "p90": 0.9, "p95": 0.95, "p99": 0.99}
)
STATISTICS = ("mean", "median", "rms", "p75", "p90", "p95", "p99", "max")
_SEED = 20260101
"""Of the draws: the same scores have the same intervals."""

Estimates: TypeAlias = dict[str, Estimate]
Statistics: TypeAlias = dict[str, float | None]
Summary: TypeAlias = dict[str, dict[str, Any]]
IntArray: TypeAlias = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Sample:
    """Finite values of a metric, sorted, and the shot that each is of."""

    values: FloatArray
    """Shape (n,), ascending."""
    shots: IntArray
    """Index of each value's shot, shape (n,), 0 to ``n_shots - 1``."""
    n_shots: int

    @classmethod
    def of(cls, values: ArrayLike, shot_ids: ArrayLike | None = None) -> "Sample":
        """Sort values and number their shots; without ids each value is of a shot of its own."""
        v = np.asarray(values, dtype=np.float64)
        ids = np.arange(v.size) if shot_ids is None else np.asarray(shot_ids)
        is_finite = np.isfinite(v)
        v, ids = v[is_finite], ids[is_finite]
        unique, shots = np.unique(ids, return_inverse=True)
        order = np.argsort(v, kind="stable")
        return cls(v[order], shots[order].astype(np.int64), len(unique))

    def weights(self, counts: FloatArray) -> FloatArray:
        """Give how often each value is drawn, shape (n_draws, n), of counts of the shots."""
        return counts[:, self.shots]

    def per_shot(self, of_values: FloatArray) -> FloatArray:
        """Add up what the values of each shot contribute, shape (n_shots,)."""
        return np.bincount(self.shots, of_values, self.n_shots).astype(np.float64)


def estimates(sample: Sample) -> Estimates:
    """Give mean, median, rms, percentiles and maximum, each but the maximum with its interval.

    Percentiles are those of ``numpy.percentile``. A percentile that so few shots cannot bound from
    above has an infinite upper limit: all of n shots lie below the one of share q with probability
    ``q**n``, and that must be less than half of what the interval may miss. A maximum has no
    interval: no number of shots bounds the largest error possible, and the bootstrap of a maximum
    is inconsistent (Bickel, Freedman, Annals of Statistics 9 (1981) 1196).

    Without values all are NaN.
    """
    found = _values(sample.values)
    has_intervals = sample.n_shots >= MIN_SHOTS
    intervals = _intervals(sample, found) if has_intervals else {}
    return {name: Estimate(found[name], intervals.get(name)) for name in STATISTICS}


def statistics(values: ArrayLike) -> Statistics:
    """Give the same of the finite ones among some values, without intervals; None for none."""
    v = np.asarray(values, dtype=np.float64)
    found = _values(np.sort(v[np.isfinite(v)]))
    return {name: _or_none(found[name]) for name in STATISTICS}


def summarise(scores: pd.DataFrame) -> Summary:
    """Give what ``summary.json`` says of each core, in the order of the table.

    ``n_shots`` are different shots, ``n_answers`` those times the seeds, ``n_ok`` answers with a
    pose. Statistics are of answers with a pose; ``intervals`` has their limits (null: not bounded),
    ``between_seeds`` the standard deviation over the seeds of what each seed alone amounts to.
    """
    return {str(core): _summary(scores[scores["core"] == core]) for core in scores["core"].unique()}


def solved_sample(rows: pd.DataFrame, metric: str) -> Sample:
    """Give the values of a metric where there is a pose."""
    solved = rows[rows["status"] == "ok"]
    return Sample.of(solved[metric], solved["shot_id"])


def between_seeds(rows: pd.DataFrame, metric: str) -> Statistics:
    """Give the standard deviation of each statistic over the seeds of one core's rows.

    None with fewer than two seeds that have a pose.
    """
    solved = rows[rows["status"] == "ok"]
    of_seeds = [_values(np.sort(of_seed)) for of_seed in _by_seed(solved, metric)]
    if len(of_seeds) < 2:
        return dict.fromkeys(STATISTICS)
    return {name: float(np.std([found[name] for found in of_seeds], ddof=1)) for name in STATISTICS}


def weighted_mean(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Give the mean of values (n,) drawn as often as weights (n_draws, n) say; (n_draws,)."""
    return weights @ values / weights.sum(axis=1)


def weighted_quantiles(values: FloatArray, weights: FloatArray, shares: FloatArray) -> FloatArray:
    """Give quantiles of values drawn several times, as ``numpy.quantile`` of all drawn ones.

    Args:
        values: Ascending, shape (n,).
        weights: How often each is drawn, shape (n_draws, n).
        shares: Shape (n_quantiles,), 0 to 1.

    Returns:
        Shape (n_draws, n_quantiles).
    """
    n_until = np.cumsum(weights, axis=1)
    last = n_until[:, -1:] - 1
    rank = shares * last
    lower = np.floor(rank)
    low = values[_at_rank(n_until, lower)]
    high = values[_at_rank(n_until, np.minimum(lower + 1, last))]
    return low + (rank - lower) * (high - low)


def _values(values: FloatArray) -> dict[str, float]:
    """Give the statistics of values in ascending order; NaN for none."""
    if not values.size:
        return dict.fromkeys(STATISTICS, np.nan)
    return {
        "mean": float(values.mean()),
        "rms": float(np.sqrt((values**2).mean())),
        **{name: float(np.quantile(values, q)) for name, q in QUANTILES.items()},
        "max": float(values[-1]),
    }


def _summary(rows: pd.DataFrame) -> dict[str, Any]:
    summary: dict[str, Any] = {
        "n_shots": int(rows["shot_id"].nunique()),
        "n_answers": len(rows),
        "n_ok": int((rows["status"] == "ok").sum()),
        "seeds": sorted(int(seed) for seed in rows["seed"].unique()),
    }
    for metric in METRICS:
        found = estimates(solved_sample(rows, metric))
        summary[metric] = {
            **{name: _or_none(estimate.value) for name, estimate in found.items()},
            "intervals": {
                name: [_or_none(estimate.interval.low), _or_none(estimate.interval.high)]
                for name, estimate in found.items()
                if estimate.interval is not None
            },
            "between_seeds": between_seeds(rows, metric),
        }
    return summary


def _by_seed(solved: pd.DataFrame, metric: str) -> list[FloatArray]:
    groups = (of_seed[metric].to_numpy(np.float64) for _, of_seed in solved.groupby("seed"))
    return [values[np.isfinite(values)] for values in groups]


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _at_rank(n_until: FloatArray, ranks: FloatArray) -> NDArray[np.intp]:
    """Find which value has each rank, from 0, shape (n_draws, n_quantiles)."""
    n_values = n_until.shape[1]
    # One search for all draws: each goes on where the one before ended.
    n_before = np.concatenate([[0.0], np.cumsum(n_until[:-1, -1])])[:, None]
    found = np.searchsorted((n_until + n_before).ravel(), ranks + n_before, side="right")
    return found - n_values * np.arange(len(n_until))[:, None]


def _intervals(sample: Sample, found: Mapping[str, float]) -> dict[str, Interval]:
    values = sample.values
    shares = np.array(list(QUANTILES.values()))

    def replicate(counts: FloatArray) -> FloatArray:
        weights = sample.weights(counts)
        mean, square = weighted_mean(values, weights), weighted_mean(values**2, weights)
        quantiles = weighted_quantiles(values, weights, shares)
        return np.column_stack([mean, np.sqrt(square), quantiles])

    replicated = replicates(sample.n_shots, replicate, seed=_SEED)
    influences: dict[str, FloatArray] = {
        "mean": values - found["mean"],
        "rms": values**2 - found["rms"] ** 2,
        **{name: q - (values <= found[name]).astype(np.float64) for name, q in QUANTILES.items()},
    }
    intervals: dict[str, Interval] = {}
    for column, (name, influence) in zip(replicated.T, influences.items(), strict=True):
        interval = bca_interval(found[name], column, sample.per_shot(influence))
        is_bounded = QUANTILES.get(name, 0.0) ** sample.n_shots < (1.0 - CONFIDENCE) / 2.0
        intervals[name] = interval if is_bounded else Interval(interval.low, np.inf)
    return intervals
