"""The report's tables of what all shots of a core amount to, with intervals."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from tronlab.report.tables import by_core
from tronlab.score.evaluation.bins import BINNED_BY, Bin, BinScore, score_bins
from tronlab.score.evaluation.consistency import (
    N_SIGMA_TRUTH,
    NEES_DOF,
    efficiency,
    nees_consistency,
    truth_limit,
)
from tronlab.score.evaluation.export import Cell, Column, Table
from tronlab.score.evaluation.recall import Share, Threshold, recall
from tronlab.score.evaluation.resampling import CONFIDENCE, Estimate, Interval
from tronlab.score.evaluation.statistics import STATISTICS, between_seeds, estimates, solved_sample

ERRORS = {"position_error_pct_los": "position [% LOS]", "rotation_error_deg": "rotation [deg]"}
"""Columns of the scores, and what people call them."""
_COUNTED = (Column("n_shots", "shots"), Column("n_answers", "answers"), Column("n_ok", "with pose"))
_BIN_STATISTICS = ("mean", "median", "p95", "max")


def statistics_table(scores: pd.DataFrame) -> Table:
    """Give, for each core and error, its statistics with their 95 % intervals.

    They are over the answers with a pose; ``n_answers`` counts all.
    """
    columns = (
        Column("core", "core"),
        Column("error", "error"),
        *_COUNTED,
        *(Column(name, name, ".3g", is_estimate=name != "max") for name in STATISTICS),
    )
    rows: list[tuple[Cell, ...]] = []
    for core, of_core in by_core(scores):
        for metric, label in ERRORS.items():
            found = estimates(solved_sample(of_core, metric))
            cells = (_cell(found[name], name) for name in STATISTICS)
            rows.append((core, label, *_counts(of_core), *cells))
    return Table("statistics", "Errors of each core", columns, tuple(rows))


def seeds_table(scores: pd.DataFrame) -> Table:
    """Give how far apart the statistics of single seeds are: their standard deviation."""
    columns = (
        Column("core", "core"),
        Column("error", "error"),
        Column("n_seeds", "seeds"),
        *(Column(f"{name}_sd", f"sd of {name}", ".2g") for name in STATISTICS),
    )
    rows: list[tuple[Cell, ...]] = []
    for core, of_core in by_core(scores):
        for metric, label in ERRORS.items():
            spread = between_seeds(of_core, metric)
            cells = (_number(spread[name]) for name in STATISTICS)
            rows.append((core, label, int(of_core["seed"].nunique()), *cells))
    caption = "Standard deviation, between seeds, of what each seed alone amounts to"
    return Table("seeds", caption, columns, tuple(rows))


def recall_table(scores: pd.DataFrame, thresholds: Sequence[Threshold]) -> Table:
    """Give, for each core, the share of all answers within each pair of thresholds, percent."""
    columns = (
        Column("core", "core"),
        *_COUNTED,
        *(
            Column(
                f"recall_{t.position_pct_los:g}_pct_los_{t.rotation_deg:g}_deg",
                f"{t.text} [%]",
                ".3g",
                is_estimate=True,
            )
            for t in thresholds
        ),
    )
    rows = tuple(
        (core, *_counts(of_core), *(_percent(share) for share in recall(of_core, thresholds)))
        for core, of_core in by_core(scores)
    )
    caption = "Share of all answers with both errors within, an answer without a pose within none"
    return Table("recall", caption, columns, rows)


def bins_table(scores: pd.DataFrame, column: str, bins: Sequence[Bin], *, label: str = "") -> Table:
    """Give, for each core, the position error in parts of the shots.

    Args:
        scores: Rows of ``scores.csv``.
        column: What the shots are parted by.
        bins: The parts.
        label: What people call the column; needed unless it is one of ``BINNED_BY``.
    """
    metric, label = "position_error_pct_los", label or BINNED_BY[column]
    columns = (
        Column("core", "core"),
        Column("bin", label),
        Column("low", "from", ".4g"),
        Column("high", "to", ".4g"),
        *_COUNTED,
        *(
            Column(f"{metric}_{name}", f"{name} [% LOS]", ".3g", is_estimate=name != "max")
            for name in _BIN_STATISTICS
        ),
    )
    rows = tuple(
        (core, *_bin_row(found))
        for core, of_core in by_core(scores)
        for found in score_bins(of_core, column, bins, metric)
    )
    return Table(f"bins_{column}", f"Position error by {label}", columns, rows)


def consistency_table(scores: pd.DataFrame) -> Table:
    """Give, for each core, its position errors against the truth's sigma, the bound, its own word.

    Only answers with a pose count.
    """
    columns = (
        Column("core", "core"),
        Column("n_truth", "sigma known"),
        Column("error_over_truth_sigma_median", "error / sigma of truth, median", ".3g"),
        Column(
            "within_truth_pct",
            f"below {N_SIGMA_TRUTH:g} sigma of truth [%]",
            ".3g",
            is_estimate=True,
        ),
        Column("n_bound", "bound known"),
        Column("error_over_bound_median", "error / bound, median", ".3g"),
        Column("error_over_bound_rms", "error / bound, rms", ".3g"),
        Column("n_nees", "covariance known"),
        Column("nees_mean", f"mean NEES (honest: {NEES_DOF})", ".3g"),
        Column("nees_low", "honest from", ".3g"),
        Column("nees_high", "honest to", ".3g"),
        Column("verdict", "its covariance is"),
    )
    rows = tuple((core, *_consistency_row(of_core)) for core, of_core in by_core(scores))
    return Table("consistency", "Position errors against what can be known", columns, rows)


def _consistency_row(rows: pd.DataFrame) -> tuple[Cell, ...]:
    truth, bound, nees = truth_limit(rows), efficiency(rows), nees_consistency(rows)
    return (
        truth.within.n,
        truth.median_ratio,
        _percent(truth.within),
        bound.n,
        bound.median_ratio,
        bound.rms_ratio,
        nees.n,
        nees.mean_nees,
        nees.bounds.low if nees.n else np.nan,
        nees.bounds.high if nees.n else np.nan,
        nees.verdict,
    )


def _bin_row(found: BinScore) -> tuple[Cell, ...]:
    return (
        found.bin.text,
        found.bin.low,
        found.bin.high,
        found.n_shots,
        found.n_answers,
        found.n_ok,
        *(_cell(found.estimates[name], name) for name in _BIN_STATISTICS),
    )


def _counts(rows: pd.DataFrame) -> tuple[int, int, int]:
    return int(rows["shot_id"].nunique()), len(rows), int((rows["status"] == "ok").sum())


def _cell(estimate: Estimate, name: str) -> Cell:
    return estimate.value if name == "max" else estimate


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _percent(share: Share) -> Estimate:
    if not share.n:
        return Estimate(np.nan, None)
    low, high = 100.0 * share.interval.low, 100.0 * share.interval.high
    return Estimate(100.0 * share.value, Interval(low, high))


INTERVALS = (
    f"In brackets: {100 * CONFIDENCE:g} % intervals of the shots, by bootstrap (BCa), of shares by"
    " Wilson; an open end: too few shots to bound it. A maximum has none: no number of shots bounds"
    " the largest error possible"
)
"""What the page says about intervals."""
