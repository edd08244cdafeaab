"""Statistics of the scores of each core."""

from typing import TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

METRICS = ("position_error_pct_los", "rotation_error_deg")
"""Columns of the table of scores that ``summary.json`` has statistics of."""

Statistics: TypeAlias = dict[str, float | None]
Summary: TypeAlias = dict[str, dict[str, int | Statistics]]


def statistics(values: ArrayLike) -> Statistics:
    """Give mean, median, rms, max and p95 of the finite values; None each if there are none."""
    v = np.asarray(values, dtype=np.float64)
    v = v[np.isfinite(v)]
    if not len(v):
        return dict.fromkeys(("mean", "median", "rms", "max", "p95"))
    return {
        "mean": float(v.mean()),
        "median": float(np.median(v)),
        "rms": float(np.sqrt((v**2).mean())),
        "max": float(v.max()),
        "p95": float(np.percentile(v, 95)),
    }


def summarise(scores: pd.DataFrame) -> Summary:
    """Give the statistics of each core, in the order of the table.

    Shots without a pose count in ``n_shots``; the statistics are of the others.
    """
    summary: Summary = {}
    for core in scores["core"].unique():
        rows = scores[scores["core"] == core]
        solved = rows[rows["status"] == "ok"]
        summary[str(core)] = {
            "n_shots": len(rows),
            "n_ok": len(solved),
            **{metric: statistics(solved[metric]) for metric in METRICS},
        }
    return summary
