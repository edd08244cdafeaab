"""What each way of choosing features and matches gains, shot by shot."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import pandas as pd

from tronlab.score.evaluation.compare import Comparison, compare
from tronlab.score.evaluation.pairing import Run, RunPair
from tronlab.study.config import SelectionVariant
from tronlab.study.pruned import HALVES, half_name

METRIC: Final = "position_error_pct_los"
ALL: Final = "all"
"""Stands for the dataset where the shots of all of them are taken together."""

_SHOTS_A_DATASET: Final = 1_000_000


def selection_table(
    variants: Mapping[str, SelectionVariant], scores: Mapping[str, pd.DataFrame]
) -> pd.DataFrame:
    """Hold each variant against its base.

    Args:
        variants: By name.
        scores: By dataset: the rows of bases and variants.

    Returns:
        One row a base or variant and dataset, and one for all datasets together. A gain is the
        error of the base minus that of the variant, in per cent of the line of sight, the mean over
        the shots that both solved, with its 95 % interval (BCa); above 0 the variant is better.
        ``p`` is that of Wilcoxon's signed rank test, ``p_holm`` adjusted for all variants of a
        dataset.
    """
    whole = {name: _whole(variants, rows) for name, rows in scores.items()}
    if len(whole) > 1:
        whole[ALL] = _together(whole)
    rows = [row for dataset, table in whole.items() for row in _rows(variants, dataset, table)]
    return pd.DataFrame(rows)


def _whole(variants: Mapping[str, SelectionVariant], scores: pd.DataFrame) -> pd.DataFrame:
    """Put the halves of a variant together: each shot with the landmarks that the others chose."""
    order = {shot: i for i, shot in enumerate(sorted(scores["shot_id"].unique()))}
    is_odd = scores["shot_id"].map(order) % 2 == 1
    core, is_kept = scores["core"].copy(), pd.Series(data=True, index=scores.index)
    for name in variants:
        for half, of_half in zip(HALVES, (~is_odd, is_odd), strict=True):
            is_of_half = scores["core"] == half_name(name, half)
            is_kept &= ~is_of_half | of_half
            core[is_of_half] = name
    return scores.assign(core=core)[is_kept]


def _together(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    numbered = (
        table.assign(shot_id=table["shot_id"] + i * _SHOTS_A_DATASET)
        for i, table in enumerate(tables.values())
    )
    return pd.concat(numbered, ignore_index=True)


def _rows(
    variants: Mapping[str, SelectionVariant], dataset: str, scores: pd.DataFrame
) -> Iterator[dict[str, Any]]:
    runs = {
        core: Run(dataset, str(core), rows) for core, rows in scores.groupby("core", sort=False)
    }
    for base in dict.fromkeys(variant.base for variant in variants.values()):
        about = {"variant": base, "title": "as it is", "step": "base", "base": base}
        yield about | {"dataset": dataset} | _figures(runs[base].rows) | _gain(None)
    pairs = [RunPair(runs[variant.base], runs[name]) for name, variant in variants.items()]
    for (name, variant), comparison in zip(variants.items(), compare(pairs, [METRIC]), strict=True):
        about = {
            "variant": name,
            "title": variant.title,
            "step": variant.step,
            "base": variant.base,
            "dataset": dataset,
        }
        yield about | _figures(runs[name].rows) | _gain(comparison)


def _figures(rows: pd.DataFrame) -> dict[str, Any]:
    solved = rows[rows["status"] == "ok"]
    error = solved[METRIC]
    times = rows[["time_detect_s", "time_match_s", "time_pose_s"]]
    figures: dict[str, Any] = {
        "n": len(rows),
        "n_solved": len(solved),
        "mean_pct_los": error.mean(),
        "median_pct_los": error.median(),
        "max_pct_los": error.max(),
        "n_matches": rows["n_matches"].median(),
        "n_inliers": solved["n_inliers"].median(),
        "inlier_share": (solved["n_inliers"] / solved["n_matches"].clip(lower=1)).mean(),
        "time_all_s": times.sum(axis=1).median(),
    }
    return figures | {str(name): time_s for name, time_s in times.median().items()}


def _gain(comparison: Comparison | None) -> dict[str, Any]:
    if comparison is None:
        return dict.fromkeys(
            ("gain_pct_los", "gain_low", "gain_high", "p", "p_holm", "p_solved"), np.nan
        ) | {"n_paired": 0}
    interval = comparison.mean.interval
    return {
        "gain_pct_los": -comparison.mean.value,
        "gain_low": np.nan if interval is None else -interval.high,
        "gain_high": np.nan if interval is None else -interval.low,
        "p": comparison.p.wilcoxon,
        "p_holm": comparison.p_holm.wilcoxon,
        "p_solved": comparison.p.solved,
        "n_paired": len(comparison.differences.values),
    }
