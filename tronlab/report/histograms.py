"""Error histograms of one core, laid out as figures 8 to 17 of the paper."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tronlab.geometry.poses import FloatArray
from tronlab.report.style import AXIS_COLOURS, NORM_COLOUR, new_figure, note, style_context

N_BINS = 20
"""About as many bins as a histogram gets; the edges are round numbers."""
FENCE_MEDIANS = 8.0
"""Errors beyond this many medians get no bins; of Gaussian errors that is one in ten million."""
_ROUND_STEPS = [1, 2, 2.5, 5, 10]
_MARGIN_BINS = 2
"""Room, in bins, for the bar that counts gross errors; half a bin away from the others."""


def error_histograms(
    scores: pd.DataFrame, core: str, *, has_angles: bool = True, of: str = ""
) -> Figure:
    """Draw the error histograms of a core.

    Top: norm of the position error, grey. Middle: position error along x, y, z of trs. Bottom:
    angle between the true and the estimated camera axis x, y, z. Position errors are percent of
    the line-of-sight range; the three panels of a row share their bins. Gross errors, which would
    squeeze all others into one bin, are counted in one hatched bar at the edge.

    Args:
        scores: Rows of ``scores.csv``, one a shot and core.
        core: Which core to draw.
        has_angles: Whether to draw the bottom row: figures 8 and 9 of the paper have it, 10 to 17
            do not.
        of: What the shots are of, for the title; empty if the page says so.
    """
    rows = scores[scores["core"] == core]
    solved = rows[rows["status"] == "ok"]
    with style_context():
        figure = new_figure(7.2, 6.6 if has_angles else 4.5)
        named = f"{core}, {of}" if of else core
        figure.suptitle(f"{named}: {pose_count_text(rows)}", fontsize=10)
        grid = figure.add_gridspec(3 if has_angles else 2, 3)
        norm = figure.add_subplot(grid[0, :])
        errors = _values(solved["position_error_pct_los"])
        _draw_row([norm], [errors], [NORM_COLOUR])
        norm.set_xlabel("norm of position error [% of LOS]")
        norm.set_ylabel("shots")
        if errors.size:
            norm.legend(fontsize=8, loc="upper right")
        position = [position_error_pct_los(solved, axis) for axis in "xyz"]
        labels = [f"error along {axis} of trs [% of LOS]" for axis in "xyz"]
        _draw_axes([figure.add_subplot(grid[1, i]) for i in range(3)], position, labels)
        if has_angles:
            angle = [_values(solved[f"axis_error_{axis}_deg"]) for axis in "xyz"]
            labels = [f"error of camera axis {axis} [deg]" for axis in "xyz"]
            panels = [figure.add_subplot(grid[2, i]) for i in range(3)]
            _draw_axes(panels, angle, labels, is_signed=False)
    return figure


def position_error_pct_los(scores: pd.DataFrame, axis: str) -> FloatArray:
    """Give the position error along one axis of trs, percent of the range, finite values only."""
    return _values(100.0 * scores[f"error_trs_{axis}_m"] / scores["range_los_m"])


def pose_count_text(rows: pd.DataFrame) -> str:
    """Say how many shots of one core have a pose, and why the others have none.

    With several seeds a shot has as many answers.
    """
    n_ok = int((rows["status"] == "ok").sum())
    what = "shots" if rows["shot_id"].is_unique else "answers"
    text = f"{n_ok} of {len(rows)} {what} with a pose"
    missing = Counter(str(status) for status in rows["status"] if status != "ok")
    if missing:
        reasons = ", ".join(f"{n} {status}" for status, n in sorted(missing.items()))
        text += f"; without: {reasons}"
    return text


def bin_edges(values: FloatArray, *, is_signed: bool = False) -> FloatArray:
    """Give round bin edges that hold all values.

    Args:
        values: Finite values, shape (n,).
        is_signed: Whether the values scatter about zero; otherwise the bins begin at zero.
    """
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    if is_signed:
        low, high = min(low, 0.0), max(high, 0.0)
    else:
        low = 0.0
    if high <= low:
        high = low + 1.0
    locator = MaxNLocator(nbins=N_BINS, steps=_ROUND_STEPS)
    edges = np.asarray(locator.tick_values(low, high), dtype=np.float64)
    step = float(edges[1] - edges[0])
    # A value on the last edge would share its bin with smaller ones; one more bin keeps it apart.
    return np.append(edges, edges[-1] + step) if edges[-1] <= high else edges


def fence(panels: Sequence[FloatArray]) -> float:
    """Give the magnitude beyond which an error is a gross one, in panels that share their bins.

    It follows the panel that scatters most; infinite if most errors are zero or there are none.
    """
    medians = [float(np.median(np.abs(values))) for values in panels if values.size]
    return FENCE_MEDIANS * max(medians, default=0.0) or np.inf


def _draw_axes(
    panels: list[Axes], values: list[FloatArray], labels: Sequence[str], *, is_signed: bool = True
) -> None:
    """Draw what belongs to x, y and z side by side, red, green and blue."""
    _draw_row(panels, values, list(AXIS_COLOURS.values()), is_signed=is_signed)
    for panel, label in zip(panels, labels, strict=True):
        panel.set_xlabel(label)
    panels[0].set_ylabel("shots")


def _draw_row(
    panels: list[Axes], values: list[FloatArray], colours: list[str], *, is_signed: bool = False
) -> None:
    pooled = np.concatenate(values)
    edges = bin_edges(pooled[np.abs(pooled) <= fence(values)], is_signed=is_signed)
    step = edges[1] - edges[0]
    left = edges[0] - _MARGIN_BINS * step * bool((pooled < edges[0]).any())
    right = edges[-1] + _MARGIN_BINS * step * bool((pooled > edges[-1]).any())
    for panel, panel_values, colour in zip(panels, values, colours, strict=True):
        _draw_histogram(panel, panel_values, edges, colour)
        panel.set_xlim(left, right)
        ticks = MaxNLocator(nbins=5, steps=_ROUND_STEPS).tick_values(edges[0], edges[-1])
        panel.set_xticks(ticks[(ticks >= edges[0] - step / 9) & (ticks <= edges[-1] + step / 9)])
    tallest = max(panel.get_ylim()[1] for panel in panels)
    for panel in panels:
        panel.set_ylim(0.0, tallest)
    for panel in panels[1:]:
        panel.tick_params(labelleft=False)


def _draw_histogram(panel: Axes, values: FloatArray, edges: FloatArray, colour: str) -> None:
    panel.yaxis.set_major_locator(MaxNLocator(nbins=5, integer=True, min_n_ticks=2))
    panel.grid(axis="y")
    if not values.size:
        note(panel, "no shot with a pose")
        return
    look: dict[str, Any] = {"color": colour, "edgecolor": "white", "linewidth": 0.4}
    counts, _ = np.histogram(values, edges)
    panel.bar(edges[:-1], counts, np.diff(edges), align="edge", **look)
    step = edges[1] - edges[0]
    for at, n in (
        (edges[0] - step, int((values < edges[0]).sum())),
        (edges[-1] + step, int((values > edges[-1]).sum())),
    ):
        if n:
            panel.bar(at, n, step, hatch="////", **look)
    mean, median = float(np.mean(values)), float(np.median(values))
    for value, name, linestyle in ((mean, "mean", "-"), (median, "median", ":")):
        # Beyond the bins there is no scale.
        if edges[0] <= value <= edges[-1]:
            panel.axvline(value, color="black", linewidth=1.1, linestyle=linestyle, label=name)
    text = f"mean {mean:.2g}, median {median:.2g}\n{_count_text(values, edges)}"
    panel.set_title(text, loc="left", color="#444444", fontsize=7.5)


def _count_text(values: FloatArray, edges: FloatArray) -> str:
    n_outside = int(((values < edges[0]) | (values > edges[-1])).sum())
    text = f"n = {values.size}"
    if not n_outside:
        return text
    low, high = f"{edges[0]:.3g}", f"{edges[-1]:.3g}"
    where = f"beyond {high}" if low == "0" else f"outside {low} to {high}"
    return f"{text}, {n_outside} {where}"


def _values(column: "pd.Series[float]") -> FloatArray:
    values = np.asarray(column, dtype=np.float64)
    return values[np.isfinite(values)]
