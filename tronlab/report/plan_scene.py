"""The robot's cell with the trajectory of a plan, in perspective and in true scale."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tronlab.geometry.poses import FloatArray, unit
from tronlab.planning.assessment import ShotAssessment
from tronlab.report.plan_charts import REFUSED_COLOUR, TAKEN_COLOUR, WARNED_COLOUR
from tronlab.report.plan_projection import View, draw_faces
from tronlab.report.plan_solids import Faces
from tronlab.report.plan_stage import SIGHT_COLOUR, Stage, cell_faces, floor_faces
from tronlab.report.plan_tables import state_of
from tronlab.report.style import new_figure, style_context

LAMP_COLOUR = "#c9a400"
_WIDTH_IN = 9.6


def perspective_picture(stage: Stage, shots: Sequence[ShotAssessment]) -> Figure:
    """Draw the cell as somebody sees it who stands beside it."""
    view = _bystander(stage)
    things = cell_faces(stage, shots)
    low, high = _extent(view, stage, things)
    width, height = high - low
    with style_context():
        figure = new_figure(_WIDTH_IN, float(np.clip(_WIDTH_IN * height / width, 3.5, 9.0)) + 0.4)
        axes = figure.add_subplot()
        _draw_scene(axes, view, stage, shots, things)
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_axis_off()
        _legend(figure, shots)
    return figure


def elevation_pictures(stage: Stage, shots: Sequence[ShotAssessment]) -> Figure:
    """Draw the cell from the side and from above in true scale, axes in metres of trs."""
    x, y, z = np.eye(3)
    things = cell_faces(stage, shots)
    views = (
        View(right_trs=z, up_trs=-x, towards_trs=-y),
        View(right_trs=z, up_trs=y, towards_trs=-x),
    )
    extents = [_extent(view, stage, things) for view in views]
    left, right = extents[0][0][0], extents[0][1][0]
    tallest = max(high[1] - low[1] for low, high in extents)
    panel_in = 0.5 * _WIDTH_IN - 0.6
    height_in = float(np.clip(panel_in * tallest / (right - left), 2.0, 8.0)) + 1.1
    with style_context():
        figure = new_figure(_WIDTH_IN, height_in)
        panels = figure.subplots(1, 2)
        for axes, view, (low, high) in zip(panels, views, extents, strict=True):
            _draw_scene(axes, view, stage, shots, things)
            axes.set_xlim(left, right)
            axes.set_ylim(low[1], high[1])
            axes.set_xlabel("Z [m], out of the model")
            axes.grid()
        panels[0].yaxis.set_major_formatter(lambda value, _: f"{0.0 - value:g}")
        panels[0].set_title("along Y, true scale")
        panels[0].set_ylabel("X [m], down")
        panels[1].set_title("along X, true scale")
        panels[1].set_ylabel("Y [m]")
        _legend(figure, shots)
    return figure


def _extent(view: View, stage: Stage, things: Sequence[Faces]) -> tuple[FloatArray, FloatArray]:
    """Give the lower left and upper right corner of what is drawn, with a margin for labels."""
    points = [faces.points_trs_m.reshape(-1, 3) for faces in things]
    places, _ = view.project(np.concatenate([*points, stage.context.lamp.p_trs_m[None]]))
    low, high = places.min(axis=0), places.max(axis=0)
    margin = 0.05 * float((high - low).max())
    return low - margin, high + margin


def _draw_scene(
    axes: Axes,
    view: View,
    stage: Stage,
    shots: Sequence[ShotAssessment],
    things: Sequence[Faces],
) -> None:
    draw_faces(axes, view, [floor_faces(stage, things)])
    draw_faces(axes, view, things)
    _draw_cameras(axes, view, shots)
    _label(axes, view, stage)
    axes.set_aspect("equal")


def _draw_cameras(axes: Axes, view: View, shots: Sequence[ShotAssessment]) -> None:
    """Draw where the camera is at every shot, over all bodies: these must not be hidden."""
    p_trs_m = np.array([shot.shot.trs_from_cam_nominal.translation for shot in shots])
    places, _ = view.project(p_trs_m)
    axes.plot(places[:, 0], places[:, 1], "-", color=TAKEN_COLOUR, linewidth=0.5, alpha=0.6)
    size = 3.0 if len(shots) <= 100 else 2.0
    for state, (colour, marker, factor) in _STATE_MARKS.items():
        which = np.array([state_of(shot) == state for shot in shots])
        axes.plot(
            places[which, 0],
            places[which, 1],
            marker,
            color=colour,
            markersize=factor * size,
            markeredgewidth=0,
            zorder=3,
        )


_STATE_LABELS = {"ok": "camera at a shot", "warned": "with a warning", "refused": "refused"}
_STATE_MARKS = {
    "ok": (TAKEN_COLOUR, "o", 1.0),
    "warned": (WARNED_COLOUR, "^", 1.4),
    "refused": (REFUSED_COLOUR, "X", 1.8),
}


def _label(axes: Axes, view: View, stage: Stage) -> None:
    """Name what stands in the cell, and mark the lamp."""
    lamp, _ = view.project(stage.context.lamp.p_trs_m)
    axes.plot(*lamp, "*", color=LAMP_COLOUR, markersize=13, markeredgecolor="black",
              markeredgewidth=0.5, zorder=4)  # fmt: skip
    model = stage.context.heightmap.origin_trs_m + np.array(
        [0.0, 0.5 * stage.context.heightmap.size_m[1], 0.0]
    )
    named = {
        "lamp": stage.context.lamp.p_trs_m,
        "tracker": stage.context.p_tracker_trs_m,
        "model": model,
        **{
            obstacle.name: obstacle.corners_trs_m.mean(axis=0)
            for obstacle in stage.context.scene.obstacles
        },
    }
    for name, p_trs_m in named.items():
        place, _ = view.project(p_trs_m)
        axes.annotate(
            name,
            xy=(float(place[0]), float(place[1])),
            xytext=(7, 7),
            textcoords="offset points",
            fontsize=8,
            zorder=5,
            bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.75},
        )


def _legend(figure: Figure, shots: Sequence[ShotAssessment]) -> None:
    present = {state_of(shot) for shot in shots}
    marks = [
        Line2D([], [], color=colour, marker=marker, linestyle="", label=_STATE_LABELS[state])
        for state, (colour, marker, _) in _STATE_MARKS.items()
        if state in present
    ]
    lines = [
        Line2D([], [], color=TAKEN_COLOUR, linewidth=0.8, label="what it sees"),
        Line2D([], [], color=SIGHT_COLOUR, linewidth=1.2, label="tracker to T-MAC"),
    ]
    handles = [*marks, *lines]
    figure.legend(handles=handles, ncols=len(handles), fontsize=8, loc="outside upper center")


def _bystander(stage: Stage) -> View:
    """Stand beside the rail and above it, across from the tracker, so as to see the model."""
    up = stage.trs_from_rail.rotation.apply([0.0, 0.0, 1.0])
    size_x, size_y = stage.context.heightmap.size_m
    model = stage.context.heightmap.origin_trs_m + 0.5 * np.array([size_x, size_y, 0.0])
    far = stage.trs_from_rail.apply(stage.rail_range_m[0] * stage.context.mounting.rail_axis)
    along = far - model
    aside = unit(np.cross(up, along))
    middle = 0.5 * (model + far)
    if aside @ (stage.context.p_tracker_trs_m - middle) > 0:
        aside = -aside
    span = float(np.linalg.norm(along))
    eye = middle + span * (2.0 * aside + 1.0 * up) + 1.2 * along
    return View.from_eye(eye, middle, up)
