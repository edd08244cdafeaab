"""All cores in one plot: error against range, and the distribution of the error."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.report.style import (
    CoreStyle,
    drawn_names,
    legend_above,
    new_figure,
    note,
    style_context,
)

N_RANGE_BINS = 10
"""The median line has one point for each of these parts of the range."""
SMALLEST_ERROR_PCT_LOS = 1e-6
"""Smaller errors, 10 nm at 1 m, are drawn here: a logarithmic axis has no place for zero."""
RANGE_LABEL = "range along the line of sight [m]"
ERROR_LABEL = "position error [% of LOS]"


def error_against_range(scores: pd.DataFrame, styles: Mapping[str, CoreStyle]) -> Figure:
    """Draw the position error of every shot against its range, with a median line a core.

    Shots without a pose are crosses along the lower border at their range, one row a core.
    """
    with style_context():
        figure = new_figure(7.2, 4.2)
        axes = figure.add_subplot()
        for core, style in styles.items():
            _draw_points(axes, scores[scores["core"] == core], core, style)
        is_missing = bool((scores["status"] != "ok").any())
        axes.set_xlabel(RANGE_LABEL + (", crosses: no pose" if is_missing else ""))
        _finish(figure, axes, is_empty=not _has_error(scores))
        if _has_error(scores):
            log_axis(axes, "y")
        _draw_missed(axes, scores, styles)
        axes.set_ylabel(ERROR_LABEL)
    return figure


def error_distribution(scores: pd.DataFrame, styles: Mapping[str, CoreStyle]) -> Figure:
    """Draw, for each core, the share of all its answers whose position error is at most x.

    One without a pose counts: the curve of a core that misses some ends below 100 %.
    """
    with style_context():
        figure = new_figure(7.2, 4.0)
        axes = figure.add_subplot()
        for core, style in styles.items():
            _draw_steps(axes, scores[scores["core"] == core], core, style)
        axes.set_ylim(0.0, 104.0)
        axes.set_ylabel("share of all answers [%]")
        _finish(figure, axes, is_empty=not _has_error(scores))
        if _has_error(scores):
            log_axis(axes, "x")
        axes.set_xlabel(ERROR_LABEL)
    return figure


def range_medians(range_m: FloatArray, error: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Give the median error in equal parts of the range.

    Args:
        range_m: Ranges, shape (n,), metres.
        error: Errors at those ranges, shape (n,).

    Returns:
        Mean range and median error of each part that holds a shot, nearest first.
    """
    if not range_m.size:
        return np.empty(0), np.empty(0)
    edges = np.linspace(range_m.min(), range_m.max(), N_RANGE_BINS + 1)
    parts = np.digitize(range_m, edges[1:-1])
    held = np.unique(parts)
    return (
        np.array([range_m[parts == part].mean() for part in held]),
        np.array([np.median(error[parts == part]) for part in held]),
    )


def _draw_points(axes: Axes, rows: pd.DataFrame, core: str, style: CoreStyle) -> None:
    range_m = rows["range_los_m"].to_numpy(dtype=np.float64)
    error = _errors(rows)
    has_error = _is_drawn(rows) & np.isfinite(range_m)
    axes.plot(
        range_m[has_error],
        error[has_error],
        style.marker,
        color=style.colour,
        markersize=3.5,
        alpha=0.45,
        markeredgewidth=0,
    )
    axes.plot(
        *range_medians(range_m[has_error], error[has_error]),
        style.line,
        color=style.colour,
        marker=style.marker,
        markersize=4.5,
        linewidth=1.6,
        label=_label(rows, core),
    )


def _draw_missed(axes: Axes, scores: pd.DataFrame, styles: Mapping[str, CoreStyle]) -> None:
    """Draw a row of crosses for each core that missed a pose, below all errors."""
    missed = scores[(scores["status"] != "ok") & np.isfinite(scores["range_los_m"])]
    cores = [core for core in styles if (missed["core"] == core).any()]
    _, top = axes.get_ylim()
    lowest = axes.transData.inverted().transform(axes.transAxes.transform((0, -0.04 * len(cores))))
    axes.set_ylim(lowest[1], top)
    for i, core in enumerate(cores):
        range_m = missed.loc[missed["core"] == core, "range_los_m"].to_numpy(dtype=np.float64)
        axes.plot(
            range_m,
            np.full(range_m.shape, 0.02 + 0.035 * i),
            "x",
            color=styles[core].colour,
            markersize=5,
            transform=axes.get_xaxis_transform(),
        )


def _draw_steps(axes: Axes, rows: pd.DataFrame, core: str, style: CoreStyle) -> None:
    error = np.sort(_errors(rows)[_is_drawn(rows)])
    share = 100.0 * np.arange(1, error.size + 1) / max(len(rows), 1)
    axes.step(
        np.concatenate([error[:1], error]),
        np.concatenate([np.zeros(error[:1].size), share]),
        where="post",
        linestyle=style.line,
        color=style.colour,
        linewidth=1.6,
        label=_label(rows, core),
    )


def _label(rows: pd.DataFrame, core: str) -> str:
    n_ok = int((rows["status"] == "ok").sum())
    return core if n_ok == len(rows) else f"{core} ({len(rows) - n_ok} of {len(rows)} without pose)"


def _errors(rows: pd.DataFrame) -> FloatArray:
    error = rows["position_error_pct_los"].to_numpy(dtype=np.float64)
    return np.maximum(error, SMALLEST_ERROR_PCT_LOS)


def _is_drawn(rows: pd.DataFrame) -> NDArray[np.bool_]:
    return (rows["status"] == "ok").to_numpy(dtype=np.bool_) & np.isfinite(_errors(rows))


def _has_error(scores: pd.DataFrame) -> bool:
    return bool(_is_drawn(scores).any())


def _finish(figure: Figure, axes: Axes, *, is_empty: bool) -> None:
    axes.grid()
    if is_empty:
        note(axes, "no shot with a pose")
    legend_above(figure, drawn_names(axes))


def log_axis(axes: Axes, which: str, *, dense_until: float = 300.0) -> None:
    """Make the axis ``x`` or ``y`` logarithmic, with plain numbers at it.

    Args:
        axes: Whose; everything is drawn already.
        which: ``x`` or ``y``.
        dense_until: If the largest value is less than this times the smallest, 2 and 5 of each
            decade have numbers as well.
    """
    axis = axes.yaxis if which == "y" else axes.xaxis
    (axes.set_yscale if which == "y" else axes.set_xscale)("log")
    low, high = axis.get_view_interval()
    # Decades alone leave an axis of less than two decades with a single number on it.
    subs = (1.0, 2.0, 5.0) if high / max(low, 1e-300) < dense_until else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
