"""Comparing two scorings of the same shots, pair by pair.

Repeats of a shot with other seeds count once, by their mean, since they are not independent.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from tronlab.errors import ScoreError
from tronlab.geometry.poses import FloatArray
from tronlab.score.evaluation.pairing import RunPair
from tronlab.score.evaluation.resampling import MIN_SHOTS, Estimate, bca_interval, replicates
from tronlab.score.evaluation.statistics import weighted_mean, weighted_quantiles

COMPARED_METRICS = (
    "position_error_pct_los",
    "position_error_m",
    "rotation_error_deg",
    "time_detect_s",
    "time_match_s",
    "time_pose_s",
)
"""Columns of ``scores.csv`` that can be compared: less is better in each."""
_SEED = 20260102
"""Of the draws: the same scores have the same intervals."""


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How much larger an error may be before it counts as worse."""

    amount: float = 0.0
    is_relative: bool = False
    """Whether ``amount`` is a part of the base's own statistic, else in the metric's unit."""

    def of(self, base: float) -> float:
        """Give it in the metric's unit, for a statistic that is ``base`` in the base."""
        return self.amount * base if self.is_relative else self.amount


@dataclass(frozen=True, slots=True)
class Solved:
    """Who found a pose."""

    n_shots: int
    n_answers: int
    """Of each run: shots times the seeds they have in common."""
    n_base: int
    """Answers with a pose; likewise ``n_other``."""
    n_other: int
    n_base_only: int
    """Shots that the base solved, and the other did not; with repeats: less often."""
    n_other_only: int
    p_value: float
    """Of McNemar's exact test that both solve equally often (Psychometrika 12 (1947) 153)."""


@dataclass(frozen=True, slots=True)
class Differences:
    """A metric of the shots that both runs solved."""

    shot_ids: NDArray[np.int64]
    """Shape (n,)."""
    range_los_m: FloatArray
    base: FloatArray
    """Mean over the repeats of each shot, shape (n,); likewise ``other``."""
    other: FloatArray

    @property
    def values(self) -> FloatArray:
        """Get other minus base, shape (n,): above zero is worse."""
        return self.other - self.base


@dataclass(frozen=True, slots=True)
class Tests:
    """Probabilities of differences as large as these if there were none."""

    wilcoxon: float
    """Signed rank test: differences are symmetric about zero (Wilcoxon, Biometrics Bulletin 1
    (1945) 80). Shots that are the same in both are left out; 1 if all are."""
    sign: float
    """Sign test: better and worse are equally likely; likewise."""
    solved: float
    """McNemar's, of ``Solved``."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """One run against another in one metric."""

    pair: RunPair
    metric: str
    solved: Solved
    differences: Differences
    mean: Estimate
    """Difference of the means; NaN if no shot was solved by both."""
    median: Estimate
    """Difference of the medians; likewise."""
    n_left_out: int
    """Answers of either run whose seed the other did not use."""
    p: Tests
    p_holm: Tests
    """Adjusted for all pairs that were compared together."""

    @property
    def n_better(self) -> int:
        """Get the number of shots with a smaller value than in the base."""
        return int((self.differences.values < 0.0).sum())

    @property
    def n_same(self) -> int:
        """Get the number of shots with the same value."""
        return int((self.differences.values == 0.0).sum())

    @property
    def n_worse(self) -> int:
        """Get the number of shots with a larger value."""
        return int((self.differences.values > 0.0).sum())


def parse_tolerance(text: str) -> Tolerance:
    """Read ``0.02``, in the metric's unit, or ``5%`` of the base's own value.

    Raises:
        ScoreError: It is neither.
    """
    is_relative = text.strip().endswith("%")
    try:
        amount = float(text.strip().removesuffix("%"))
    except ValueError:
        amount = np.nan
    if not (np.isfinite(amount) and amount >= 0.0):
        raise ScoreError(
            f"tolerance '{text}': must be a number from 0 in the metric's unit, as 0.02, or a"
            " percentage of the base's value, as 5%"
        )
    return Tolerance(amount / 100.0 if is_relative else amount, is_relative)


def compare(pairs: Sequence[RunPair], metrics: Sequence[str]) -> list[Comparison]:
    """Compare runs in some metrics.

    Probabilities are adjusted over the pairs, for each metric by itself.

    Raises:
        ScoreError: An unknown metric, or two runs that have no seed in common.
    """
    for metric in metrics:
        if metric not in COMPARED_METRICS:
            raise ScoreError(
                f"metric '{metric}': cannot be compared; give one of {', '.join(COMPARED_METRICS)}"
            )
    return [
        comparison
        for metric in metrics
        for comparison in _adjusted([_compare(pair, metric) for pair in pairs])
    ]


def regressions(comparison: Comparison, tolerance: Tolerance) -> list[str]:
    """Say what is worse than in the base, a line each; none: nothing.

    A metric is worse if the whole 95 % interval of the difference of its means, or of its medians,
    is above the tolerance. Solving is worse if there are fewer poses than in the base.
    """
    solved, base = comparison.solved, comparison.differences.base
    found: list[str] = []
    for name, estimate, of_base in (
        ("mean", comparison.mean, float(base.mean()) if base.size else 0.0),
        ("median", comparison.median, float(np.median(base)) if base.size else 0.0),
    ):
        interval, allowed = estimate.interval, tolerance.of(of_base)
        if interval is not None and interval.low > allowed:
            found.append(
                f"{name} of {comparison.metric} is larger by {estimate.value:.3g}"
                f" [{interval.low:.3g}, {interval.high:.3g}], allowed is {allowed:.3g}"
            )
    if solved.n_other < solved.n_base:
        found.append(f"poses: {solved.n_other} of {solved.n_answers}, were {solved.n_base}")
    return found


def holm(p_values: ArrayLike) -> FloatArray:
    """Adjust probabilities of several tests, so that one of them errs as rarely as one alone.

    S. Holm, A simple sequentially rejective multiple test procedure, Scandinavian Journal of
    Statistics 6 (1979) 65. NaN stays, and does not count as a test.

    Args:
        p_values: Shape (n,).
    """
    p = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(p)[: np.count_nonzero(~np.isnan(p))]
    adjusted = np.full(p.shape, np.nan)
    factors = np.arange(order.size, 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(factors * p[order]), 1.0)
    return adjusted


def _compare(pair: RunPair, metric: str) -> Comparison:
    merged = _merged(pair, metric)
    solved, differences = _solved(merged), _differences(merged)
    tests = Tests(_wilcoxon(differences.values), _sign(differences.values), solved.p_value)
    mean, median = _centres(differences)
    n_left_out = len(pair.base.rows) + len(pair.other.rows) - 2 * len(merged)
    return Comparison(
        pair, metric, solved, differences, mean, median, n_left_out, p=tests, p_holm=tests
    )


def _adjusted(comparisons: Sequence[Comparison]) -> list[Comparison]:
    columns = [
        holm([getattr(comparison.p, name) for comparison in comparisons]).tolist()
        for name in ("wilcoxon", "sign", "solved")
    ]
    return [
        replace(comparison, p_holm=Tests(*values))
        for comparison, *values in zip(comparisons, *columns, strict=True)
    ]


def _merged(pair: RunPair, metric: str) -> pd.DataFrame:
    """Put the answers of both runs to the same shot with the same seed side by side."""
    keys = ["shot_id", "seed"]
    columns = [*keys, "range_los_m", "status", metric]
    base, other = pair.base.rows[columns], pair.other.rows[columns]
    merged = base.merge(other, on=keys, suffixes=("_base", "_other"))
    if merged.empty:
        seeds = (sorted(int(s) for s in rows["seed"].unique()) for rows in (base, other))
        raise ScoreError(
            f"{pair.name}: no seed in common: {' and '.join(map(str, seeds))};"
            " score both with the same --seeds"
        )
    for side in ("base", "other"):
        merged[f"solved_{side}"] = (merged[f"status_{side}"] == "ok") & np.isfinite(
            merged[f"{metric}_{side}"]
        )
        merged[f"value_{side}"] = merged[f"{metric}_{side}"]
    return merged


def _solved(merged: pd.DataFrame) -> Solved:
    of_shots = merged.groupby("shot_id")[["solved_base", "solved_other"]].sum()
    base, other = (of_shots[name].to_numpy(np.int64) for name in of_shots.columns)
    n_base_only, n_other_only = int((base > other).sum()), int((other > base).sum())
    return Solved(
        n_shots=len(of_shots),
        n_answers=len(merged),
        n_base=int(base.sum()),
        n_other=int(other.sum()),
        n_base_only=n_base_only,
        n_other_only=n_other_only,
        p_value=_even_odds(n_base_only, n_other_only),
    )


def _differences(merged: pd.DataFrame) -> Differences:
    both = merged[merged["solved_base"] & merged["solved_other"]]
    columns = ["range_los_m_base", "value_base", "value_other"]
    of_shots = both.groupby("shot_id")[columns].mean()
    range_m, base, other = (of_shots[name].to_numpy(np.float64) for name in columns)
    return Differences(of_shots.index.to_numpy(np.int64), range_m, base, other)


def _centres(differences: Differences) -> tuple[Estimate, Estimate]:
    """Give the differences of means and of medians; none of no shots."""
    base, other, n = differences.base, differences.other, len(differences.base)
    if not n:
        return Estimate(np.nan, None), Estimate(np.nan, None)
    mean = float(differences.values.mean())
    median = float(np.median(other) - np.median(base))
    if n < MIN_SHOTS:
        return Estimate(mean, None), Estimate(median, None)
    order_base, order_other = np.argsort(base), np.argsort(other)
    half = np.array([0.5])

    def replicate(counts: FloatArray) -> FloatArray:
        median_other = weighted_quantiles(other[order_other], counts[:, order_other], half)
        median_base = weighted_quantiles(base[order_base], counts[:, order_base], half)
        means = weighted_mean(differences.values, counts)
        return np.column_stack([means, median_other - median_base])

    replicated = replicates(n, replicate, seed=_SEED)
    # Each shot moves a median by as much up or down: its influence is not skewed.
    return (
        Estimate(mean, bca_interval(mean, replicated[:, 0], differences.values - mean)),
        Estimate(median, bca_interval(median, replicated[:, 1], np.zeros(n))),
    )


def _wilcoxon(values: FloatArray) -> float:
    from scipy.stats import wilcoxon

    if not values.size:
        return np.nan
    differing = values[values != 0.0]
    if not differing.size:
        return 1.0
    result: Any = wilcoxon(differing)
    return float(result.pvalue)


def _sign(values: FloatArray) -> float:
    if not values.size:
        return np.nan
    return _even_odds(int((values < 0.0).sum()), int((values > 0.0).sum()))


def _even_odds(n_one: int, n_other: int) -> float:
    """Give the probability of counts as uneven if both were equally likely; 1 of none."""
    from scipy.stats import binomtest

    return float(binomtest(n_one, n_one + n_other).pvalue) if n_one + n_other else 1.0
