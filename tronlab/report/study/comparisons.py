"""Comparisons within a study, shot by shot: of cores, and of the larger terrain with the usual."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import pandas as pd

from tronlab.report.paper import DATASETS, PAPER_CORES, is_refined
from tronlab.report.study.tables import METRIC, Scores
from tronlab.report.tables import by_core
from tronlab.score.evaluation.compare import Comparison, compare
from tronlab.score.evaluation.export import Cell, Column, Table
from tronlab.score.evaluation.pairing import Run, RunPair
from tronlab.score.evaluation.statistics import estimates, solved_sample

_PAIR_COLUMNS = (
    Column("n_pairs", "pairs"),
    Column("difference_pct_los", "difference of means [% LOS]", ".3g", is_estimate=True),
    Column("n_better", "better"),
    Column("n_worse", "worse"),
    Column("p_holm", "p (Wilcoxon, Holm)", ".2g"),
    Column("n_ok_base", "poses, base"),
    Column("n_ok_other", "poses, other"),
)


def compare_cores(scores: Scores) -> dict[str, list[Comparison]]:
    """Hold the cores of each dataset against one another, shot by shot.

    Each refined core against the paper's of its detector, and the detectors against each other;
    probabilities are adjusted within a dataset.
    """
    return {
        dataset: compare(pairs, [METRIC])
        for dataset, table in scores.items()
        if (pairs := _core_pairs(dataset, table))
    }


def cores_table(comparisons: Mapping[str, Sequence[Comparison]]) -> Table:
    """Give a row a pair of cores."""
    columns = (
        Column("dataset", "dataset"),
        Column("base", "base"),
        Column("other", "other"),
        *_PAIR_COLUMNS,
    )
    rows = tuple(
        (DATASETS[dataset].title, c.pair.base.core, c.pair.other.core, *pair_cells(c))
        for dataset, of_dataset in comparisons.items()
        for c in of_dataset
    )
    return Table("cores", "Cores, shot by shot: other minus base", columns, rows)


def compare_terrains(normal: Scores, larger: Scores) -> dict[str, list[Comparison]]:
    """Hold the larger terrain against the usual one, pose by pose, for each dataset and core."""
    found: dict[str, list[Comparison]] = {}
    for dataset, table in larger.items():
        usual = dict(by_core(normal[dataset])) if dataset in normal else {}
        pairs = [
            RunPair(Run("usual", core, usual[core]), Run("larger", core, rows))
            for core, rows in by_core(table)
            if core in usual and set(usual[core]["shot_id"]) & set(rows["shot_id"])
        ]
        if pairs:
            found[dataset] = compare(pairs, [METRIC])
    return found


def larger_table(
    normal: Scores, larger: Scores, comparisons: Mapping[str, Sequence[Comparison]]
) -> Table:
    """Give the errors with both terrains, and their difference over the poses both have."""
    columns = (
        Column("dataset", "dataset"),
        Column("core", "core"),
        Column("usable_pct", "usable area, mean [%]", ".3g"),
        Column("usable_larger_pct", "larger: usable area [%]", ".3g"),
        Column("mean_pct_los", "mean [% LOS]", ".3g", is_estimate=True),
        Column("mean_larger_pct_los", "larger: mean [% LOS]", ".3g", is_estimate=True),
        *_PAIR_COLUMNS,
    )
    rows: list[tuple[Cell, ...]] = []
    for dataset, of_dataset in comparisons.items():
        for c in of_dataset:
            both = (dict(by_core(of[dataset]))[c.pair.base.core] for of in (normal, larger))
            usual, wide = both
            rows.append(
                (
                    DATASETS[dataset].title,
                    c.pair.base.core,
                    100.0 * float(usual["usable_fraction"].mean()),
                    100.0 * float(wide["usable_fraction"].mean()),
                    estimates(solved_sample(usual, METRIC))["mean"],
                    estimates(solved_sample(wide, METRIC))["mean"],
                    *pair_cells(c),
                )
            )
    return Table("larger", "Larger terrain against the usual one", columns, tuple(rows))


def pair_cells(comparison: Comparison) -> tuple[Cell, ...]:
    """Give what tables say of a pair of runs."""
    return (
        len(comparison.differences.values),
        comparison.mean,
        comparison.n_better,
        comparison.n_worse,
        comparison.p_holm.wilcoxon,
        comparison.solved.n_base,
        comparison.solved.n_other,
    )


def _core_pairs(dataset: str, scores: pd.DataFrame) -> list[RunPair]:
    runs = {core: Run(dataset, core, rows) for core, rows in by_core(scores)}
    refined = [core for core in runs if is_refined(core)]
    paper = [core for core in runs if core in PAPER_CORES]
    named = [
        *((core.removesuffix("-refined"), core) for core in refined),
        *pairwise(paper),
        *pairwise(refined),
    ]
    return [RunPair(runs[base], runs[other]) for base, other in named if base in runs]
