"""Pictures of what limits accuracy: errors beside bound and truth, and what they are made of."""

from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tronlab.report.curves import log_axis
from tronlab.report.study.ablation_charts import KIND_COLOURS
from tronlab.report.style import (
    core_styles,
    drawn_names,
    legend_above,
    new_figure,
    note,
    style_context,
)
from tronlab.score.evaluation.ablation import PARTS, TOGETHER

PART_COLOURS = {**KIND_COLOURS, "view": "#4393c3", "estimator": "#b2182b", "rest": "#bbbbbb"}
PART_TITLES = {
    "terrain": "terrain model",
    "light": "light",
    "camera": "camera",
    "truth": "truth",
    "view": "view geometry",
    "estimator": "estimator",
    "rest": "not explained",
}
_SHOWN_PCT = (-100.0, 200.0)
_WIDTH_IN, _ROW_IN, _MARGIN_IN = 7.2, 0.24, 1.2


def limits_chart(limits: pd.DataFrame) -> Figure:
    """Draw median error, bound and sigma of the truth of each core on each dataset.

    Points are errors, a colour a core; the bar beside is the Cramer-Rao bound of the same shots,
    the cross one sigma of the truth, the open circle both together.

    Args:
        limits: As ``limits_table`` gives it.
    """
    datasets = list(dict.fromkeys(map(str, limits["dataset"])))
    styles = core_styles(list(dict.fromkeys(map(str, limits["core"]))))
    with style_context():
        figure = new_figure(_WIDTH_IN, _MARGIN_IN + _ROW_IN * max(len(limits), 4))
        axes = figure.add_subplot()
        y = 0.0
        ticks: dict[str, float] = {}
        for dataset in datasets:
            own = limits[limits["dataset"] == dataset]
            ticks[dataset] = y + (len(own) - 1) / 2
            for row in own.to_dict("records"):
                _draw_limits(axes, row, y, styles[str(row["core"])].colour, str(row["core"]))
                y += 1.0
            y += 1.0
        if not len(limits):
            note(axes, "nothing was scored")
            return figure
        _draw_meanings(axes)
        axes.set_yticks(list(ticks.values()), list(ticks))
        axes.invert_yaxis()
        axes.grid(axis="x")
        log_axis(axes, "x")
        axes.set_xlabel("median over the shots [% of LOS]")
        legend_above(figure, drawn_names(axes))
    return figure


def shares_chart(shares: pd.DataFrame) -> Figure:
    """Draw what makes the typical error of each core: stacked shares of its square.

    Shares below zero, where sources cancel each other, are drawn to the left of zero. Where parts
    do not add up at all, bars are cut off at the border: the table has the numbers.

    Args:
        shares: As ``shares_table`` gives it.
    """
    whole = shares.sort_values("dataset", key=lambda names: names == TOGETHER, kind="stable")
    labels = list(dict.fromkeys(zip(whole["dataset"], whole["core"], strict=True)))
    with style_context():
        figure = new_figure(_WIDTH_IN, _MARGIN_IN + _ROW_IN * max(len(labels), 4))
        axes = figure.add_subplot()
        known = whole.pivot_table(index=["dataset", "core"], columns="part", values="share")
        if known.empty:
            note(axes, "the ablation did not look at single kinds of sources")
            return figure
        known = known.reindex(index=labels)
        _draw_stacks(axes, 100.0 * known.reindex(columns=list(PARTS)).to_numpy(np.float64))
        axes.set_yticks(range(len(labels)), [f"{dataset}, {core}" for dataset, core in labels])
        axes.invert_yaxis()
        axes.axvline(0.0, color="black", linewidth=0.8)
        axes.axvline(100.0, color="black", linewidth=0.8, linestyle=":")
        left, right = axes.get_xlim()
        axes.set_xlim(max(left, _SHOWN_PCT[0]), min(right, _SHOWN_PCT[1]))
        axes.set_xlabel("share of the square of the median error [%]; bars at the border go on")
        legend_above(figure, drawn_names(axes))
    return figure


def _draw_limits(axes: Axes, row: Mapping[Hashable, Any], y: float, colour: str, core: str) -> None:
    error, bound, truth = (
        float(row[name]) for name in ("median_pct_los", "bound_pct_los", "truth_sigma_pct_los")
    )
    axes.plot([bound, error], [y, y], color=colour, linewidth=1.0, alpha=0.5)
    axes.plot(bound, y, "|", color=colour, markersize=9, markeredgewidth=1.8)
    axes.plot(truth, y, "x", color="black", markersize=4)
    axes.plot(float(row["floor_pct_los"]), y, "o", color=colour, markersize=5, fillstyle="none")
    axes.plot(error, y, "o", color=colour, markersize=5, label=core)


def _draw_meanings(axes: Axes) -> None:
    """Name the marks in the legend, drawn nowhere else."""
    axes.plot([], [], "o", color="#7f7f7f", label="error")
    axes.plot([], [], "|", color="#7f7f7f", markersize=9, markeredgewidth=1.8, label="bound")
    axes.plot([], [], "x", color="black", markersize=4, label="sigma of the truth")
    both = "bound and truth together"
    axes.plot([], [], "o", color="#7f7f7f", markersize=5, fillstyle="none", label=both)


def _draw_stacks(axes: Axes, shares_pct: np.ndarray) -> None:
    y = np.arange(len(shares_pct))
    above, below = np.zeros(len(y)), np.zeros(len(y))
    for part, column in zip(PARTS, np.nan_to_num(shares_pct.T), strict=True):
        left = np.where(column >= 0.0, above, below)
        axes.barh(y, column, 0.75, left=left, color=PART_COLOURS[part], label=PART_TITLES[part])
        above += np.maximum(column, 0.0)
        below += np.minimum(column, 0.0)
