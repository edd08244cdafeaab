"""The error budget as a picture: what contributes how much, against range."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tronlab.calib.budget import CONTRIBUTIONS, Budget
from tronlab.geometry.poses import FloatArray
from tronlab.report.style import new_figure, style_context

COLOURS = ("#56b4e9", "#0072b2", "#e69f00", "#009e73")
"""One a contribution, in the order of ``CONTRIBUTIONS``; Okabe and Ito, 2008."""
_BESIDE_COLOURS = ("#cc79a7", "#7f7f7f")
_SAME_RANGE = 0.01
"""Ranges that differ by less than this part of them are no axis to draw against."""


def budget_chart(budget: Budget) -> Figure:
    """Draw one sigma of each contribution, and its share of the variance, against range.

    Poses are drawn in the order of their range; where all have the same, by their number.
    """
    x, label, order = _axis(budget.range_los_m)
    rows = (
        ("camera centre [mm]", 1e3 * budget.position_m),
        ("camera rotation [mdeg]", np.degrees(1e3) * budget.rotation_rad),
        ("landmarks in the image [px]", budget.image_px),
    )
    with style_context():
        figure = new_figure(8.4, 7.6)
        figure.suptitle("What camera poses are uncertain by, one sigma", fontsize=10)
        panels = figure.subplots(3, 2, sharex=True, width_ratios=(1.25, 1.0))
        for (curves, shares), (title, parts) in zip(panels, rows, strict=True):
            _draw_curves(curves, x, parts[order], title)
            _draw_shares(shares, x, parts[order])
        _draw_beside(panels[2, 0], x, budget, order)
        for axes in panels[2]:
            axes.set_xlabel(label)
        handles, labels = panels[2, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8)
    return figure


def _axis(range_m: FloatArray) -> tuple[FloatArray, str, NDArray[np.intp]]:
    if len(range_m) == 1 or np.ptp(range_m) < _SAME_RANGE * range_m.mean():
        numbers = np.arange(1.0, len(range_m) + 1.0)
        label = f"number of the pose, all at {range_m.mean():.2f} m"
        return numbers, label, np.arange(len(range_m), dtype=np.intp)
    order = np.argsort(range_m, kind="stable")
    return range_m[order], "range along the line of sight [m]", order


def _draw_curves(axes: Axes, x: FloatArray, parts: FloatArray, title: str) -> None:
    marker = "o" if len(x) == 1 else ""
    for name, colour, values in zip(CONTRIBUTIONS, COLOURS, parts.T, strict=True):
        axes.plot(x, values, color=colour, linewidth=1.6, marker=marker, label=name)
    total = np.sqrt((parts**2).sum(axis=1))
    axes.plot(x, total, color="black", linewidth=1.8, marker=marker, label="all of them")
    axes.set_ylabel(title)
    axes.set_ylim(bottom=0.0)
    axes.grid()


def _draw_shares(axes: Axes, x: FloatArray, parts: FloatArray) -> None:
    shares = 100 * parts**2 / (parts**2).sum(axis=1, keepdims=True)
    if len(x) == 1:
        edges = np.concatenate([[0.0], np.cumsum(shares[0])])
        axes.bar(np.full(4, x[0]), shares[0], bottom=edges[:-1], color=COLOURS, width=0.4)
    else:
        axes.stackplot(x, shares.T, colors=COLOURS, linewidth=0)
        axes.set_xlim(x[0], x[-1])
    axes.set_ylim(0.0, 100.0)
    axes.set_ylabel("share of the variance [%]")


def _draw_beside(axes: Axes, x: FloatArray, budget: Budget, order: NDArray[np.intp]) -> None:
    """Draw what moves landmarks though the pose is right."""
    for name, colour, values in zip(
        ("beside it: intrinsics", "beside it: shadows, by the lamp"),
        _BESIDE_COLOURS,
        (budget.intrinsics_px, budget.shadow_px),
        strict=True,
    ):
        if np.isfinite(values).all():
            marker = "o" if len(x) == 1 else ""
            axes.plot(x, values[order], "--", color=colour, marker=marker, label=name)
