"""Pictures of an ablation: what each source of error costs, and how errors add up."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tronlab.report.style import CoreStyle, core_styles, new_figure, note, style_context
from tronlab.score.evaluation.ablation import ALL, NONE, TOGETHER

KIND_COLOURS = {
    "terrain": "#8c510a",
    "light": "#e6a817",
    "camera": "#35978f",
    "truth": "#7b3294",
}
"""Colours of the kinds of sources: brown, amber, teal and violet."""
_BAR_IN, _MARGIN_IN, _COLUMN_IN, _NAMES_IN = 0.22, 1.15, 2.15, 2.2
_BAR = 0.7


def cost_chart(ablation: pd.DataFrame, *, dataset: str = TOGETHER) -> Figure:
    """Draw what each source costs each core: bars with their 95 % intervals.

    A panel a core, each with a scale of its own. A bar is the mean error with all sources minus
    that without this one, over the same shots. Pale bars have an interval that includes zero. The
    mean errors with all sources and without any stand above each panel.

    Args:
        ablation: As ``ablation_table`` gives it.
        dataset: Which; by default all together.
    """
    rows = ablation[ablation["dataset"] == dataset]
    costs = rows[rows["variant"].str.startswith("without_")]
    sources = costs.drop_duplicates("source")
    cores = list(dict.fromkeys(map(str, rows["core"])))
    height_in = _MARGIN_IN + _BAR_IN * max(len(sources), 4)
    with style_context():
        figure = new_figure(_NAMES_IN + _COLUMN_IN * max(len(cores), 1), height_in)
        panels = figure.subplots(1, max(len(cores), 1), sharey=True, squeeze=False)[0]
        if not len(sources):
            note(panels[0], "no source was looked at")
            return figure
        for axes, core in zip(panels, cores, strict=True):
            of_core = costs[costs["core"] == core].set_index("source")
            _draw_costs(axes, of_core.reindex(list(sources["source"])))
            axes.set_title(f"{core}\n{_whole(rows[rows['core'] == core])}", loc="left")
        panels[0].set_yticks(range(len(sources)), list(map(str, sources["title"])))
        panels[0].invert_yaxis()
        figure.supxlabel("cost: mean error with all minus without [% of LOS]", fontsize=9.0)
        _name_kinds(figure, list(dict.fromkeys(map(str, sources["kind"]))))
    return figure


def dataset_costs_chart(ablation: pd.DataFrame, core: str) -> Figure:
    """Draw what each source costs one core on each dataset: points with their 95 % intervals.

    Args:
        ablation: As ``ablation_table`` gives it.
        core: Which core.
    """
    rows = ablation[(ablation["core"] == core) & ablation["variant"].str.startswith("without_")]
    titles = rows.drop_duplicates("source").set_index("source")["title"]
    datasets = [name for name in dict.fromkeys(map(str, rows["dataset"])) if name != TOGETHER]
    styles = core_styles(datasets)
    with style_context():
        figure = new_figure(7.2, _MARGIN_IN + 1.3 * _BAR_IN * max(len(titles), 4))
        axes = figure.add_subplot()
        if not len(titles):
            note(axes, "no source was looked at")
            return figure
        for i, dataset in enumerate(datasets):
            of_dataset = rows[rows["dataset"] == dataset].set_index("source").reindex(titles.index)
            shift = _BAR * ((i + 0.5) / len(datasets) - 0.5)
            _draw_points(axes, of_dataset, np.arange(len(titles)) + shift, styles[dataset], dataset)
        axes.axvline(0.0, color="black", linewidth=0.8)
        axes.set_yticks(range(len(titles)), list(map(str, titles)))
        axes.invert_yaxis()
        axes.grid(axis="x")
        axes.set_xlabel(f"cost for {core} [% of LOS]")
        figure.legend(loc="outside upper left", ncols=2, fontsize=8.0)
    return figure


def _draw_costs(axes: Axes, of_core: pd.DataFrame) -> None:
    y = np.arange(len(of_core))
    value, low, high = (
        of_core[name].to_numpy(np.float64) for name in ("cost_pct_los", "cost_low", "cost_high")
    )
    is_certain = (low > 0.0) | (high < 0.0)
    for i, kind in enumerate(of_core["kind"]):
        colour = KIND_COLOURS.get(str(kind), "#7f7f7f")
        axes.barh(y[i], value[i], _BAR, color=colour, alpha=1.0 if is_certain[i] else 0.35)
    axes.errorbar(
        value,
        y,
        xerr=_whiskers(value, low, high),
        fmt="none",
        ecolor="black",
        elinewidth=0.8,
        capsize=2.0,
    )
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.grid(axis="x")
    axes.locator_params(axis="x", nbins=4)


def _draw_points(
    axes: Axes, of_dataset: pd.DataFrame, y: np.ndarray, style: CoreStyle, name: str
) -> None:
    value, low, high = (
        of_dataset[column].to_numpy(np.float64)
        for column in ("cost_pct_los", "cost_low", "cost_high")
    )
    axes.errorbar(
        value,
        y,
        xerr=_whiskers(value, low, high),
        fmt=style.marker,
        color=style.colour,
        markersize=3.5,
        elinewidth=0.9,
        label=name,
    )


def _whiskers(value: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Give the lengths of the whiskers, shape (2, n); none where there is no interval."""
    return np.nan_to_num(np.maximum([value - low, high - value], 0.0))


def _whole(of_core: pd.DataFrame) -> str:
    mean = of_core.set_index("variant")["mean_pct_los"]
    parts = [
        f"{name} {mean[variant]:.3g} %"
        for variant, name in ((ALL, "all"), (NONE, "none"))
        if variant in mean.index and np.isfinite(mean[variant])
    ]
    return ", ".join(parts)


def _name_kinds(figure: Figure, kinds: list[str]) -> None:
    from matplotlib.patches import Patch

    handles = [Patch(color=KIND_COLOURS.get(kind, "#7f7f7f"), label=kind) for kind in kinds]
    pale = Patch(color="#7f7f7f", alpha=0.35, label="pale: the interval includes zero")
    figure.legend(
        handles=[*handles, pale], loc="outside upper left", ncols=len(kinds) + 1, fontsize=8.0
    )
