"""What stands in the robot's cell, and what is seen from where, as faces to be drawn."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.planning.assessment import ShotAssessment
from tronlab.planning.collision import PLATE, Capsule, Solid, solids_at
from tronlab.planning.context import PlanContext
from tronlab.report.plan_charts import LIMIT_COLOUR, REFUSED_COLOUR, TAKEN_COLOUR
from tronlab.report.plan_solids import Faces, box, box_corners, capsule, line, sheet, terrain

ARM_COLOUR = "#f08a24"
FOOT_COLOUR = "#c7782e"
PLATE_COLOUR = "#5b6470"
RAIL_COLOUR = "#8c96a3"
OBSTACLE_COLOUR = "#b08fbf"
FLOOR_COLOUR = "#e9ebee"
TRACKER_COLOUR = "#2f4858"
SIGHT_COLOUR = "#009e73"
_N_POSTURES = 3
"""The robot is drawn at so many shots."""
_N_REFUSED_VIEWS = 6
"""Cameras of so many refused shots are drawn as well."""
_SHORT_VIEW_M = 0.25
"""How far the pyramid of a refused shot's camera is drawn."""
_RAIL_WIDTH_M = 0.4
_RAIL_HEIGHT_M = 0.12
_FLOOR_MARGIN_M = 3.0


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


def cell_faces(stage: Stage, shots: Sequence[ShotAssessment]) -> list[Faces]:
    """Give all bodies and lines but the floor."""
    return [
        terrain(stage.context.heightmap, stage.context.lamp.p_trs_m),
        *_rail(stage),
        *(
            faces
            for obstacle in stage.context.scene.obstacles
            for faces in box(obstacle.corners_trs_m, colour=OBSTACLE_COLOUR, opacity=0.6)
        ),
        *_tracker(stage),
        _plumb(stage, stage.context.lamp.p_trs_m),
        *(part for shot in _drawn(shots) for part in _robot(stage, shot)),
        *_views(stage, shots),
        *_sights(stage, shots),
    ]


def _drawn(shots: Sequence[ShotAssessment]) -> list[ShotAssessment]:
    """Choose the shots at which the robot is drawn: apart along the rail, so that they are told."""
    able = [(shot.posture.rail_m, shot) for shot in shots if shot.posture and not shot.is_refused]
    able.sort(key=lambda pair: pair[0])
    at = np.unique(np.linspace(0, len(able) - 1, min(_N_POSTURES, len(able))).round().astype(int))
    return [able[int(i)][1] for i in at]


def _robot(stage: Stage, shot: ShotAssessment) -> list[Faces]:
    if shot.posture is None:
        return []
    return [
        faces
        for solid in solids_at(shot.posture, stage.context.scene)
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


def floor_faces(stage: Stage, things: Sequence[Faces]) -> Faces:
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


def _plumb(stage: Stage, p_trs_m: FloatArray) -> Faces:
    """Give the line from a point down to the floor: it shows where a thing up there is."""
    return line(np.array([p_trs_m, _foot(stage, p_trs_m)]), colour=LIMIT_COLOUR, width=0.6)


def _foot(stage: Stage, p_trs_m: FloatArray) -> FloatArray:
    """Give the point of the floor below a point."""
    p_rail = stage.trs_from_rail.inv().apply(p_trs_m)
    return stage.trs_from_rail.apply([p_rail[0], p_rail[1], stage.floor_rail_m])


def _views(stage: Stage, shots: Sequence[ShotAssessment]) -> list[Faces]:
    """Give what the camera sees at the drawn shots, and shortly where shots are refused."""
    refused = [shot for shot in shots if shot.is_refused]
    at = np.linspace(0, len(refused) - 1, min(_N_REFUSED_VIEWS, len(refused))).round().astype(int)
    drawn = [
        *((shot, shot.range_los_m, TAKEN_COLOUR) for shot in _drawn(shots)),
        *((refused[int(i)], _SHORT_VIEW_M, REFUSED_COLOUR) for i in at),
    ]
    return [
        edge
        for shot, depth_m, colour in drawn
        for edge in _pyramid(stage.context.camera, shot.shot.trs_from_cam_nominal, depth_m, colour)
    ]


def _pyramid(
    camera: CameraModel, trs_from_cam: RigidTransform, depth_m: float, colour: str
) -> list[Faces]:
    """Give the edges of what a camera sees, up to a depth."""
    right, bottom = camera.width_px - 0.5, camera.height_px - 0.5
    rays = camera.rays([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
    reach_m = depth_m if np.isfinite(depth_m) else 1.0
    corners = trs_from_cam.apply(reach_m * np.column_stack([rays, np.ones(4)]))
    eye = trs_from_cam.translation
    ways = [corners[[0, 1, 2, 3, 0]], *(np.stack([eye, corner]) for corner in corners)]
    return [line(way, colour=colour) for way in ways]


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
