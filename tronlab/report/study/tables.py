"""Tables of a study: the paper's own beside ours, limits, comparisons, and what it took."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from tronlab.geometry.poses import FloatArray
from tronlab.report.paper import (
    DATASET_0,
    DATASETS,
    PAPER_CORES,
    PublishedErrors,
    detector_of,
    is_refined,
)
from tronlab.report.tables import by_core
from tronlab.score.evaluation.bins import BINNED_BY, Bin, make_bins
from tronlab.score.evaluation.consistency import efficiency_with_truth
from tronlab.score.evaluation.export import Cell, Column, Table
from tronlab.score.evaluation.resampling import Estimate
from tronlab.score.evaluation.statistics import Estimates, estimates, solved_sample

METRIC = "position_error_pct_los"
PARTED_BY = {
    "range_los_m": BINNED_BY["range_los_m"],
    "usable_fraction": BINNED_BY["usable_fraction"],
    "n_inliers": "inliers",
}
"""Columns of the scores that the error is shown against."""
_OF_ANSWERS = ("n_inliers",)
_ROW_NAMES = {"mean": "Average", "max": "Maximum"}

Scores = Mapping[str, pd.DataFrame]
"""Rows of ``scores.csv`` by dataset."""


@dataclass(frozen=True, slots=True)
class Parted:
    """Scores of all datasets, and parts of them by one column."""

    column: str
    label: str
    scores: pd.DataFrame
    bins: Sequence[Bin]
    counted: str
    """What the bins hold: shots, or answers of cores."""


def published_table(
    name: str, caption: str, scores: Scores, published: Mapping[tuple[str, str], PublishedErrors]
) -> Table:
    """Give Table 1 or 2 of the paper with our values in rows below the paper's.

    Columns are the paper's: a detector and a dataset each. Cells of sets that were not taken are
    empty.

    Args:
        name: File name without ending.
        caption: For the page.
        scores: By dataset.
        published: The paper's values by dataset and detector.
    """
    columns = (
        Column("row", "norm of position error"),
        *(
            Column(
                f"{dataset}_{detector.lower()}_pct_los",
                f"{detector}, {DATASETS[dataset].title.partition(',')[0]} [% LOS]",
                ".3g",
                is_estimate=True,
            )
            for dataset, detector in published
        ),
    )
    found = {cell: _errors_of(scores, *cell) for cell in published}
    rows: list[tuple[Cell, ...]] = []
    for statistic, label in _ROW_NAMES.items():
        paper = (getattr(errors, f"{statistic}_pct_los") for errors in published.values())
        rows.append((f"{label}, the paper's", *paper))
        for refined, whose in ((False, "ours"), (True, "ours, refined")):
            ours = (_cell(found[cell].get(refined), statistic) for cell in published)
            rows.append((f"{label}, {whose}", *ours))
    return Table(name, caption, columns, tuple(rows))


def straight_line_table(scores: pd.DataFrame) -> Table:
    """Give the errors of dataset 0 beside the bounds that the paper states."""
    columns = (
        Column("row", "norm of position error"),
        *(
            Column(f"{detector.lower()}_pct_los", f"{detector} [% LOS]", ".3g", is_estimate=True)
            for detector in PAPER_CORES.values()
        ),
    )
    found = {name: _errors_of({"dataset_0": scores}, "dataset_0", name) for name in _detectors()}
    rows: list[tuple[Cell, ...]] = []
    for statistic, label in _ROW_NAMES.items():
        bound = getattr(DATASET_0, f"{statistic}_below_pct_los")
        rows.append((f"{label}, the paper's is below", *(bound for _ in found)))
        for refined, whose in ((False, "ours"), (True, "ours, refined")):
            ours = (_cell(of.get(refined), statistic) for of in found.values())
            rows.append((f"{label}, {whose}", *ours))
    return Table("dataset_0", "Straight line (dataset 0)", columns, tuple(rows))


def counts_table(scores: Scores, planned: Mapping[str, int], rejected: Mapping[str, int]) -> Table:
    """Give how many points each dataset has beside the paper's.

    Args:
        scores: By dataset.
        planned: Points of the trajectories before any was left out, where that is known.
        rejected: Draws of perturbed starts that no descent was found for, likewise.
    """
    columns = (
        Column("dataset", "dataset"),
        Column("n_paper", "points, the paper's"),
        Column("n_shots", "points, ours", ".0f"),
        Column("n_planned", "of the trajectories", ".0f"),
        Column("n_rejected", "starts drawn again", ".0f"),
        Column("least_usable_pct", "least usable area [%]", ".3g"),
        Column("least_range_m", "range from [m]", ".3g"),
        Column("largest_range_m", "to [m]", ".3g"),
    )
    rows = tuple(
        (
            published.title,
            published.n_shots,
            float(scores[name]["shot_id"].nunique()) if name in scores else np.nan,
            float(planned.get(name, np.nan)),
            float(rejected.get(name, np.nan)),
            *(_view_cells(scores[name]) if name in scores else (np.nan,) * 3),
        )
        for name, published in DATASETS.items()
    )
    return Table("counts", "Points of each dataset", columns, rows)


def errors_table(scores: Scores) -> Table:
    """Give, for each dataset and core, position errors, and the mean error of each camera axis."""
    columns = (
        Column("dataset", "dataset"),
        Column("core", "core"),
        Column("n_answers", "shots"),
        Column("n_ok", "with pose"),
        *(
            Column(f"{name}_pct_los", f"{name} [% LOS]", ".3g", is_estimate=name != "max")
            for name in ("mean", "median", "p95", "max")
        ),
        *(Column(f"axis_{a}_deg", f"camera axis {a}, mean [deg]", ".2g") for a in "xyz"),
    )
    rows: list[tuple[Cell, ...]] = []
    for dataset, core, of_core in _cases(scores):
        found = estimates(solved_sample(of_core, METRIC))
        solved = of_core[of_core["status"] == "ok"]
        rows.append(
            (
                DATASETS[dataset].title,
                core,
                len(of_core),
                len(solved),
                *(found[name] for name in ("mean", "median", "p95")),
                found["max"].value,
                *(float(solved[f"axis_error_{axis}_deg"].mean()) for axis in "xyz"),
            )
        )
    return Table("errors", "Errors of each dataset and core", columns, tuple(rows))


def bound_table(scores: Scores) -> Table:
    """Give, for each dataset and core, position error over its Cramer-Rao bound, and the bound.

    Beside it stands the error over the sigma that the core states itself, of the same poses as far
    as it states one.
    """
    columns = (
        Column("dataset", "dataset"),
        Column("core", "core"),
        Column("n_bound", "poses with a bound"),
        Column("median", "median", ".3g"),
        Column("lower_quartile", "lower quartile", ".3g"),
        Column("upper_quartile", "upper quartile", ".3g"),
        Column("median_over_floor", "over bound and truth together, median", ".3g"),
        Column("median_over_stated", "over the core's own sigma, median", ".3g"),
        Column("bound_pct_los", "bound, median [% LOS]", ".2g"),
        Column("sigma_truth_pct_los", "sigma of truth, median [% LOS]", ".2g"),
    )
    rows: list[tuple[Cell, ...]] = []
    for dataset, core, of_core in _cases(scores):
        known = of_core[(of_core["status"] == "ok") & (of_core["bound_m"] > 0.0)]
        if known.empty:
            continue
        ratio = known["position_error_m"] / known["bound_m"]
        quartiles = (float(ratio.quantile(q)) for q in (0.5, 0.25, 0.75))
        of_range = (
            float((100.0 * known[name] / known["range_los_m"]).median())
            for name in ("bound_m", "sigma_truth_m")
        )
        stated = float((known["position_error_m"] / known["sigma_core_m"]).median())
        floor = efficiency_with_truth(known).median_ratio
        cells = (len(known), *quartiles, floor, stated, *of_range)
        rows.append((DATASETS[dataset].title, core, *cells))
    return Table("bound", "Position error over Cramer-Rao bound", columns, tuple(rows))


def parted(scores: pd.DataFrame) -> Iterator[Parted]:
    """Give the scores of all datasets once for each quantity they are parted by.

    Shots of different datasets get different numbers; by inliers, of which each core has its own
    number in a shot, every answer does.

    Args:
        scores: With the column ``dataset``.
    """
    shots = scores.groupby(["dataset", "shot_id"]).ngroup()
    for column, label in PARTED_BY.items():
        is_of_answers = column in _OF_ANSWERS
        rows = scores.assign(shot_id=np.arange(len(scores)) if is_of_answers else shots)
        counted = "answer" if is_of_answers else "shot"
        yield Parted(column, label, rows, make_bins(rows, column), counted)


def _errors_of(scores: Scores, dataset: str, detector: str) -> dict[bool, Estimates]:
    """Give the errors of a detector's two cores, by whether they refine."""
    if dataset not in scores:
        return {}
    return {
        is_refined(core): estimates(solved_sample(rows, METRIC))
        for core, rows in by_core(scores[dataset])
        if detector_of(core) == detector
    }


def _cell(found: Estimates | None, statistic: str) -> Cell:
    return Estimate(np.nan, None) if found is None else found[statistic]


def _detectors() -> tuple[str, ...]:
    return tuple(PAPER_CORES.values())


def _cases(scores: Scores) -> Iterator[tuple[str, str, pd.DataFrame]]:
    for dataset, table in scores.items():
        for core, rows in by_core(table):
            yield dataset, core, rows


def _view_cells(scores: pd.DataFrame) -> tuple[float, float, float]:
    ranges_m: FloatArray = scores["range_los_m"].to_numpy(np.float64)
    least_pct = 100.0 * float(scores["usable_fraction"].min())
    return least_pct, float(ranges_m.min()), float(ranges_m.max())
