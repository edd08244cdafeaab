"""The examination of a single shot: all checks but that of the way to it."""

from collections.abc import Sequence
from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform

from tronlab.devices.protocols import MotionModel
from tronlab.devices.readings import Posture, RobotTarget
from tronlab.errors import LimitError
from tronlab.geometry.poses import FloatArray
from tronlab.planning.assessment import Finding
from tronlab.planning.clearance import MODEL, clearances
from tronlab.planning.collision import Scene, Solid, solids_at
from tronlab.planning.context import PlanContext
from tronlab.planning.light import Light, light_findings, light_on_view
from tronlab.planning.passage import ClearanceCheck, check_clearance_along
from tronlab.planning.reach import Reach
from tronlab.planning.shots import Shot
from tronlab.planning.sight import Sight, bar_in_beam, sight_findings, sight_of, terrain_in_beam
from tronlab.planning.view import View, view_findings, view_from


@dataclass(frozen=True, slots=True)
class Exam:
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
        """Get all that was found."""
        return (*self.reach.findings, *self.clearance.findings, *self.others)

    @property
    def is_refused(self) -> bool:
        """Get whether the shot cannot be taken."""
        return _any_refusal(self.findings)


class Examiner:
    """Examines shots one by one, whatever the way to them."""

    def __init__(self, context: PlanContext) -> None:
        self.context = context

    def examine(self, shot: Shot, reach: Reach, check: ClearanceCheck) -> Exam:
        """Examine a shot at which the robot stands as ``reach`` and ``check`` say."""
        trs_from_cam, solids = shot.trs_from_cam_nominal, self._solids(reach.posture)
        sight, in_sight = self._sight(trs_from_cam, solids)
        view, in_view = self._view(trs_from_cam)
        light, in_light = self._light(trs_from_cam, solids)
        return Exam(
            reach=reach,
            sight=sight,
            view=view,
            light=light,
            clearance=check,
            others=(*in_sight, *in_view, *in_light),
        )

    def can_be_taken(
        self,
        trs_from_cam: RigidTransform,
        motion: MotionModel,
        *,
        before: Posture | None,
        after: RobotTarget | None,
    ) -> bool:
        """Tell whether a pose passes all checks.

        Args:
            trs_from_cam: The pose.
            motion: How the robot moves.
            before: How it stands at the shot before; None: this would be the first one.
            after: Where it goes next; None: this would be the last one.
        """
        if _any_refusal(self._view(trs_from_cam)[1]):
            return False
        target = self.context.mounting.robot_target(trs_from_cam)
        try:
            posture = motion.posture_for(target, near=before)
            behind = None if after is None else motion.posture_for(after, near=posture)
        except LimitError:
            return False
        solids, scene = self._solids(posture), self.context.scene
        way = [p for p in (before, posture, behind) if p is not None]
        return not (
            _any_refusal(self._sight(trs_from_cam, solids)[1])
            or _any_refusal(check_postures([posture], scene)[0].findings)
            or _any_refusal(self._light(trs_from_cam, solids)[1])
            or any(_any_refusal(check.findings) for check in check_clearance_along(way, scene))
        )

    def _solids(self, posture: Posture | None) -> tuple[Solid, ...]:
        return () if posture is None else solids_at(posture, self.context.scene)

    def _sight(
        self, trs_from_cam: RigidTransform, solids: Sequence[Solid]
    ) -> tuple[Sight, list[Finding]]:
        context, spec = self.context, self.context.cell.sight
        trs_from_tmac = trs_from_cam * context.tmac_from_cam.inv()
        sight = sight_of(context.p_tracker_trs_m, trs_from_tmac, spec)
        findings = sight_findings(sight, spec)
        if bar := self._bar_in_beam(trs_from_tmac.translation, solids):
            findings.append(Finding("sight", f"{bar} is in the way from the tracker to the T-MAC"))
        return sight, findings

    def _bar_in_beam(self, p_tmac_trs_m: FloatArray, solids: Sequence[Solid]) -> str:
        context, radius_m = self.context, self.context.cell.sight.beam_radius_m
        beam = context.p_tracker_trs_m, p_tmac_trs_m
        if terrain_in_beam(*beam, beam_radius_m=radius_m, range_finder=context.renderer):
            return MODEL
        bars = (*solids, *context.scene.obstacles)
        return bar_in_beam(*beam, bars, beam_radius_m=radius_m)

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
        light = light_on_view(
            trs_from_cam,
            renderer=context.renderer,
            camera=context.camera,
            lamp=context.lamp,
            robot=solids,
        )
        return light, light_findings(
            light,
            min_lit_fraction=context.rules.min_lit_fraction,
            max_robot_shadow=context.rules.max_robot_shadow,
        )


def check_postures(postures: Sequence[Posture | None], scene: Scene) -> tuple[ClearanceCheck, ...]:
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


def _any_refusal(findings: Sequence[Finding]) -> bool:
    return any(finding.is_refusal for finding in findings)
