"""Pictures of what all shots of a core amount to: parts of the range, recall, consistency."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tronlab.geometry.poses import FloatArray
from tronlab.report.curves import ERROR_LABEL, SMALLEST_ERROR_PCT_LOS, log_axis
from tronlab.report.style import (
    CoreStyle,
    drawn_names,
    legend_above,
    new_figure,
    note,
    style_context,
)
from tronlab.score.evaluation.bins import BINNED_BY, Bin
from tronlab.score.evaluation.consistency import N_SIGMA_TRUTH, nees_quantiles
from tronlab.score.evaluation.recall import Threshold, recall

TRUTH_LABEL = "error / sigma of truth"
NEES_LABEL = "NEES"
_BOX_WIDTH = 0.8
"""Of all boxes of a bin together; bins are 1 apart."""


def error_boxes(
    scores: pd.DataFrame,
    styles: Mapping[str, CoreStyle],
    column: str,
    bins: Sequence[Bin],
    *,
    label: str = "",
    counted: str = "shot",
) -> Figure:
    """Draw the position error of each core in each part of the shots as a box.

    Box: quartiles and median. Whiskers: 5th and 95th percentile; all beyond are points. Below each
    bin stands how many shots it holds.

    Args:
        scores: Rows of ``scores.csv``.
        styles: Of each core.
        column: What the shots are parted by.
        bins: The parts.
        label: What people call the column; needed unless it is one of ``BINNED_BY``.
        counted: What people call the things that ``shot_id`` numbers, in the singular.
    """
    width = _BOX_WIDTH / max(len(styles), 1)
    with style_context():
        figure = new_figure(7.2, 4.0)
        axes = figure.add_subplot()
        for i, (core, style) in enumerate(styles.items()):
            rows = scores[(scores["core"] == core) & (scores["status"] == "ok")]
            at = np.arange(len(bins), dtype=np.float64) + (i - (len(styles) - 1) / 2) * width
            _draw_boxes(axes, [_errors_in(rows, column, b) for b in bins], at, width, style)
            axes.plot([], [], "s", color=style.colour, label=core)
        axes.set_xticks(range(len(bins)), [_bin_label(scores, column, b, counted) for b in bins])
        axes.set_xlim(-0.5, len(bins) - 0.5)
        axes.set_xlabel(label or BINNED_BY[column])
        axes.set_ylabel(ERROR_LABEL)
        axes.grid(axis="y")
        if (scores["status"] == "ok").any():
            log_axis(axes, "y")
        else:
            note(axes, "no shot with a pose")
        legend_above(figure, drawn_names(axes))
    return figure


def recall_curve(
    scores: pd.DataFrame, styles: Mapping[str, CoreStyle], thresholds: Sequence[Threshold]
) -> Figure:
    """Draw the share of all answers within position and rotation thresholds that grow together.

    Args:
        scores: Rows of ``scores.csv``.
        styles: Of each core.
        thresholds: Drawn as points with their intervals. The curve is of thresholds with the
            rotation a position in the proportion of the last of them; points of another proportion
            do not lie on it.
    """
    deg_per_pct = thresholds[-1].rotation_deg / thresholds[-1].position_pct_los
    with style_context():
        figure = new_figure(7.2, 4.0)
        axes = figure.add_subplot()
        for i, (core, style) in enumerate(styles.items()):
            rows = scores[scores["core"] == core]
            _draw_recall(axes, rows, style, deg_per_pct, until=thresholds[-1].position_pct_los)
            _draw_recall_points(axes, rows, style, thresholds, shift=1.0 + 0.03 * i)
        log_axis(axes, "x")
        axes.set_ylim(0.0, 104.0)
        axes.grid()
        axes.set_ylabel("share of all answers within both [%]")
        axes.set_xlabel(f"threshold: x % of LOS and {deg_per_pct:.3g} x deg")
        legend_above(figure, drawn_names(axes))
    return figure


def consistency_chart(scores: pd.DataFrame, styles: Mapping[str, CoreStyle]) -> Figure:
    """Draw distributions of error over the truth's sigma, error over the bound, and NEES.

    Dotted: where the truth may be the limit. Dashed: the NEES of covariances that are honest.
    """
    with style_context():
        figure = new_figure(7.2, 3.4)
        panels = figure.subplots(1, 3, sharey=True)
        solved = scores[scores["status"] == "ok"]
        error_m = solved["position_error_m"]
        quantities = (
            (error_m / solved["sigma_truth_m"], TRUTH_LABEL, "no sigma is known"),
            (error_m / solved["bound_m"], "error / bound", "no core gives a bound"),
            (solved["nees"], NEES_LABEL, "no core gives a covariance"),
        )
        for axes, (values, label, missing) in zip(panels, quantities, strict=True):
            for core, style in styles.items():
                _draw_steps(axes, values[solved["core"] == core], style, core)
            axes.set_xlabel(label)
            axes.grid()
            axes.set_ylim(0.0, 104.0)
            if np.isfinite(values).any():
                _draw_reference(axes, label)
                log_axis(axes, "x", dense_until=30.0)
            else:
                note(axes, missing)
        panels[0].set_ylabel("share of answers with a pose [%]")
        named = {name: line for axes in panels for name, line in drawn_names(axes).items()}
        legend_above(figure, named)
    return figure


def _draw_boxes(
    axes: Axes, errors: Sequence[FloatArray], at: FloatArray, width: float, style: CoreStyle
) -> None:
    held = [i for i, values in enumerate(errors) if values.size]
    if not held:
        return
    line = {"color": style.colour, "linewidth": 1.1}
    axes.boxplot(
        [errors[i] for i in held],
        positions=at[held],
        widths=0.8 * width,
        whis=(5, 95),
        patch_artist=True,
        manage_ticks=False,
        boxprops={"facecolor": style.colour, "alpha": 0.35, "edgecolor": style.colour},
        medianprops={"color": "black", "linewidth": 1.2},
        whiskerprops=line,
        capprops=line,
        flierprops={
            "marker": style.marker,
            "markersize": 2.5,
            "markerfacecolor": style.colour,
            "markeredgewidth": 0,
        },
    )


def _errors_in(rows: pd.DataFrame, column: str, bin_: Bin) -> FloatArray:
    errors = rows["position_error_pct_los"].to_numpy(np.float64)
    errors = errors[bin_.holds(rows[column].to_numpy(np.float64)) & np.isfinite(errors)]
    return np.maximum(errors, SMALLEST_ERROR_PCT_LOS)


def _bin_label(scores: pd.DataFrame, column: str, bin_: Bin, counted: str) -> str:
    values = scores.drop_duplicates("shot_id")[column].to_numpy(np.float64)
    n_held = int(bin_.holds(values).sum())
    return f"{bin_.text}\n{n_held} {counted}{'' if n_held == 1 else 's'}"


def _draw_recall(
    axes: Axes, rows: pd.DataFrame, style: CoreStyle, deg_per_pct: float, *, until: float
) -> None:
    """Draw the curve, at least to ``until``: an answer is within from its larger error on."""
    solved = rows[rows["status"] == "ok"]
    position = solved["position_error_pct_los"].to_numpy(np.float64)
    rotation = solved["rotation_error_deg"].to_numpy(np.float64)
    needed = np.sort(np.maximum(position, rotation / deg_per_pct))
    needed = np.maximum(needed[np.isfinite(needed)], SMALLEST_ERROR_PCT_LOS)
    n_within = np.arange(1, needed.size + 1)
    if needed.size and needed[-1] < until:
        needed, n_within = np.append(needed, until), np.append(n_within, n_within[-1])
    axes.step(
        needed,
        100.0 * n_within / max(len(rows), 1),
        where="post",
        linestyle=style.line,
        color=style.colour,
        linewidth=1.6,
        label=str(rows["core"].iloc[0]),
    )


def _draw_recall_points(
    axes: Axes,
    rows: pd.DataFrame,
    style: CoreStyle,
    thresholds: Sequence[Threshold],
    *,
    shift: float,
) -> None:
    """Draw the shares at the thresholds, cores a little apart."""
    shares = recall(rows, thresholds)
    value = 100.0 * np.array([share.value for share in shares])
    low = 100.0 * np.array([share.interval.low for share in shares])
    high = 100.0 * np.array([share.interval.high for share in shares])
    axes.errorbar(
        [shift * t.position_pct_los for t in thresholds],
        value,
        yerr=[np.maximum(value - low, 0.0), np.maximum(high - value, 0.0)],
        fmt=style.marker,
        color=style.colour,
        markersize=4,
        capsize=2.5,
        linewidth=1.0,
    )


def _draw_steps(axes: Axes, values: "pd.Series[float]", style: CoreStyle, core: str) -> None:
    found = np.sort(np.asarray(values, dtype=np.float64))
    found = found[np.isfinite(found) & (found > 0.0)]
    if found.size:
        share = 100.0 * np.arange(1, found.size + 1) / found.size
        axes.step(
            found,
            share,
            where="post",
            linestyle=style.line,
            color=style.colour,
            linewidth=1.6,
            label=core,
        )


def _draw_reference(axes: Axes, label: str) -> None:
    """Draw where the truth may be the limit, or the distribution of honest NEES."""
    if label == TRUTH_LABEL:
        axes.axvline(N_SIGMA_TRUTH, color="black", linewidth=1.0, linestyle=":")
    elif label == NEES_LABEL:
        share = np.linspace(0.01, 0.999, 200)
        axes.plot(nees_quantiles(share), 100.0 * share, "k--", linewidth=1.0)
