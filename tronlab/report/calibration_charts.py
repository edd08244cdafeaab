"""Calibration charts: stations against the tracker, choice of the model, reflectors, board."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from tronlab.calib.camera.board import corner_points
from tronlab.calib.camera.bow import BOW_TERMS, bow_basis
from tronlab.calib.hand_eye.station_gaps import StationGaps
from tronlab.calib.inputs import FrameInput
from tronlab.calib.results import CameraResult, FrameResult, HandEyeResult
from tronlab.devices.laboratory import PatternSpec
from tronlab.geometry.poses import unit
from tronlab.report.calibration_images import GOOD_COLOUR, OUTLIER_COLOUR
from tronlab.report.style import AXIS_COLOURS, new_figure, style_context

_LONGEST_RESIDUAL = 0.15
"""Length of the longest arrow over the size of the model."""
_WIDE = 3.0
"""Errors whose ratio is larger are drawn on a logarithmic axis."""
_VISIBLE = 0.02
"""Shorter arrows, relative to the longest, are not drawn."""
_N_SURFACE = 41


def station_chart(stations: StationGaps, result: HandEyeResult) -> Figure:
    """Draw how far tracker and camera disagree at each station, with what is to be expected."""
    title = "Camera pose by the image minus by the tracker, axes of trk"
    with style_context():
        figure = new_figure(7.6, 5.4)
        figure.suptitle(title + _held_out_text(result.statistics.get("held_out")), fontsize=10)
        panels = figure.subplots(2, 1, sharex=True)
        _draw_gaps(panels[0], stations, slice(3, 6), 1e3)
        panels[0].set_ylabel("camera centre [mm]")
        _draw_gaps(panels[1], stations, slice(0, 3), float(np.degrees(1e3)))
        panels[1].set_ylabel("rotation [mdeg]")
        panels[1].set_xlabel("station")
        panels[0].legend(fontsize=8, ncols=5, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    return figure


def _held_out_text(held_out: Mapping[str, float] | None) -> str:
    if not held_out:
        return ""
    position, angle = (
        f"{factor * held_out[name]:.{digits}f} {unit_name}"
        f" (expected {factor * held_out['expected_' + name]:.{digits}f})"
        for name, unit_name, factor, digits in (
            ("position_rms_m", "mm", 1e3, 3),
            ("angle_rms_rad", "mdeg", float(np.degrees(1e3)), 1),
        )
    )
    return f"\nstations held out are predicted to {position} and {angle}, rms"


def _draw_gaps(axes: Axes, stations: StationGaps, which: slice, factor: float) -> None:
    values = factor * stations.gaps[:, which]
    sigmas = factor * np.sqrt(np.einsum("nii->ni", stations.covariances))[:, which].max(axis=1)
    number, good = np.arange(len(values)), ~stations.is_outlier
    for n_sigmas, colour in ((2, "#eeeeee"), (1, "#dddddd")):
        axes.bar(
            number,
            2 * n_sigmas * sigmas,
            bottom=-n_sigmas * sigmas,
            width=0.9,
            color=colour,
            label=f"{n_sigmas} sigma",
        )
    for i, (axis, colour) in enumerate(AXIS_COLOURS.items()):
        axes.plot(number + 0.2 * (i - 1), values[:, i], "o", color=colour, markersize=4, label=axis)
    axes.axhline(0.0, color="black", linewidth=0.6)
    if good.any() and not good.all():
        limit = 1.15 * max(np.abs(values[good]).max(), 2 * sigmas[good].max())
        axes.set_ylim(-limit, limit)
        for i in map(int, np.flatnonzero(~good)):
            axes.axvspan(i - 0.5, i + 0.5, color=OUTLIER_COLOUR, alpha=0.25, linewidth=0)
            axes.text(i, 0.93 * limit, "left out", rotation=90, va="top", ha="center", fontsize=7)
    axes.set_xlim(-0.6, len(values) - 0.4)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def model_chart(result: CameraResult) -> Figure:
    """Draw how well each distortion model predicts views it was not fitted to."""
    rows: Sequence[Mapping[str, Any]] = result.statistics["models"]
    is_bow_free = bool(result.bow_m.any())
    with style_context():
        figure = new_figure(6.6, 1.4 + 0.42 * len(rows))
        axes = figure.add_subplot()
        for i, row in enumerate(rows):
            is_chosen = row["model"] == result.model and row["is_bow_free"] == is_bow_free
            colour = GOOD_COLOUR if is_chosen else "#7f7f7f"
            axes.errorbar(
                row["held_out_rms_px"],
                i,
                xerr=row["standard_error_px"],
                fmt="o",
                color=colour,
                capsize=3,
                label="held out, one standard error" if is_chosen else None,
            )
            axes.plot(
                row["rms_px"],
                i,
                "|",
                color=colour,
                markersize=11,
                label="in the solution" if is_chosen else None,
            )
        axes.set_yticks(range(len(rows)), [_model_label(row) for row in rows])
        axes.set_ylim(len(rows) - 0.4, -0.6)
        held_out = [row["held_out_rms_px"] for row in rows]
        if min(held_out) > 0 and max(held_out) > _WIDE * min(held_out):
            _log_axis(axes)
        axes.set_xlabel("root mean square of a coordinate [px]")
        axes.grid(axis="x")
        axes.set_title("Distortion models; the one chosen is blue", loc="left", pad=20)
        axes.legend(fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    return figure


def _log_axis(axes: Axes) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _model_label(row: Mapping[str, Any]) -> str:
    board = "bow free" if row["is_bow_free"] else "flat board"
    return f"{row['model']}, {board} ({row['n_free']} free)"


def frame_chart(measured: FrameInput, result: FrameResult) -> Figure:
    """Draw the reflectors with their residuals, and how far lengths are from the nominal ones."""
    n_lengths = len(result.statistics["length_errors_m"])
    heights = 3.4, 0.9 + 0.3 * n_lengths
    with style_context():
        figure = new_figure(7.2, sum(heights))
        plan, lengths = figure.subplots(2, 1, height_ratios=heights)
        _draw_plan(plan, measured, result)
        _draw_lengths(lengths, measured, result)
    return figure


def _draw_plan(axes: Axes, measured: FrameInput, result: FrameResult) -> None:
    """Draw the model as the camera sees it: X down, Y to the right."""
    places = {name: np.array(p_m) for name, p_m in measured.reflectors.points_m.items()}
    residuals_mm = {name: 1e3 * np.array(result.statistics["residuals_m"][name]) for name in places}
    extent = np.array(list(places.values()))
    size_m, middle_m = float(np.ptp(extent, axis=0).max()), float(extent[:, 1].mean())
    largest_mm = max(float(np.linalg.norm(residual[:2])) for residual in residuals_mm.values())
    m_per_mm = _LONGEST_RESIDUAL * size_m / largest_mm if largest_mm > 0 else 0.0
    for name, (x, y, _) in places.items():
        residual = residuals_mm[name]
        axes.plot(y, x, "o", color=GOOD_COLOUR, markersize=5)
        if np.linalg.norm(residual[:2]) > _VISIBLE * largest_mm:
            axes.annotate(
                "",
                xy=(y + m_per_mm * residual[1], x + m_per_mm * residual[0]),
                xytext=(y, x),
                arrowprops={"arrowstyle": "->", "color": OUTLIER_COLOUR},
            )
        along = " ".join(f"{value:+.3f}" for value in residual + 0.0)
        is_right = y > middle_m
        axes.annotate(
            f"{name}\n{along}",
            (y, x),
            (-6 if is_right else 6, 8),
            textcoords="offset points",
            fontsize=7,
            ha="right" if is_right else "left",
        )
    axes.set_title("Reflectors: measured minus nominal, X Y Z [mm]; arrows enlarged", loc="left")
    axes.set_xlabel("Y of trs [m]")
    axes.set_ylabel("X of trs [m]")
    axes.set_aspect("equal")
    axes.margins(0.25)
    axes.invert_yaxis()
    axes.grid()


def _draw_lengths(axes: Axes, measured: FrameInput, result: FrameResult) -> None:
    errors_mm = {name: 1e3 * error for name, error in result.statistics["length_errors_m"].items()}
    places = np.arange(len(errors_mm))
    sigmas_mm = [1e3 * sigma for sigma in _length_sigmas_m(measured)]
    axes.barh(places, list(errors_mm.values()), color=GOOD_COLOUR, height=0.5)
    axes.errorbar(
        list(errors_mm.values()), places, xerr=sigmas_mm, fmt="none", color="black", capsize=3
    )
    axes.set_yticks(places, list(errors_mm))
    axes.set_ylim(len(errors_mm) - 0.4, -0.6)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_xlabel("measured minus nominal length [mm], one sigma of the tracker")
    tolerance_mm = 1e3 * measured.reflectors.length_tolerance_m
    axes.set_title(f"Lengths between reflectors; tolerance ±{tolerance_mm:g} mm", loc="left")
    axes.grid(axis="x")


def _length_sigmas_m(measured: FrameInput) -> list[float]:
    """Give one sigma of each pair's distance, in the order of the length errors."""
    sigmas: list[float] = []
    for a, b in combinations(measured.reflectors.points_m, 2):
        first, second = measured.points[a], measured.points[b]
        along = unit(np.subtract(first.p_trk_m, second.p_trk_m))
        covariance = np.array(first.covariance_m2) + np.array(second.covariance_m2)
        sigmas.append(float(np.sqrt(along @ covariance @ along)))
    return sigmas


def bow_chart(pattern: PatternSpec, result: CameraResult) -> Figure:
    """Draw how far the board's surface lies from the plane it was designed on."""
    x = np.linspace(1.0, pattern.columns - 1.0, _N_SURFACE) * pattern.square_m
    y = np.linspace(1.0, pattern.rows - 1.0, _N_SURFACE) * pattern.square_m
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    points = np.column_stack([points, np.zeros(len(points))])
    height_mm = 1e3 * (bow_basis(points, pattern) @ result.bow_m).reshape(len(y), len(x))
    with style_context():
        figure = new_figure(7.0, 1.1 + 5.4 * pattern.rows / pattern.columns)
        axes = figure.add_subplot()
        largest = max(float(np.abs(height_mm).max()), 1e-6)
        shown = axes.contourf(
            1e3 * x,
            1e3 * y,
            height_mm,
            levels=np.linspace(-largest, largest, 21),
            cmap="RdBu_r",
        )
        corners = 1e3 * corner_points(pattern)
        axes.plot(corners[:, 0], corners[:, 1], ".", color="black", markersize=2)
        ticks = np.linspace(-largest, largest, 5)
        figure.colorbar(
            shown,
            ax=axes,
            label="z of board, away from the camera [mm]",
            ticks=ticks,
            format="%+.3f",
            shrink=0.75,
        )
        axes.set_title(f"Bow of the board\n{_bow_text(result)}", loc="left")
        axes.set_xlim(0.0, 1e3 * pattern.columns * pattern.square_m)
        axes.set_ylim(1e3 * pattern.rows * pattern.square_m, 0.0)
        axes.set_aspect("equal")
        axes.set_xlabel("x of board [mm]")
        axes.set_ylabel("y of board [mm]")
    return figure


def _bow_text(result: CameraResult) -> str:
    if not result.bow_m.any():
        return "taken as flat"
    sigmas = result.statistics.get("bow_sigma_m", {})
    return (
        ", ".join(
            f"{name.removesuffix('_m').replace('_', ' ')} {1e3 * value:+.3f}"
            + (f" ± {1e3 * sigmas[name]:.3f}" if name in sigmas else "")
            for name, value in zip(BOW_TERMS, result.bow_m, strict=True)
        )
        + " mm"
    )
