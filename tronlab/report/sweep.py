"""What a sweep found: its variants, best first, and the error against each swept setting."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator

from tronlab.geometry.poses import FloatArray
from tronlab.report.curves import ERROR_LABEL
from tronlab.report.style import (
    core_styles,
    drawn_names,
    legend_above,
    new_figure,
    note,
    save_chart,
    style_context,
)
from tronlab.score.sweep import Value, Variant

TABLE = "sweep.csv"
PICTURE = "sweep"
_TIMES = ["time_detect_s", "time_match_s", "time_pose_s"]
_LOG_SPAN = 20.0
"""An axis whose values span more than this factor is logarithmic."""


@dataclass(frozen=True, slots=True)
class _Line:
    """Variants that differ in one setting only."""

    core: str
    x: tuple[float, ...]
    names: tuple[str, ...]


class _Found:
    """What is drawn of each variant, and which belong together."""

    def __init__(self, by_name: pd.DataFrame, variants: Sequence[Variant]) -> None:
        self.error: pd.Series[float] = by_name["position_error_mean_pct_los"]
        self.solved_pct: pd.Series[float] = 100.0 * by_name["n_ok"] / by_name["n_rows"]
        self.styles = core_styles(list(dict.fromkeys(map(str, by_name["core"]))))
        self._swept = [v for v in variants if v.values and v.name in by_name.index]
        swept = {variant.name for variant in self._swept}
        self.not_swept = [str(name) for name in by_name.index if name not in swept]

    @property
    def best(self) -> Variant | None:
        """Get the variant with the least mean error; None if there is no pose at all."""
        known = [v for v in self._swept if np.isfinite(self.error[v.name])]
        return min(known, key=lambda variant: self.error[variant.name], default=None)

    def values(self, key: str) -> tuple[Value, ...]:
        """Give what a setting was, in the order of the file."""
        return tuple(dict.fromkeys(v.values[key] for v in self._swept if key in v.values))

    def lines(self, key: str, place: Mapping[Value, float]) -> Iterator[_Line]:
        """Give the variants that differ in one setting only, where ``place`` has them."""
        groups: dict[tuple[object, ...], list[Variant]] = {}
        for variant in self._swept:
            if key in variant.values:
                others = tuple((k, v) for k, v in variant.values.items() if k != key)
                groups.setdefault((variant.core, *others), []).append(variant)
        for group in groups.values():
            group.sort(key=lambda variant: place[variant.values[key]])
            x = tuple(place[variant.values[key]] for variant in group)
            yield _Line(group[0].core, x, tuple(variant.name for variant in group))


def variant_table(scores: pd.DataFrame, variants: Sequence[Variant]) -> pd.DataFrame:
    """Give the statistics of each variant, the one with the least mean error first.

    Cores among the scores that are no variant have a row, too: one compares with them.

    Args:
        scores: The table of scores; seeds are repeats, their rows count alike.
        variants: Those of the sweep.

    Returns:
        One row a variant: its name, core, value of each swept setting (empty where it has none),
        number of rows and of those with a pose, mean, median and 95th percentile of the position
        error in per cent of the line of sight, mean rotation error in degrees, mean time in
        seconds of one image.
    """
    known = {variant.name: variant for variant in variants}
    keys = list(dict.fromkeys(key for variant in variants for key in variant.values))
    rows: list[dict[str, object]] = []
    for name, of_variant in scores.groupby("core", sort=False):
        variant = known.get(str(name))
        values = {key: variant.values.get(key) if variant else None for key in keys}
        core = variant.core if variant else str(name)
        rows.append({"variant": name, "core": core, **values, **_statistics(of_variant)})
    table = pd.DataFrame(rows)
    return table.sort_values(
        ["position_error_mean_pct_los", "n_ok"], ascending=[True, False], ignore_index=True
    )


def save_sweep(scores: pd.DataFrame, variants: Sequence[Variant], folder: Path) -> pd.DataFrame:
    """Write ``sweep.csv``, ``sweep.png`` and ``sweep.pdf``; give the table."""
    table = variant_table(scores, variants)
    table.to_csv(folder / TABLE, index=False)
    save_chart(sweep_figure(table, variants), folder, PICTURE)
    return table


def sweep_figure(table: pd.DataFrame, variants: Sequence[Variant]) -> Figure:
    """Draw mean error and share of solved images against each swept setting.

    A line joins variants that differ in nothing else. Cores that are not swept are dashed.

    Args:
        table: As ``variant_table`` gives it.
        variants: Those of the sweep.
    """
    keys = list(dict.fromkeys(key for variant in variants for key in variant.values))
    found = _Found(table.set_index("variant"), variants)
    with style_context():
        figure = new_figure(max(7.2, 3.4 * len(keys)), 5.2)
        if not keys:
            note(figure.add_subplot(), "nothing was swept")
            return figure
        panels = figure.subplots(
            2, len(keys), squeeze=False, sharex="col", sharey="row", height_ratios=[2.2, 1.0]
        )
        for key, (upper, lower) in zip(keys, panels.T, strict=True):
            _draw_setting(upper, lower, key, found)
        for axes in panels.flat:
            axes.grid()
        _name_errors(panels[0, 0], found.error)
        panels[1, 0].set_ylabel("solved [%]")
        panels[1, 0].set_ylim(-4.0, 104.0)
        named = {name: line for axes in panels[0] for name, line in drawn_names(axes).items()}
        legend_above(figure, named)
    return figure


def _statistics(rows: pd.DataFrame) -> dict[str, object]:
    solved = rows[rows["status"] == "ok"]
    error = solved["position_error_pct_los"]
    return {
        "n_rows": len(rows),
        "n_ok": len(solved),
        "position_error_mean_pct_los": error.mean(),
        "position_error_median_pct_los": error.median(),
        "position_error_p95_pct_los": error.quantile(0.95),
        "rotation_error_mean_deg": solved["rotation_error_deg"].mean(),
        "time_mean_s": rows[_TIMES].sum(axis=1).mean(),
    }


def _draw_setting(upper: Axes, lower: Axes, key: str, found: _Found) -> None:
    place = _scale(upper, found.values(key))
    quantities = (upper, found.error), (lower, found.solved_pct)
    for line in found.lines(key, place):
        style = found.styles[line.core]
        for axes, quantity in quantities:
            axes.plot(
                line.x,
                quantity[list(line.names)],
                marker=style.marker,
                color=style.colour,
                markersize=4.0,
                linewidth=1.2,
                alpha=0.75,
                label=line.core,
            )
    for name in found.not_swept:
        for axes, quantity in quantities:
            axes.axhline(
                quantity[name],
                color=found.styles[name].colour,
                linestyle="--",
                linewidth=1.0,
                label=name,
            )
    best = found.best
    if best is not None and key in best.values:
        upper.plot(
            place[best.values[key]],
            found.error[best.name],
            "o",
            markersize=11,
            markerfacecolor="none",
            markeredgecolor="black",
            label=f"least mean error: {best.name}",
        )
    lower.set_xlabel(key)


def _scale(axes: Axes, values: Sequence[Value]) -> dict[Value, float]:
    """Set up the axis of a setting, and give where on it each value is.

    Numbers are where they belong, anything else side by side in the order of the file.
    """
    numbers = np.array([v for v in values if isinstance(v, int | float)], dtype=np.float64)
    are_numbers = len(numbers) == len(values) and not any(isinstance(v, bool) for v in values)
    places: FloatArray = numbers if are_numbers else np.arange(len(values), dtype=np.float64)
    if are_numbers and numbers.min() > 0 and numbers.max() >= _LOG_SPAN * numbers.min():
        axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator(list(places)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xticks(list(places), [_label(value) for value in values])
    if not are_numbers:
        axes.set_xlim(-0.5, len(values) - 0.5)
    return dict(zip(values, map(float, places), strict=True))


def _label(value: Value) -> str:
    if isinstance(value, bool) or value is None:
        return {None: "none", True: "yes", False: "no"}[value]
    return value if isinstance(value, str) else f"{value:g}"


def _name_errors(axes: Axes, error: "pd.Series[float]") -> None:
    axes.set_ylabel(f"mean {ERROR_LABEL}")
    known = error[np.isfinite(error) & (error > 0)]
    if known.empty:
        note(axes, "no image with a pose")
    elif known.max() > _LOG_SPAN * known.min():
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)
