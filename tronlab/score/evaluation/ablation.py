"""What each source of error costs, found out by switching it off.

Variants of a laboratory take the same shots: ``all`` with every source of error, ``none`` without
any, ``without_SOURCE`` with all but one, ``only_KIND`` with the sources of one kind. Costs are
differences of means over the shots that both variants solved. Shares are of squares, in which
independent errors add up.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Literal, TypeAlias, get_args

import numpy as np
import pandas as pd

from tronlab.errors import ScoreError
from tronlab.geometry.poses import FloatArray
from tronlab.score.evaluation.compare import compare
from tronlab.score.evaluation.consistency import efficiency
from tronlab.score.evaluation.pairing import Run, RunPair
from tronlab.score.evaluation.resampling import (
    CONFIDENCE,
    MIN_SHOTS,
    Estimate,
    bca_interval,
    replicates,
)
from tronlab.score.evaluation.statistics import estimates, solved_sample, weighted_quantiles

Kind: TypeAlias = Literal["terrain", "light", "camera", "truth"]
Part: TypeAlias = Literal["terrain", "light", "camera", "truth", "view", "estimator", "rest"]
Scores: TypeAlias = Mapping[str, Mapping[str, pd.DataFrame]]
"""Rows of ``scores.csv`` by variant and dataset."""

ALL, NONE, TOGETHER = "all", "none", "together"
"""Two variants, and the name that stands for all datasets."""
KINDS: tuple[Kind, ...] = get_args(Kind)
PARTS: tuple[Part, ...] = get_args(Part)
METRIC = "position_error_pct_los"
EFFICIENT_MEDIAN = 0.83
"""Median of error over bound of an estimator that reaches the bound, if two directions make most of
the error: sqrt(ln 2), of a Rayleigh distribution. One direction alone gives 0.67, three alike 0.89.
"""
_SAME_RANGE = 0.05
"""Lines of sight of the same shot differ less between variants, which stand a little elsewhere."""
_SEED = 20260103
"""Of the draws: the same scores have the same intervals."""


@dataclass(frozen=True, slots=True)
class Source:
    """A source of error, as the table names it."""

    name: str
    title: str
    kind: Kind


@dataclass(frozen=True, slots=True)
class Shares:
    """What makes the typical error of a core: shares of the square of its median."""

    n: int
    """Shots that all variants solved."""
    parts: Mapping[Part, Estimate]
    """They add up to 1. ``view`` is what the bound explains, ``estimator`` what it does not of the
    error that is left without any source, ``rest`` what does not add up: sources may cancel each
    other, or make each other worse."""
    largest: Part | None
    """The part that is largest by its amount; None if that is not certain (95 %), or if not all
    are known."""


def without(source: str) -> str:
    """Give the name of the variant that has all sources but one."""
    return f"without_{source}"


def only(kind: Kind) -> str:
    """Give the name of the variant that has the sources of one kind only."""
    return f"only_{kind}"


def ablation_table(scores: Scores, sources: Sequence[Source]) -> pd.DataFrame:
    """Say what each source costs.

    Args:
        scores: With variant ``all``; variants that are missing have no row.
        sources: In the order of the table.

    Returns:
        A row a variant, core and dataset, and one for all datasets together: ``variant``,
        ``source``, ``title``, ``kind``, ``core``, ``dataset``, ``n`` shots, ``n_solved``,
        ``mean_pct_los`` with its limits ``low`` and ``high``, ``cost_pct_los`` with ``cost_low``
        and ``cost_high``, ``n_paired``. The cost is the mean error of ``all`` minus that of the
        variant over the shots that both solved; of ``only_KIND`` it is its own minus that of
        ``none``: what the kind adds to a perfect laboratory.

    Raises:
        ScoreError: There is no variant ``all``, or variants hold other shots.
    """
    if ALL not in scores:
        raise ScoreError("ablation: there are no scores of the variant 'all' to compare with")
    whole = {variant: with_together(of_datasets) for variant, of_datasets in scores.items()}
    rows = [
        {**label, **_row(whole, label["variant"], dataset, core)}
        for label in _labels(sources)
        if label["variant"] in whole
        for dataset, table in whole[label["variant"]].items()
        for core in _cores(table)
    ]
    return pd.DataFrame(rows)


def with_together(of_datasets: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Add the rows of all datasets as one more, each shot with an id of its own."""
    shifted: list[pd.DataFrame] = []
    for i, name in enumerate(sorted(of_datasets)):
        table = of_datasets[name]
        shifted.append(table.assign(shot_id=table["shot_id"] + i * 10**6))
    return {**of_datasets, TOGETHER: pd.concat(shifted, ignore_index=True)}


def error_shares(of_variants: Mapping[str, pd.DataFrame]) -> Shares:
    """Say what makes the typical error of one core on one dataset.

    With the median error m of each variant, a kind has the share ``(m_only^2 - m_none^2) /
    m_all^2``, and ``m_none^2 / m_all^2`` is left of view and estimator. Of that an estimator that
    reaches the Cramer-Rao bound would leave ``(EFFICIENT_MEDIAN / r)^2``, r being the median of
    error over bound in the variant ``none``.

    Args:
        of_variants: Rows of the core, by variant. Kinds without a variant have the share NaN, and
            so has then what does not add up.
    """
    errors = _paired_errors(of_variants)
    n = len(next(iter(errors.values()))) if errors else 0
    if not n or ALL not in errors or NONE not in errors:
        unknown: dict[Part, Estimate] = {part: Estimate(np.nan, None) for part in PARTS}
        return Shares(n, unknown, None)
    geometric = _share_of_view(of_variants[NONE])
    once = np.ones((1, n))
    values = _parts(errors, once, geometric)[0]
    if n < MIN_SHOTS:
        parts: dict[Part, Estimate] = {
            part: Estimate(float(value), None) for part, value in zip(PARTS, values, strict=True)
        }
        return Shares(n, parts, None)
    drawn = replicates(n, lambda counts: _parts(errors, counts, geometric), seed=_SEED)
    return Shares(n, _with_intervals(values, drawn), _largest(values, drawn))


def shares_table(scores: Scores) -> pd.DataFrame:
    """Give the shares of all cores as a table.

    Returns:
        A row a dataset, core and part, and for all datasets together: ``dataset``, ``core``, ``n``,
        ``part``, ``share`` with its limits ``low`` and ``high``, ``is_largest`` if it certainly is.
    """
    whole = {variant: with_together(of_datasets) for variant, of_datasets in scores.items()}
    wanted = [variant for variant in (ALL, NONE, *map(only, KINDS)) if variant in whole]
    rows: list[dict[str, object]] = []
    for dataset, table in whole[ALL].items():
        for core in _cores(table):
            shares = error_shares({v: _of_core(whole[v][dataset], core) for v in wanted})
            rows += _share_rows(shares, dataset, core)
    return pd.DataFrame(rows)


def _share_rows(shares: Shares, dataset: str, core: str) -> list[dict[str, object]]:
    return [
        {
            "dataset": dataset,
            "core": core,
            "n": shares.n,
            "part": part,
            **_limits(estimate, "share", "low", "high"),
            "is_largest": part == shares.largest,
        }
        for part, estimate in shares.parts.items()
    ]


def _labels(sources: Sequence[Source]) -> Iterable[dict[str, str]]:
    def label(variant: str, source: str, title: str, kind: str) -> dict[str, str]:
        return {"variant": variant, "source": source, "title": title, "kind": kind}

    return chain(
        [label(ALL, "", "with every source", "")],
        (label(without(s.name), s.name, s.title, s.kind) for s in sources),
        (label(only(kind), "", f"with those of the kind {kind} only", kind) for kind in KINDS),
        [label(NONE, "", "without any", "")],
    )


def _row(
    whole: Mapping[str, Mapping[str, pd.DataFrame]], variant: str, dataset: str, core: str
) -> dict[str, object]:
    rows = _of_core(whole[variant][dataset], core)
    mean = estimates(solved_sample(rows, METRIC))["mean"]
    base, other = (NONE, variant) if variant.startswith("only_") else (variant, ALL)
    cost, n_paired = _cost(whole, base, other, dataset=dataset, core=core)
    return {
        "core": core,
        "dataset": dataset,
        "n": int(rows["shot_id"].nunique()),
        "n_solved": int((rows["status"] == "ok").sum()),
        **_limits(mean, "mean_pct_los", "low", "high"),
        **_limits(cost, "cost_pct_los", "cost_low", "cost_high"),
        "n_paired": n_paired,
    }


def _cost(
    whole: Mapping[str, Mapping[str, pd.DataFrame]],
    base: str,
    other: str,
    *,
    dataset: str,
    core: str,
) -> tuple[Estimate, int]:
    """Give the mean error of ``other`` minus that of ``base``, and over how many shots."""
    unknown = Estimate(np.nan, None), 0
    tables = [whole.get(variant, {}).get(dataset) for variant in (base, other)]
    if base == other or tables[0] is None or tables[1] is None:
        return unknown
    runs = [
        Run(variant, core, _of_core(table, core))
        for variant, table in ((base, tables[0]), (other, tables[1]))
    ]
    if not _check_same_course(runs[0], runs[1], dataset):
        return unknown
    (found,) = compare([RunPair(runs[0], runs[1])], [METRIC])
    return found.mean, len(found.differences.values)


def _check_same_course(base: Run, other: Run, dataset: str) -> int:
    """Give how many shots two variants have in common.

    Raises:
        ScoreError: A shot was taken from another place.
    """
    ranges = [run.rows.groupby("shot_id")["range_los_m"].first() for run in (base, other)]
    both = pd.concat(ranges, axis=1, join="inner", keys=["base", "other"])
    odd = both[(both["other"] / both["base"] - 1.0).abs() > _SAME_RANGE]
    if len(odd):
        here, there = odd.iloc[0]
        raise ScoreError(
            f"ablation, {dataset}: shot {odd.index[0]} is {here:.4g} m from the terrain in variant"
            f" '{base.folder}' and {there:.4g} m in '{other.folder}': variants must take the same"
            " shots; record the ablation anew"
        )
    return len(both)


def _paired_errors(of_variants: Mapping[str, pd.DataFrame]) -> dict[str, FloatArray]:
    """Give the errors of the shots that all variants solved, by variant, each shape (n,)."""
    by_shot = {
        variant: rows[(rows["status"] == "ok") & np.isfinite(rows[METRIC])]
        .groupby("shot_id")[METRIC]
        .mean()
        for variant, rows in of_variants.items()
    }
    if not by_shot:
        return {}
    paired = pd.concat(by_shot, axis=1, join="inner")
    return {str(variant): paired[variant].to_numpy(np.float64) for variant in paired.columns}


def _share_of_view(rows: pd.DataFrame) -> float:
    """Give which part of the square of the error the bound explains; NaN if no core gives one."""
    ratio = efficiency(rows).median_ratio
    return min(1.0, (EFFICIENT_MEDIAN / ratio) ** 2) if ratio > 0.0 else np.nan


def _parts(errors: Mapping[str, FloatArray], counts: FloatArray, geometric: float) -> FloatArray:
    """Give the shares of all parts for each draw of the shots, shape (n_draws, n_parts)."""
    squares = {variant: _median(values, counts) ** 2 for variant, values in errors.items()}
    whole, floor = squares[ALL], squares[NONE] / squares[ALL]
    missing = np.full_like(whole, np.nan)
    kinds = [
        (squares[only(kind)] - squares[NONE]) / whole if only(kind) in squares else missing
        for kind in KINDS
    ]
    rest = 1.0 - floor - np.sum(kinds, axis=0)
    return np.column_stack([*kinds, geometric * floor, (1.0 - geometric) * floor, rest])


def _median(values: FloatArray, counts: FloatArray) -> FloatArray:
    order = np.argsort(values, kind="stable")
    return weighted_quantiles(values[order], counts[:, order], np.array([0.5]))[:, 0]


def _with_intervals(values: FloatArray, drawn: FloatArray) -> dict[Part, Estimate]:
    parts: dict[Part, Estimate] = {}
    for part, value, column in zip(PARTS, values, drawn.T, strict=True):
        is_known = bool(np.isfinite(column).all())
        # Each shot moves a median by as much up or down: its influence is not skewed.
        interval = bca_interval(float(value), column, np.zeros(1)) if is_known else None
        parts[part] = Estimate(float(value), interval)
    return parts


def _largest(values: FloatArray, drawn: FloatArray) -> Part | None:
    """Give the part that is the largest, by its amount, if it is that in 95 % of the draws."""
    if not np.isfinite(values).all():
        return None
    first = int(np.argmax(np.abs(values)))
    is_first = np.argmax(np.abs(drawn), axis=1) == first
    return PARTS[first] if is_first.mean() >= CONFIDENCE else None


def _limits(estimate: Estimate, *names: str) -> dict[str, float]:
    interval = estimate.interval
    low, high = (interval.low, interval.high) if interval else (np.nan, np.nan)
    return dict(zip(names, (estimate.value, low, high), strict=True))


def _of_core(table: pd.DataFrame, core: str) -> pd.DataFrame:
    return table[table["core"] == core]


def _cores(table: pd.DataFrame) -> list[str]:
    return [str(core) for core in table["core"].unique()]
