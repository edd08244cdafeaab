"""Everything that can be known of a plan before the robot moves, shot by shot."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.devices.cell import CellSpec
from tronlab.devices.mounting import Mounting
from tronlab.devices.protocols import MotionModel, Robot
from tronlab.devices.readings import Posture
from tronlab.errors import LimitError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.planning.assessment import Finding, PlanAssessment, ShotAssessment, ShotDuration
from tronlab.planning.collision import Scene, Solid, solids_at
from tronlab.planning.duration import Timing, drift_checks_s, shot_duration
from tronlab.planning.feasible import nearest_feasible
from tronlab.planning.light import Light, light_findings, light_on_view
from tronlab.planning.passage import ClearanceCheck, check_clearance_along
from tronlab.planning.reach import Reach, check_reach_along
from tronlab.planning.shots import Plan, RangeFinder, Shot
from tronlab.planning.sight import Sight, bar_in_beam, sight_findings, sight_of, terrain_in_beam
from tronlab.planning.view import View, view_findings, view_from
from tronlab.render.renderer import Renderer
from tronlab.terrain.heightmap import HeightMap

_TRIES_IN_ALL = 2000
_TRIES_A_SHOT = 100
_FEWEST_TRIES = 15
"""Poses that are tried instead of refused ones; many refused shots share what there is."""

_SAME_RAD = 1e-6
"""Axes that differ by no more than rounding stand alike."""

_NO_TIME = ShotDuration(
    move_s=0.0, settle_s=0.0, tracker_s=0.0, camera_s=0.0, confirm_s=0.0, read_s=0.0, write_s=0.0
)


class TerrainRenderer(Renderer, RangeFinder, Protocol):
    """Renders the terrain, and measures distances to it."""


@dataclass(frozen=True, slots=True)
class Rules:
    """What a campaign wants of its shots."""

    min_usable_fraction: float
    range_los_m: tuple[float, float]
    """Least and greatest."""
    min_lit_fraction: float
    max_robot_shadow: float


@dataclass(frozen=True)
class PlanContext:
    """What a plan is held against: laboratory as calibrated, cell, and the campaign's wishes."""

    robot: Robot
    """Not connected; what it cannot say without a connection is not checked."""
    mounting: Mounting
    camera: CameraModel
    tmac_from_cam: RigidTransform
    p_tracker_trs_m: FloatArray
    """Where the tracker measures from, shape (3,)."""
    p_lamp_trs_m: FloatArray
    """Centre of the light, shape (3,)."""
    heightmap: HeightMap
    renderer: TerrainRenderer
    cell: CellSpec
    rules: Rules
    timing: Timing
    scene: Scene = field(init=False)
    """Bodies of the robot and what stands around it."""

    def __post_init__(self) -> None:
        scene = Scene.of(self.heightmap, self.mounting, self.cell.envelope)
        object.__setattr__(self, "scene", scene)

    @property
    def motion(self) -> MotionModel | None:
        """Get the robot as one that can say how it would move, if it can."""
        return self.robot if isinstance(self.robot, MotionModel) else None


def assess(
    plan: Plan, context: PlanContext, *, on_shot: Callable[[int, int], None] | None = None
) -> PlanAssessment:
    """Hold a plan against everything that is known of the laboratory; nothing moves.

    Ways are checked, and timed, between shots that will be taken: refused ones are passed by. How
    long the way to the first shot takes is not known, for nobody knows where the robot stands.

    Args:
        plan: Shots in the order they would be taken.
        context: What it is held against.
        on_shot: Told (shots examined, shots in all) after each.
    """
    examiner = _Examiner(context)
    exams: dict[int, _Exam] = {}
    reaches = check_reach_along(plan.shots, context.robot)
    checks = _check_postures([reach.posture for reach in reaches], context.scene)
    todo = zip(plan.shots, reaches, checks, strict=True)
    for n_done, (shot, reach, check) in enumerate(todo, start=1):
        exams[shot.shot_id] = examiner.examine(shot, _apart_from_way(reach), check)
        if on_shot is not None:
            on_shot(n_done, len(plan.shots))
    taken = _check_ways(plan.shots, exams, examiner)
    moves_s = _moves_s(taken, exams, context.motion)
    alternatives = _alternatives(plan.shots, exams, examiner)
    timing, pace = context.timing, context.cell.pace

    def assessed(shot: Shot) -> ShotAssessment:
        exam, move_s = exams[shot.shot_id], moves_s.get(shot.shot_id)
        return ShotAssessment(
            shot=shot,
            posture=exam.reach.posture,
            findings=exam.findings,
            range_los_m=exam.view.range_los_m,
            usable_fraction=exam.view.usable_fraction,
            lit_fraction=exam.light.lit_fraction,
            robot_shadow=exam.light.robot_shadow,
            tmac_distance_m=exam.sight.distance_m,
            tmac_angle_rad=exam.sight.angle_rad,
            clearance_m=exam.clearance.least_m,
            duration=_NO_TIME if move_s is None else shot_duration(timing, pace, move_s=move_s),
            nearest=alternatives.get(shot.shot_id),
        )

    return PlanAssessment(
        shots=tuple(assessed(shot) for shot in plan.shots),
        drift_checks_s=drift_checks_s(timing, pace, n_shots=len(taken)) if taken else 0.0,
        start_s=pace.start_s,
    )


@dataclass(frozen=True, slots=True)
class _Exam:
    """What was found out about one shot; the way to it as far as it was looked at."""

    reach: Reach
    sight: Sight
    view: View
    light: Light
    clearance: ClearanceCheck
    others: tuple[Finding, ...]
    """Of sight, view and light."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        return (*self.reach.findings, *self.clearance.findings, *self.others)

    @property
    def is_refused(self) -> bool:
        return any(finding.is_refusal for finding in self.findings)


class _Examiner:
    """Examines shots one by one, whatever the way to them."""

    def __init__(self, context: PlanContext) -> None:
        self.context = context

    def examine(self, shot: Shot, reach: Reach, check: ClearanceCheck) -> _Exam:
        trs_from_cam, solids = shot.trs_from_cam_nominal, self._solids(reach.posture)
        sight, in_sight = self._sight(trs_from_cam, solids)
        view, in_view = self._view(trs_from_cam)
        light, in_light = self._light(trs_from_cam, solids)
        return _Exam(
            reach=reach,
            sight=sight,
            view=view,
            light=light,
            clearance=check,
            others=(*in_sight, *in_view, *in_light),
        )

    def can_be_taken(self, trs_from_cam: RigidTransform, *, near: Posture | None) -> bool:
        """Tell whether a pose passes all checks but the one of the way there; cheap ones first."""
        motion, posture = self.context.motion, None
        if motion is not None:
            try:
                target = self.context.mounting.robot_target(trs_from_cam)
                posture = motion.posture_for(target, near=near)
            except LimitError:
                return False
        solids = self._solids(posture)
        checks: tuple[Callable[[], Sequence[Finding]], ...] = (
            lambda: self._sight(trs_from_cam, solids)[1],
            lambda: self._view(trs_from_cam)[1],
            lambda: _check_postures([posture], self.context.scene)[0].findings,
            lambda: self._light(trs_from_cam, solids)[1],
        )
        return not any(finding.is_refusal for check in checks for finding in check())

    def _solids(self, posture: Posture | None) -> tuple[Solid, ...]:
        return () if posture is None else solids_at(posture, self.context.scene)

    def _sight(
        self, trs_from_cam: RigidTransform, solids: Sequence[Solid]
    ) -> tuple[Sight, list[Finding]]:
        context, spec = self.context, self.context.cell.sight
        p_tracker, trs_from_tmac = (
            context.p_tracker_trs_m,
            trs_from_cam * context.tmac_from_cam.inv(),
        )
        sight = sight_of(p_tracker, trs_from_tmac, spec)
        bar = bar_in_beam(
            p_tracker, trs_from_tmac.translation, solids, beam_radius_m=spec.beam_radius_m
        )
        if not bar and terrain_in_beam(
            p_tracker,
            trs_from_tmac.translation,
            beam_radius_m=spec.beam_radius_m,
            range_finder=context.renderer,
        ):
            bar = "terrain model"
        findings = sight_findings(sight, spec)
        if bar:
            findings.append(Finding("sight", f"{bar} is in the way from the tracker to the T-MAC"))
        return sight, findings

    def _view(self, trs_from_cam: RigidTransform) -> tuple[View, list[Finding]]:
        context = self.context
        view = view_from(
            trs_from_cam,
            heightmap=context.heightmap,
            camera=context.camera,
            range_finder=context.renderer,
        )
        return view, view_findings(
            view,
            allowed_range_m=context.rules.range_los_m,
            min_usable_fraction=context.rules.min_usable_fraction,
        )

    def _light(
        self, trs_from_cam: RigidTransform, solids: Sequence[Solid]
    ) -> tuple[Light, list[Finding]]:
        context = self.context
        obstacles = context.cell.envelope.obstacles
        light = light_on_view(
            trs_from_cam,
            renderer=context.renderer,
            camera=context.camera,
            p_lamp_trs_m=context.p_lamp_trs_m,
            robot=[solid for solid in solids if solid.name not in obstacles],
        )
        return light, light_findings(
            light,
            min_lit_fraction=context.rules.min_lit_fraction,
            max_robot_shadow=context.rules.max_robot_shadow,
        )


def _check_postures(postures: Sequence[Posture | None], scene: Scene) -> tuple[ClearanceCheck, ...]:
    """Check how the robot stands at each shot, all at once; no ways."""
    standing = [posture for posture in postures if posture is not None]
    found = iter(clearances(standing, scene) if standing else ())

    def check(posture: Posture | None) -> ClearanceCheck:
        if posture is None:
            return ClearanceCheck(None, None, ())
        clearance = next(found)
        if clearance.distance_m >= scene.envelope.clearance_m:
            return ClearanceCheck(clearance, None, ())
        return check_clearance_along([posture], scene)[0]

    return tuple(check(posture) for posture in postures)


def _check_ways(
    shots: Sequence[Shot], exams: dict[int, _Exam], examiner: _Examiner
) -> tuple[Shot, ...]:
    """Find the shots that will be taken, and put what was found on the ways to them into exams.

    Whoever is refused is passed by, which makes another way, and may be another posture.
    """
    context = examiner.context
    taken = tuple(shot for shot in shots if not exams[shot.shot_id].is_refused)
    while taken:
        reaches = check_reach_along(taken, context.robot)
        ways = check_clearance_along([reach.posture for reach in reaches], context.scene)
        for shot, reach, way in zip(taken, reaches, ways, strict=True):
            exam = exams[shot.shot_id]
            if _stands_as(exam.reach.posture, reach.posture):
                exams[shot.shot_id] = replace(exam, reach=reach, clearance=way)
            else:
                exams[shot.shot_id] = examiner.examine(shot, reach, way)
        refused = [exams[shot.shot_id].is_refused for shot in taken]
        if not any(refused):
            break
        # After a refused shot the way is another one: whether that is free shows the next time.
        is_last_before_refused = (False, *refused[:-1])
        taken = tuple(
            shot
            for shot, is_refused, is_after in zip(
                taken, refused, is_last_before_refused, strict=True
            )
            if not is_refused or is_after
        )
    return taken


def _apart_from_way(reach: Reach) -> Reach:
    """Leave out what holds only if the shot before is taken."""
    findings = tuple(finding for finding in reach.findings if finding.check != "branch")
    return replace(reach, findings=findings)


def _stands_as(a: Posture | None, b: Posture | None) -> bool:
    if a is None or b is None:
        return a is b
    turns_rad = a.axes_rad - b.axes_rad  # whole turns bring every body to the same place
    return a.rail_m == b.rail_m and float(np.abs(np.sin(turns_rad / 2.0)).max()) < _SAME_RAD


def _moves_s(
    taken: Sequence[Shot], exams: Mapping[int, _Exam], motion: MotionModel | None
) -> dict[int, float]:
    """Give how long the way to each shot that will be taken takes; 0 where nobody can tell."""
    moves_s = {shot.shot_id: 0.0 for shot in taken}
    for before, shot in pairwise(taken):
        start, end = (exams[s.shot_id].reach.posture for s in (before, shot))
        if motion is not None and start is not None and end is not None:
            moves_s[shot.shot_id] = motion.move_duration_s(start, end)
    return moves_s


def _alternatives(
    shots: Sequence[Shot], exams: Mapping[int, _Exam], examiner: _Examiner
) -> dict[int, RigidTransform]:
    """Look for a pose near each refused shot that can be taken; none without a motion model."""
    refused = [shot for shot in shots if exams[shot.shot_id].is_refused]
    if not refused or examiner.context.motion is None:
        return {}
    max_tries = int(np.clip(_TRIES_IN_ALL // len(refused), _FEWEST_TRIES, _TRIES_A_SHOT))
    accepted = [shot.trs_from_cam_nominal for shot in shots if not exams[shot.shot_id].is_refused]
    found: dict[int, RigidTransform] = {}
    for shot in refused:
        near = exams[shot.shot_id].reach.posture
        nearest = nearest_feasible(
            shot.trs_from_cam_nominal,
            [*accepted, *found.values()],
            partial(examiner.can_be_taken, near=near),
            max_tries=max_tries,
        )
        if nearest is not None:
            found[shot.shot_id] = nearest
    return found
