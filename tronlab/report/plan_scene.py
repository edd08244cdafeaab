"""The robot's cell with the trajectory of a plan, in perspective and in true scale."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray, unit
from tronlab.planning.assess import PlanContext
from tronlab.planning.assessment import ShotAssessment
from tronlab.planning.collision import PLATE, Capsule, Solid, solids_at
from tronlab.report.plan_charts import (
    LIMIT_COLOUR,
    REFUSED_COLOUR,
    TAKEN_COLOUR,
    WARNED_COLOUR,
)
from tronlab.report.plan_projection import View, draw_faces
from tronlab.report.plan_solids import Faces, box, box_corners, capsule, line, sheet, terrain
from tronlab.report.style import new_figure, style_context

ARM_COLOUR = "#f08a24"
FOOT_COLOUR = "#c7782e"
PLATE_COLOUR = "#5b6470"
RAIL_COLOUR = "#8c96a3"
OBSTACLE_COLOUR = "#b08fbf"
FLOOR_COLOUR = "#e9ebee"
SIGHT_COLOUR = "#009e73"
LAMP_COLOUR = "#c9a400"
TRACKER_COLOUR = "#2f4858"
_N_POSTURES = 3
"""The robot is drawn at so many shots."""
_N_REFUSED_VIEWS = 6
"""Cameras of so many refused shots are drawn as well."""
_SHORT_VIEW_M = 0.25
"""How far the pyramid of a refused shot's camera is drawn."""
_RAIL_WIDTH_M = 0.4
_RAIL_HEIGHT_M = 0.12
_FLOOR_MARGIN_M = 3.0
_WIDTH_IN = 9.6


@dataclass(frozen=True, slots=True)
class Stage:
    """What is drawn: what a plan was held against, and the rail it is driven along."""

    context: PlanContext
    rail_range_m: tuple[float, float]

    @property
    def trs_from_rail(self) -> RigidTransform:
        """Get where the rail is."""
        return self.context.mounting.trs_from_rail

    @property
    def floor_rail_m(self) -> float:
        """Get the height of the floor in rail."""
        return -self.context.cell.envelope.floor_below_rail_m


def perspective_picture(stage: Stage, shots: Sequence[ShotAssessment]) -> Figure:
    """Draw the cell as somebody sees it who stands beside it."""
    view = _bystander(stage)
    things = _things(stage, shots)
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
    things = _things(stage, shots)
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


def _things(stage: Stage, shots: Sequence[ShotAssessment]) -> list[Faces]:
    """Give all bodies and lines but the floor."""
    return [
        terrain(stage.context.heightmap, stage.context.p_lamp_trs_m),
        *_rail(stage),
        *(
            faces
            for obstacle in stage.context.scene.obstacles
            for faces in box(obstacle.corners_trs_m, colour=OBSTACLE_COLOUR, opacity=0.6)
        ),
        *_tracker(stage),
        _plumb(stage, stage.context.p_lamp_trs_m),
        *(part for shot in _drawn(shots) for part in _robot(stage, shot)),
        *_views(stage, shots),
        *_sights(stage, shots),
    ]


def _extent(view: View, stage: Stage, things: Sequence[Faces]) -> tuple[FloatArray, FloatArray]:
    """Give the lower left and upper right corner of what is drawn, with a margin for labels."""
    points = [faces.points_trs_m.reshape(-1, 3) for faces in things]
    places, _ = view.project(np.concatenate([*points, stage.context.p_lamp_trs_m[None]]))
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
    draw_faces(axes, view, [_floor(stage, things)])
    draw_faces(axes, view, things)
    _draw_cameras(axes, view, shots)
    _label(axes, view, stage)
    axes.set_aspect("equal")


def _drawn(shots: Sequence[ShotAssessment]) -> list[ShotAssessment]:
    """Choose the shots at which the robot is drawn: apart along the rail, so that they are told."""
    able = [(shot.posture.rail_m, shot) for shot in shots if shot.posture and not shot.is_refused]
    able.sort(key=lambda pair: pair[0])
    at = np.unique(np.linspace(0, len(able) - 1, min(_N_POSTURES, len(able))).round().astype(int))
    return [able[int(i)][1] for i in at]


def _robot(stage: Stage, shot: ShotAssessment) -> list[Faces]:
    if shot.posture is None:
        return []
    obstacles = {obstacle.name for obstacle in stage.context.scene.obstacles}
    return [
        faces
        for solid in solids_at(shot.posture, stage.context.scene)
        if solid.name not in obstacles
        for faces in _robot_part(solid)
    ]


def _robot_part(solid: Solid) -> tuple[Faces, ...]:
    if isinstance(solid, Capsule):
        return (capsule(solid.p0_trs_m, solid.p1_trs_m, solid.radius_m, colour=ARM_COLOUR),)
    return box(solid.corners_trs_m, colour=PLATE_COLOUR if solid.name == PLATE else FOOT_COLOUR)


def _rail(stage: Stage) -> tuple[Faces, Faces]:
    """Give the rail as a bar on the floor as long as the robot's base may go."""
    start, end = np.outer(stage.rail_range_m, stage.context.mounting.rail_axis)
    half, floor_m = 0.5 * _RAIL_WIDTH_M, stage.floor_rail_m
    corners = box_corners(
        (start[0], start[1] - half, floor_m), (end[0], end[1] + half, floor_m + _RAIL_HEIGHT_M)
    )
    return box(stage.trs_from_rail.apply(corners), colour=RAIL_COLOUR)


def _floor(stage: Stage, things: Sequence[Faces]) -> Faces:
    """Give the floor below all that is drawn."""
    points_trs_m = np.concatenate([faces.points_trs_m.reshape(-1, 3) for faces in things])
    p_rail = stage.trs_from_rail.inv().apply(points_trs_m)
    low, high = p_rail.min(axis=0) - _FLOOR_MARGIN_M, p_rail.max(axis=0) + _FLOOR_MARGIN_M
    z = stage.floor_rail_m
    corners = np.array(
        [[low[0], low[1], z], [high[0], low[1], z], [high[0], high[1], z], [low[0], high[1], z]]
    )
    return sheet(stage.trs_from_rail.apply(corners), colour=FLOOR_COLOUR)


def _tracker(stage: Stage) -> list[Faces]:
    """Give a head on a stand, down to the floor."""
    head = stage.context.p_tracker_trs_m
    foot = _foot(stage, head)
    return [
        capsule(head, head + 0.02 * (foot - head), 0.11, colour=TRACKER_COLOUR),
        capsule(head, foot, 0.05, colour=TRACKER_COLOUR),
    ]


def _foot(stage: Stage, p_trs_m: FloatArray) -> FloatArray:
    """Give the point of the floor below a point."""
    p_rail = stage.trs_from_rail.inv().apply(p_trs_m)
    return stage.trs_from_rail.apply([p_rail[0], p_rail[1], stage.floor_rail_m])


def _plumb(stage: Stage, p_trs_m: FloatArray) -> Faces:
    """Give the line from a point down to the floor: it shows where a thing up there is."""
    return line(np.array([p_trs_m, _foot(stage, p_trs_m)]), colour=LIMIT_COLOUR, width=0.6)


def _views(stage: Stage, shots: Sequence[ShotAssessment]) -> list[Faces]:
    """Give what the camera sees at the drawn shots, and shortly where shots are refused."""
    refused = [shot for shot in shots if shot.is_refused]
    at = np.linspace(0, len(refused) - 1, min(_N_REFUSED_VIEWS, len(refused))).round().astype(int)
    drawn = [
        *((shot, shot.range_los_m, TAKEN_COLOUR) for shot in _drawn(shots)),
        *((refused[int(i)], _SHORT_VIEW_M, REFUSED_COLOUR) for i in at),
    ]
    return [
        _pyramid(stage.context.camera, shot.shot.trs_from_cam_nominal, depth_m, colour)
        for shot, depth_m, colour in drawn
    ]


def _pyramid(
    camera: CameraModel, trs_from_cam: RigidTransform, depth_m: float, colour: str
) -> Faces:
    """Give the edges of what a camera sees, up to a depth."""
    right, bottom = camera.width_px - 0.5, camera.height_px - 0.5
    rays = camera.rays([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
    reach_m = depth_m if np.isfinite(depth_m) else 1.0
    corners = trs_from_cam.apply(reach_m * np.column_stack([rays, np.ones(4)]))
    eye = trs_from_cam.translation
    way = [eye, corners[0], corners[1], eye, corners[2], corners[3], eye]
    edges = line(np.array(way), colour=colour, width=0.8)
    closing = line(np.array([corners[1], corners[2]]), colour=colour, width=0.8)
    last = line(np.array([corners[3], corners[0]]), colour=colour, width=0.8)
    return Faces(
        np.concatenate([edges.points_trs_m, closing.points_trs_m, last.points_trs_m]),
        np.concatenate([edges.colours, closing.colours, last.colours]),
        line_width=0.8,
    )


def _sights(stage: Stage, shots: Sequence[ShotAssessment]) -> list[Faces]:
    """Give the tracker's beam at the drawn shots, and where it is broken."""
    broken = [s for s in shots if any(f.check == "sight" and f.is_refusal for f in s.findings)]
    return [
        line(
            np.array([stage.context.p_tracker_trs_m, _p_tmac(stage, shot)]),
            colour=colour,
            width=width,
        )
        for some, colour, width in (
            (_drawn(shots), SIGHT_COLOUR, 1.2),
            (broken[:_N_REFUSED_VIEWS], REFUSED_COLOUR, 0.7),
        )
        for shot in some
    ]


def _p_tmac(stage: Stage, shot: ShotAssessment) -> FloatArray:
    return (shot.shot.trs_from_cam_nominal * stage.context.tmac_from_cam.inv()).translation


def _draw_cameras(axes: Axes, view: View, shots: Sequence[ShotAssessment]) -> None:
    """Draw where the camera is at every shot, over all bodies: these must not be hidden."""
    p_trs_m = np.array([shot.shot.trs_from_cam_nominal.translation for shot in shots])
    places, _ = view.project(p_trs_m)
    axes.plot(places[:, 0], places[:, 1], "-", color=TAKEN_COLOUR, linewidth=0.5, alpha=0.6)
    size = 3.0 if len(shots) <= 100 else 2.0
    for state, (colour, marker, factor) in _STATE_MARKS.items():
        which = np.array([_state(shot) == state for shot in shots])
        axes.plot(
            places[which, 0],
            places[which, 1],
            marker,
            color=colour,
            markersize=factor * size,
            markeredgewidth=0,
            zorder=3,
        )


_STATE_LABELS = {"ok": "camera at a shot", "warning": "with a warning", "refused": "refused"}
_STATE_MARKS = {
    "ok": (TAKEN_COLOUR, "o", 1.0),
    "warning": (WARNED_COLOUR, "^", 1.4),
    "refused": (REFUSED_COLOUR, "X", 1.8),
}


def _state(shot: ShotAssessment) -> str:
    if shot.is_refused:
        return "refused"
    return "warning" if shot.findings else "ok"


def _label(axes: Axes, view: View, stage: Stage) -> None:
    """Name what stands in the cell, and mark the lamp."""
    lamp, _ = view.project(stage.context.p_lamp_trs_m)
    axes.plot(*lamp, "*", color=LAMP_COLOUR, markersize=13, markeredgecolor="black",
              markeredgewidth=0.5, zorder=4)  # fmt: skip
    model = stage.context.heightmap.origin_trs_m + np.array(
        [0.0, 0.5 * stage.context.heightmap.size_m[1], 0.0]
    )
    named = {
        "lamp": stage.context.p_lamp_trs_m,
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
    present = {_state(shot) for shot in shots}
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
