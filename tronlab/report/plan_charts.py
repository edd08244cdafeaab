"""Charts of a plan: its figures shot by shot with what is allowed, and the time by part."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.planning.assessment import CheckName, PlanAssessment, ShotAssessment
from tronlab.planning.context import PlanContext
from tronlab.planning.summary import PART_LABELS, duration_text
from tronlab.report.style import new_figure, note, style_context

TAKEN_COLOUR = "#0072b2"
WARNED_COLOUR = "#e69f00"
REFUSED_COLOUR = "#d62728"
LIMIT_COLOUR = "#7f7f7f"
_LONG_S = 600.0
"""Times of a shot from here on are drawn in minutes."""


@dataclass(frozen=True, slots=True)
class _Quantity:
    """One panel: a figure of every shot."""

    label: str
    values: FloatArray
    limits: tuple[float, ...]
    checks: tuple[CheckName, ...]
    """Findings of these checks are marked here."""
    least_span: float
    """An axis spans at least so much: rounding shall not look like a change."""


def shot_charts(assessment: PlanAssessment, context: PlanContext) -> Figure:
    """Draw usable part, light, range, clearance, T-MAC and time over the shots as taken."""
    shots = assessment.shots
    panels = _quantities(shots, context)
    with style_context():
        figure = new_figure(9.4, 9.6)
        grid = figure.subplots(4, 2, sharex=True)
        for axes, quantity in zip(grid.flat, panels, strict=True):
            _draw_quantity(axes, shots, quantity)
        for axes in grid[-1]:
            axes.set_xlabel("shot, in the order taken")
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


def time_chart(assessment: PlanAssessment) -> Figure:
    """Draw how the estimated time divides into its parts."""
    parts_s, total_s = assessment.parts_s, assessment.total_s
    names = list(PART_LABELS)
    with style_context():
        figure = new_figure(7.6, 3.2)
        axes = figure.add_subplot()
        minutes = [parts_s[name] / 60 for name in names]
        axes.barh(range(len(names)), minutes, color=TAKEN_COLOUR, height=0.65)
        for i, name in enumerate(names):
            share = 100 * parts_s[name] / total_s if total_s > 0 else 0.0
            axes.text(
                minutes[i], i, f"  {duration_text(parts_s[name])}, {share:.0f} %", va="center"
            )
        axes.set_yticks(range(len(names)), [PART_LABELS[name] for name in names])
        axes.set_ylim(len(names) - 0.4, -0.6)
        axes.set_xlim(0, 1.22 * max(*minutes, 1e-3))
        axes.set_xlabel(f"estimated time [min], {duration_text(total_s)} in all (h:mm:ss)")
        axes.grid(axis="x")
    return figure


def _quantities(shots: Sequence[ShotAssessment], context: PlanContext) -> list[_Quantity]:
    def of(name: str, factor: float = 1.0) -> FloatArray:
        return factor * np.array([getattr(shot, name) for shot in shots], dtype=np.float64)

    rules, cell = context.rules, context.cell
    durations_s = np.array([np.nan if s.is_refused else s.duration.total_s for s in shots])
    is_long = bool(np.nanmax(durations_s, initial=0.0) > _LONG_S)
    return [
        _Quantity(
            "usable part of the image [%]",
            of("usable_fraction", 100.0),
            (100 * rules.min_usable_fraction,),
            ("usable", "view"),
            least_span=5.0,
        ),
        _Quantity("range [m]", of("range_los_m"), rules.range_los_m, ("range",), least_span=0.1),
        _Quantity(
            "lit part of the model [%]",
            of("lit_fraction", 100.0),
            (100 * rules.min_lit_fraction,),
            ("light",),
            least_span=5.0,
        ),
        _Quantity(
            "robot's shadow on the model [%]",
            of("robot_shadow", 100.0),
            (100 * rules.max_robot_shadow,),
            ("light",),
            least_span=1.0,
        ),
        _Quantity(
            "T-MAC's axis to the beam [deg]",
            of("tmac_angle_rad", float(np.degrees(1.0))),
            (cell.sight.tmac_half_angle_deg,),
            ("sight",),
            least_span=5.0,
        ),
        _Quantity(
            "T-MAC from the tracker [m]",
            of("tmac_distance_m"),
            cell.sight.range_m,
            ("sight",),
            least_span=0.1,
        ),
        _Quantity(
            "clearance [m]",
            of("clearance_m"),
            (cell.envelope.clearance_m,),
            ("collision",),
            least_span=0.1,
        ),
        _Quantity(
            "time of the shot [min]" if is_long else "time of the shot [s]",
            durations_s / 60 if is_long else durations_s,
            (),
            (),
            least_span=0.5,
        ),
    ]


def _draw_quantity(axes: Axes, shots: Sequence[ShotAssessment], quantity: _Quantity) -> None:
    number = np.arange(1, len(shots) + 1)
    values = quantity.values
    refused, warned = (
        _marked(shots, quantity.checks, is_refusal=is_refusal) for is_refusal in (True, False)
    )
    plain = ~(refused | warned)
    size = 3.0 if len(shots) <= 100 else 2.0
    axes.plot(number, values, "-", color=TAKEN_COLOUR, linewidth=0.6, alpha=0.5)
    for which, marker, colour, factor in (
        (plain, "o", TAKEN_COLOUR, 1.0),
        (warned, "^", WARNED_COLOUR, 1.6),
        (refused, "X", REFUSED_COLOUR, 2.0),
    ):
        axes.plot(
            number[which],
            values[which],
            marker,
            color=colour,
            markersize=factor * size,
            markeredgewidth=0,
        )
    axes.set_title(quantity.label, loc="left")
    axes.set_xlim(0.5 - 0.01 * len(shots), len(shots) + 0.5 + 0.01 * len(shots))
    axes.grid()
    if not np.isfinite(values).any():
        note(axes, "not known")
        return
    _scale(axes, values, least_span=quantity.least_span)
    _draw_limits(axes, quantity.limits)


def _marked(
    shots: Sequence[ShotAssessment], checks: Sequence[CheckName], *, is_refusal: bool
) -> NDArray[np.bool_]:
    return np.array(
        [
            any(f.check in checks and f.is_refusal == is_refusal for f in shot.findings)
            for shot in shots
        ],
        dtype=np.bool_,
    )


def _scale(axes: Axes, values: FloatArray, *, least_span: float) -> None:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    missing = max(0.0, least_span - (high - low)) / 2
    margin = 0.08 * max(high - low, least_span)
    shown_low = low - missing - margin
    if low >= 0:
        shown_low = max(shown_low, -margin)
    axes.set_ylim(shown_low, high + missing + margin)
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _draw_limits(axes: Axes, limits: Sequence[float]) -> None:
    """Draw the limits that are near enough to the values; others would flatten them."""
    low, high = axes.get_ylim()
    span = high - low
    for limit in limits:
        if not low - span < limit < high + span:
            continue
        low, high = min(low, limit - 0.06 * span), max(high, limit + 0.06 * span)
        axes.axhline(limit, color=LIMIT_COLOUR, linewidth=1.0, linestyle="--")
        axes.annotate(
            f"limit {limit:g}",
            xy=(1.0, limit),
            xycoords=axes.get_yaxis_transform(),
            ha="right",
            va="bottom",
            fontsize=7,
            color=LIMIT_COLOUR,
        )
    axes.set_ylim(low, high)
