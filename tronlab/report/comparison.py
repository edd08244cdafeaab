"""A comparison as tables and pictures."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tronlab.errors import ScoreError
from tronlab.geometry.poses import FloatArray
from tronlab.report.curves import RANGE_LABEL
from tronlab.report.style import new_figure, note, save_chart, slug_of, style_context
from tronlab.score.evaluation.compare import Comparison, Tolerance, regressions
from tronlab.score.evaluation.export import (
    Cell,
    Column,
    Table,
    TableFormat,
    check_formats,
    frame_table,
    write_tables,
)
from tronlab.score.evaluation.resampling import Estimate

_WORSE, _BETTER, _SAME = "#c62828", "#00795c", "#666666"
_N_BINS = 30
_METRIC_LABELS = {
    "position_error_pct_los": "position error [% of LOS]",
    "position_error_m": "position error [m]",
    "rotation_error_deg": "rotation error [deg]",
    "time_detect_s": "time to detect [s]",
    "time_match_s": "time to match [s]",
    "time_pose_s": "time for the pose [s]",
}


def comparison_table(comparisons: Sequence[Comparison], tolerance: Tolerance) -> Table:
    """Give one row a comparison."""
    columns = (
        Column("base", "base"),
        Column("base_core", "core"),
        Column("other", "other"),
        Column("other_core", "core"),
        Column("metric", "metric"),
        Column("n_shots", "shots"),
        Column("n_pairs", "pairs"),
        Column("base_mean", "base mean", ".3g"),
        Column("other_mean", "other mean", ".3g"),
        Column("mean_difference", "difference of means", ".3g", is_estimate=True),
        Column("median_difference", "difference of medians", ".3g", is_estimate=True),
        Column("n_better", "better"),
        Column("n_same", "same"),
        Column("n_worse", "worse"),
        Column("p_wilcoxon", "p signed rank", ".2g"),
        Column("p_wilcoxon_holm", "p Holm", ".2g"),
        Column("p_sign", "p sign", ".2g"),
        Column("p_sign_holm", "p Holm", ".2g"),
        Column("n_ok_base", "poses, base"),
        Column("n_ok_other", "poses, other"),
        Column("n_base_only", "base only"),
        Column("n_other_only", "other only"),
        Column("p_solved", "p McNemar", ".2g"),
        Column("p_solved_holm", "p Holm", ".2g"),
        Column("worse_than_allowed", "worse than allowed"),
    )
    rows = tuple(_row(comparison, tolerance) for comparison in comparisons)
    return Table("comparison", "Other minus base: above zero is worse", columns, rows)


def differences_table(comparisons: Sequence[Comparison]) -> Table:
    """Give each pair of values of each comparison."""
    frames = [
        pd.DataFrame(
            {
                "pair": comparison.pair.name,
                "metric": comparison.metric,
                "shot_id": comparison.differences.shot_ids,
                "range_los_m": comparison.differences.range_los_m,
                "base": comparison.differences.base,
                "other": comparison.differences.other,
                "difference": comparison.differences.values,
            }
        )
        for comparison in comparisons
    ]
    every = pd.concat(frames, ignore_index=True)
    return frame_table("differences", "Every shot that both runs solved", every)


def difference_chart(comparison: Comparison) -> Figure:
    """Draw the paired differences against range, and their distribution beside it.

    Blue line and band: the difference of the means and its interval.
    """
    differences, solved = comparison.differences, comparison.solved
    values = differences.values
    with style_context():
        figure = new_figure(7.2, 3.8)
        figure.suptitle(comparison.pair.name, fontsize=10)
        grid = figure.add_gridspec(1, 2, width_ratios=(3, 1))
        left = figure.add_subplot(grid[0])
        right = figure.add_subplot(grid[1], sharey=left)
        left.set_xlabel(RANGE_LABEL)
        left.set_ylabel(f"{_METRIC_LABELS[comparison.metric]}:\nother minus base")
        right.set_xlabel("shots")
        right.tick_params(labelleft=False)
        text = (
            f"{comparison.n_better} better, {comparison.n_same} same, {comparison.n_worse} worse;"
            f" solved by base only {solved.n_base_only}, by other only {solved.n_other_only}"
        )
        left.set_title(text, loc="left", fontsize=8, color="#444444")
        if values.size:
            _draw_points(left, differences.range_los_m, values)
            _draw_histogram(right, values)
        else:
            note(left, "no shot was solved by both")
        for axes in (left, right):
            axes.grid(axis="y")
            axes.axhline(0.0, color="black", linewidth=0.9)
            _draw_mean(axes, comparison.mean)
    return figure


def write_comparison(
    directory: Path,
    comparisons: Sequence[Comparison],
    tolerance: Tolerance,
    *,
    formats: Sequence[TableFormat],
    announce: Callable[[str], None],
) -> None:
    """Write the tables and a picture of each comparison into a folder, which is made.

    Files of the same name are replaced once all are made. Pictures are numbered as the rows of the
    table.

    Raises:
        ScoreError: It cannot be written to, or a package that a format needs is not installed.
    """
    check_formats(formats)
    tables = [comparison_table(comparisons, tolerance), differences_table(comparisons)]
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".compare-", dir=directory) as staging:
            write_tables(Path(staging), tables, formats)
            for i, comparison in enumerate(comparisons, start=1):
                stem = f"difference_{i:02d}_{_slug(comparison)}"
                save_chart(difference_chart(comparison), Path(staging), stem)
                announce(f"drawn: {directory / stem}.png")
            for path in sorted(Path(staging).iterdir()):
                os.replace(path, directory / path.name)
    except OSError as error:
        raise ScoreError(f"{directory}: the comparison cannot be written: {error}") from error


def _slug(comparison: Comparison) -> str:
    pair = comparison.pair
    is_same_core = pair.base.core == pair.other.core
    told_by = Path(pair.other.folder).name if is_same_core else pair.other.core
    return slug_of(f"{comparison.metric}_{pair.base.core}_{told_by}")


def _row(comparison: Comparison, tolerance: Tolerance) -> tuple[Cell, ...]:
    pair, solved, differences = comparison.pair, comparison.solved, comparison.differences
    p, p_holm = comparison.p, comparison.p_holm
    return (
        pair.base.folder,
        pair.base.core,
        pair.other.folder,
        pair.other.core,
        comparison.metric,
        solved.n_shots,
        len(differences.base),
        _mean(differences.base),
        _mean(differences.other),
        comparison.mean,
        comparison.median,
        comparison.n_better,
        comparison.n_same,
        comparison.n_worse,
        p.wilcoxon,
        p_holm.wilcoxon,
        p.sign,
        p_holm.sign,
        solved.n_base,
        solved.n_other,
        solved.n_base_only,
        solved.n_other_only,
        p.solved,
        p_holm.solved,
        "; ".join(regressions(comparison, tolerance)) or "no",
    )


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if values.size else np.nan


def _draw_points(axes: Axes, range_m: FloatArray, values: FloatArray) -> None:
    for which, colour in ((values > 0, _WORSE), (values < 0, _BETTER), (values == 0, _SAME)):
        axes.plot(range_m[which], values[which], "o", color=colour, markersize=3.5, alpha=0.6)


def _draw_histogram(axes: Axes, values: FloatArray) -> None:
    edges = np.histogram_bin_edges(values, _N_BINS)
    counts, _ = np.histogram(values, edges)
    centres = (edges[:-1] + edges[1:]) / 2.0
    colours = np.where(centres > 0.0, _WORSE, _BETTER).tolist()
    axes.barh(centres, counts, np.diff(edges), color=colours, edgecolor="white", linewidth=0.3)


def _draw_mean(axes: Axes, mean: Estimate) -> None:
    if np.isfinite(mean.value):
        axes.axhline(mean.value, color="#0072b2", linewidth=1.1)
    if mean.interval is not None:
        axes.axhspan(mean.interval.low, mean.interval.high, color="#0072b2", alpha=0.2, zorder=0)
