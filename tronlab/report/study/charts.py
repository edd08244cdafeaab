"""Charts of a study: figures 18 and 19 of the paper, the larger terrain, selection, load."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tronlab.geometry.poses import FloatArray
from tronlab.report.curves import ERROR_LABEL, SMALLEST_ERROR_PCT_LOS, log_axis
from tronlab.report.paper import DATASETS
from tronlab.report.study.results import select
from tronlab.report.style import (
    CoreStyle,
    drawn_names,
    legend_above,
    new_figure,
    note,
    style_context,
)
from tronlab.score.evaluation.compare import Comparison

_DATASET_MARKERS = {
    "dataset_0": "^",
    "dataset_1_nominal": "o",
    "dataset_1_perturbed": ".",
    "dataset_2_nominal": "s",
    "dataset_2_perturbed": "x",
}
ALL_DATASETS = "all"
"""Stands in ``selection.csv`` for the shots of all datasets together."""
NO_RANK = pd.DataFrame(columns=["dataset", "core", "measure"])
"""Stands for a table of rank correlations that there is not."""
_SMALLEST_ROTATION_DEG = 1e-6
_TITLE_LETTERS, _TITLE_IN, _VARIANT_IN = 44, 3.2, 0.36
"""Letters in a line of a variant's title, and room for it."""
_ZERO_COLOUR = "#333333"


@dataclass(frozen=True, slots=True)
class Measure:
    """One way to say how far a shot is off the nominal trajectory."""

    column: str
    """Of ``perturbation.csv``; ``measure`` of ``rank.csv``."""
    label: str


def position_over_rotation(scores: pd.DataFrame, styles: Mapping[str, CoreStyle]) -> Figure:
    """Draw position error against rotation error of every pose, as figure 18 of the paper.

    Args:
        scores: Of all datasets, with the column ``dataset``.
        styles: Of the cores that are drawn.
    """
    solved = scores[(scores["status"] == "ok") & scores["core"].isin(list(styles))]
    with style_context():
        figure = new_figure(6.4, 4.4)
        axes = figure.add_subplot()
        for (core, dataset), rows in solved.groupby(["core", "dataset"], sort=False):
            rotation = rows["rotation_error_deg"].to_numpy(np.float64)
            _draw_cloud(
                axes,
                np.maximum(rotation, _SMALLEST_ROTATION_DEG),
                _errors(rows),
                styles[str(core)],
                str(dataset),
                label=_named(core, dataset),
            )
        axes.grid()
        axes.set_xlabel("orientation error [deg]")
        axes.set_ylabel("norm of position error [% of LOS]")
        if solved.empty:
            note(axes, "no shot with a pose")
        else:
            log_axis(axes, "x")
            log_axis(axes, "y")
        legend_above(figure, drawn_names(axes))
    return figure


def error_over_perturbation(
    perturbation: pd.DataFrame,
    rank: pd.DataFrame,
    styles: Mapping[str, CoreStyle],
    measures: Sequence[Measure],
) -> Figure:
    """Draw the position error against measures of the perturbation, as figure 19 of the paper.

    Below each panel stands Spearman's rank correlation of each dataset and core, with its 95 %
    interval and the probability of one as large by chance.

    Args:
        perturbation: Rows of ``perturbation.csv``.
        rank: Rows of ``rank.csv``.
        styles: Of the cores that are drawn.
        measures: One panel each, left to right.
    """
    rows = perturbation[perturbation["core"].isin(list(styles))]
    with style_context():
        n_lines = rows.groupby(["core", "dataset"]).ngroups
        figure = new_figure(4.6 * len(measures), 3.6 + 0.17 * n_lines)
        panels = np.atleast_1d(np.asarray(figure.subplots(1, len(measures), sharey=True)))
        for axes, measure in zip(panels, measures, strict=True):
            _draw_measure(axes, rows, rank, styles, measure)
        panels[0].set_ylabel("norm of position error [% of LOS]")
        if np.isfinite(rows["position_error_pct_los"]).any():
            log_axis(panels[0], "y")
        else:
            note(panels[0], "no shot with a pose")
    return figure


def larger_terrain_chart(
    comparisons: Mapping[str, Sequence[Comparison]], styles: Mapping[str, CoreStyle]
) -> Figure:
    """Draw the error with the larger terrain against that with the usual one, pose by pose.

    Below the diagonal the larger terrain is better.
    """
    with style_context():
        figure = new_figure(4.4 * max(len(comparisons), 1), 4.4)
        panels = np.atleast_1d(np.asarray(figure.subplots(1, max(len(comparisons), 1))))
        for axes, (dataset, of_dataset) in zip(panels, comparisons.items(), strict=False):
            for comparison in of_dataset:
                core, both = comparison.pair.base.core, comparison.differences
                base, other = (
                    np.maximum(of, SMALLEST_ERROR_PCT_LOS) for of in (both.base, both.other)
                )
                _draw_cloud(axes, base, other, styles[core], dataset, label=core)
            axes.set_title(f"{DATASETS[dataset].title}", loc="left")
            axes.set_xlabel(f"usual terrain: {ERROR_LABEL}")
            axes.grid()
            log_axis(axes, "x")
            log_axis(axes, "y")
            _draw_diagonal(axes)
        panels[0].set_ylabel(f"larger terrain: {ERROR_LABEL}")
        if comparisons:
            legend_above(figure, drawn_names(panels[0]))
        else:
            note(panels[0], "no pose was solved with both")
    return figure


def selection_chart(selection: pd.DataFrame, titles: Mapping[str, str]) -> Figure:
    """Draw what each choice of features and matches gains, with 95 % intervals.

    Args:
        selection: Rows of ``selection.csv``.
        titles: What people call each ``dataset`` of it.
    """
    drawn = drawn_selection(selection)
    bases = dict(list(drawn.groupby("base", sort=False)))
    datasets = list(dict.fromkeys(map(str, drawn["dataset"])))
    n_variants = [rows["variant"].nunique() for rows in bases.values()]
    with style_context():
        height_in = 0.9 * len(bases) + _VARIANT_IN * sum(n_variants)
        figure = new_figure(_TITLE_IN + max(2.4 * len(datasets), 4.0), height_in)
        grid = np.asarray(
            figure.subplots(
                len(bases), len(datasets), sharex="row", sharey="row", squeeze=False,
                height_ratios=n_variants,
            )
        )  # fmt: skip
        for panels, (base, rows) in zip(grid, bases.items(), strict=True):
            variants = rows.drop_duplicates("variant").set_index("variant")
            for axes, dataset in zip(panels, datasets, strict=True):
                _draw_gains(axes, select(rows, dataset=dataset).set_index("variant"), variants)
                axes.set_title(f"{base}, {titles.get(dataset, dataset)}", loc="left")
            names = [fill(str(title), _TITLE_LETTERS) for title in variants["title"]]
            panels[0].set_yticks(range(len(variants)), names)
            panels[0].set_ylim(len(variants) - 0.4, -0.6)
        for axes in grid[-1]:
            axes.set_xlabel("gain: error less than the base's [% of LOS]")
    return figure


def drawn_selection(selection: pd.DataFrame) -> pd.DataFrame:
    """Give the rows that say most: those of all datasets together, if there are such."""
    variants = selection[selection["gain_pct_los"].notna()]
    together = select(variants, dataset=ALL_DATASETS)
    return variants if together.empty else together


def load_chart(load: pd.DataFrame, styles: Mapping[str, CoreStyle]) -> Figure:
    """Draw time per stage and memory against image size, number of features and of landmarks.

    Args:
        load: Rows of ``load.csv``.
        styles: Of each core.
    """
    varied = [name for name in VARIED if (load["varied"] == name).any()]
    with style_context():
        figure = new_figure(3.3 * max(len(varied), 1), 7.2)
        if not varied:
            note(figure.add_subplot(), "nothing was measured")
            return figure
        grid = np.asarray(figure.subplots(2, len(varied), squeeze=False, sharey="row"))
        for i, name in enumerate(varied):
            rows = select(load, varied=name)
            for core, of_core in rows.sort_values("value").groupby("core", sort=False):
                style = styles[str(core)]
                _draw_times(grid[0, i], of_core, style, str(core))
                memory_mb = of_core["peak_memory_mb"].to_numpy(np.float64)
                _draw_line(grid[1, i], of_core, memory_mb, style, label=str(core))
            for axes in grid[:, i]:
                axes.grid()
                axes.set_xlabel(VARIED[name])
                log_axis(axes, "x", dense_until=50.0)
        log_axis(grid[0, 0], "y")
        most_mb = float(load["peak_memory_mb"].max())
        if np.isfinite(most_mb):
            grid[1, 0].set_ylim(0.0, 1.08 * most_mb)
        grid[0, 0].set_ylabel("time of one image [s]")
        grid[1, 0].set_ylabel("peak memory [MB]")
        stages: dict[str, Artist] = {
            stage: Line2D([], [], color="#666666", linestyle=dashes, linewidth=1.0)
            for stage, dashes in STAGES.items()
        }
        legend_above(figure, drawn_names(grid[0, 0]) | stages)
    return figure


VARIED = {"image": "side of the image [px]", "features": "features", "landmarks": "landmarks"}
"""What the load is measured against."""
STAGES = {"detect": (0, (1, 1)), "match": (0, (4, 2)), "pose": (0, (4, 1, 1, 1))}
"""Stages of localisation and the dashes that they are drawn with."""


def _draw_measure(
    axes: Axes,
    rows: pd.DataFrame,
    rank: pd.DataFrame,
    styles: Mapping[str, CoreStyle],
    measure: Measure,
) -> None:
    for (core, dataset), of_case in rows.groupby(["core", "dataset"], sort=False):
        of_rank = select(rank, core=core, dataset=dataset, measure=measure.column)
        _draw_cloud(
            axes,
            of_case[measure.column].to_numpy(np.float64),
            _errors(of_case),
            styles[str(core)],
            str(dataset),
            label=f"{_named(core, dataset)}: {rank_text(of_rank)}",
        )
    axes.grid()
    axes.set_xlabel(measure.label)
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.16), handletextpad=0.2)


def rank_text(rank: pd.DataFrame) -> str:
    """Say what a rank correlation is; ``rank`` has its row of ``rank.csv``, or none."""
    if rank.empty or np.isnan(rank["spearman_rho"].iloc[0]):
        return "no correlation known"
    row = rank.iloc[0]
    return f"rho {correlation_text(row)}, p {probability_text(float(row['p']))}"


def correlation_text(row: "pd.Series[float]") -> str:
    """Write a rank correlation with its interval, if the shots were enough for one."""
    rho = f"{row['spearman_rho']:.2f}"
    has_interval = np.isfinite(row["low"]) and np.isfinite(row["high"])
    return f"{rho} [{row['low']:.2f}, {row['high']:.2f}]" if has_interval else rho


def probability_text(p: float) -> str:
    """Write a probability as people read it."""
    if np.isnan(p):
        return "not known"
    return "< 0.001" if p < 0.001 else f"{p:.2g}"


def _draw_cloud(
    axes: Axes, x: FloatArray, y: FloatArray, style: CoreStyle, dataset: str, *, label: str
) -> None:
    marker = _DATASET_MARKERS.get(dataset, "o")
    look: dict[str, Any] = {} if marker == "x" else {"markeredgewidth": 0}
    axes.plot(
        x, y, marker, color=style.colour, markersize=4.5, alpha=0.6, linestyle="", label=label,
        **look,
    )  # fmt: skip


def _draw_diagonal(axes: Axes) -> None:
    low = min(axes.get_xlim()[0], axes.get_ylim()[0])
    high = max(axes.get_xlim()[1], axes.get_ylim()[1])
    axes.plot([low, high], [low, high], color=_ZERO_COLOUR, linewidth=0.9)
    axes.set_xlim(low, high)
    axes.set_ylim(low, high)


def _draw_gains(axes: Axes, rows: pd.DataFrame, variants: pd.DataFrame) -> None:
    for at, (_, row) in enumerate(rows.reindex(variants.index).iterrows()):
        low, high = float(row["gain_low"]), float(row["gain_high"])
        is_clear = low > 0.0 or high < 0.0
        colour = "#0072b2" if is_clear else "#7f7f7f"
        axes.plot([low, high], [at, at], color=colour, linewidth=1.6)
        axes.plot(float(row["gain_pct_los"]), at, "o", color=colour, markersize=4.5)
    axes.axvline(0.0, color=_ZERO_COLOUR, linewidth=0.9)
    axes.grid(axis="x")


def _draw_times(axes: Axes, rows: pd.DataFrame, style: CoreStyle, core: str) -> None:
    _draw_line(axes, rows, rows["time_all_s"].to_numpy(np.float64), style, label=core)
    for stage, dashes in STAGES.items():
        time_s = rows[f"time_{stage}_s"].to_numpy(np.float64)
        axes.plot(rows["value"], time_s, linestyle=dashes, color=style.colour, linewidth=1.0)


def _draw_line(
    axes: Axes, rows: pd.DataFrame, values: FloatArray, style: CoreStyle, *, label: str
) -> None:
    axes.plot(
        rows["value"], values, marker=style.marker, color=style.colour, linewidth=1.6,
        markersize=4.5, label=label,
    )  # fmt: skip


def _errors(rows: pd.DataFrame) -> FloatArray:
    errors = rows["position_error_pct_los"].to_numpy(np.float64)
    return np.maximum(errors, SMALLEST_ERROR_PCT_LOS)


def _named(core: object, dataset: object) -> str:
    name = str(dataset)
    return f"{core}, {DATASETS[name].title if name in DATASETS else name}"
