"""What is known of a campaign before any device is connected: its plan, assessed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.config import CampaignConfig
from tronlab.campaign.drift import n_checks
from tronlab.campaign.job import Job
from tronlab.campaign.live import Live
from tronlab.campaign.rig import Rig
from tronlab.devices.protocols import MotionModel, Robot
from tronlab.devices.registry import make_device
from tronlab.errors import PlanError
from tronlab.planning.assess import MAX_TRIES, assess
from tronlab.planning.assessment import PlanAssessment
from tronlab.planning.context import PlanContext, Rules, TerrainRenderer
from tronlab.planning.duration import Timing
from tronlab.planning.order import in_least_motion
from tronlab.planning.shots import Plan, Shot
from tronlab.terrain.heightmap import HeightMap

_STAGE = "plan"
_N_NAMED = 20
"""So many refused shots a message lists; a long campaign can have thousands."""


@dataclass(frozen=True)
class Foresight:
    """A plan in the order it would be taken, what it comes to, and what it was held against."""

    assessment: PlanAssessment
    context: PlanContext

    @property
    def heightmap(self) -> HeightMap:
        """Get the terrain model."""
        return self.context.heightmap

    @property
    def renderer(self) -> TerrainRenderer:
        """Get who renders it."""
        return self.context.renderer

    @property
    def shots(self) -> tuple[Shot, ...]:
        """Get the shots that can be taken, in order."""
        return tuple(shot.shot for shot in self.assessment.shots if not shot.is_refused)

    @property
    def plan(self) -> Plan:
        """Get the shots that can be taken, in order.

        Raises:
            PlanError: There is none.
        """
        if not self.shots:
            raise PlanError(_refusal(self.assessment))
        return Plan(self.shots)


def foresee(
    job: Job, shots: Sequence[Shot], *, live: Live, max_tries: int = MAX_TRIES
) -> Foresight:
    """Assess what shall be taken; no device is connected and nothing moves.

    Args:
        job: Campaign, rig and calibration record. The robot of the rig is made, to ask how it would
            move, but not connected.
        shots: Shots of its plan to take. Only these are looked at, for the ways between them depend
            on which they are.
        live: Shows how far it is.
        max_tries: How many poses may be tried instead of refused ones; 0: none.

    Raises:
        ConfigError: The robot's driver is not as it should be.
        CalibrationError: The record lacks a part.
        TerrainError: The terrain cannot be made or read.
    """
    from tronlab.render.heightfield import HeightfieldRenderer

    config, rig, calibration = job.campaign.config, job.rig, job.calibration
    mounting = calibration.mounting(rig.config.laboratory.mounting)
    heightmap = rig.load_heightmap(live.announce)
    live.announce("plan: preparing the terrain")
    context = PlanContext(
        robot=_robot(rig, seed=job.seed, heightmap=heightmap),
        mounting=mounting,
        camera=calibration.camera,
        tmac_from_cam=calibration.tmac_from_cam,
        p_tracker_trs_m=calibration.trs_from_trk.translation,
        lamp=job.lamp,
        heightmap=heightmap,
        renderer=HeightfieldRenderer(heightmap),
        cell=rig.config.cell,
        rules=Rules(
            min_usable_fraction=config.plan.min_usable_fraction,
            range_los_m=config.plan.range_los_m,
            min_lit_fraction=config.plan.min_lit_fraction,
            max_robot_shadow=config.plan.max_robot_shadow,
        ),
        timing=_timing(config, calibration),
    )
    if not shots:  # a run that was killed after its last shot
        return Foresight(PlanAssessment(shots=(), drift_checks_s=0.0, start_s=0.0), context)
    plan = Plan(tuple(shots))
    if config.plan.order == "least_motion" and isinstance(context.robot, MotionModel):
        plan = in_least_motion(plan, context.robot)
    live.advance(_STAGE, n_done=0, n_all=len(plan.shots))
    assessment = assess(
        plan,
        context,
        max_tries=max_tries,
        on_shot=lambda n_done, n_all: live.advance(_STAGE, n_done=n_done, n_all=n_all),
    )
    return Foresight(assessment, context)


def refuse(foresight: Foresight) -> None:
    """Return if every shot can be taken.

    Raises:
        PlanError: Those that cannot, each with its reasons.
    """
    if foresight.assessment.refused:
        raise PlanError(_refusal(foresight.assessment))


def _robot(rig: Rig, *, seed: int, heightmap: HeightMap) -> Robot:
    """Make the robot, not connected."""
    world = rig.world_setup(lambda: heightmap)
    context = rig.device_context("robot", seed=seed, session="plan", world=world)
    return make_device(rig.config.devices.robot.driver, "robot", context)  # pyright: ignore[reportReturnType]  # make_device checked it


def _timing(config: CampaignConfig, calibration: CalibrationRecord) -> Timing:
    timing = Timing(
        settle_wait_s=config.settle.wait_s,
        settle_window_s=config.settle.window_s,
        tracker_window_s=config.tracker.window_s,
        exposure_s=config.camera.exposure_s,
    )
    drift, reflectors = config.drift, calibration.inputs.frame
    if drift is None or reflectors is None:
        return timing
    return replace(
        timing,
        drift_window_s=drift.window_s,
        n_reflectors=len(reflectors.points),
        n_drift_checks=lambda n_shots: n_checks(n_shots, drift),
    )


def _refusal(assessment: PlanAssessment) -> str:
    refused = assessment.refused
    lines = [f"{len(refused)} of {len(assessment.shots)} shots cannot be taken:"]
    for shot in refused[:_N_NAMED]:
        reasons = "; ".join(finding.text for finding in shot.findings if finding.is_refusal)
        lines.append(f"  shot {shot.shot.shot_id}: {reasons}")
    if len(refused) > _N_NAMED:
        lines.append(f"  and {len(refused) - _N_NAMED} more")
    lines.append(
        "see where they could be taken: tronlab plan CAMPAIGN.yaml; then change the trajectory, or"
        " leave them out with plan.on_refused: skip"
    )
    return "\n".join(lines)
