"""A plan of a few shots with findings made by hand, and a small cell to draw it in."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.devices.cell import CellSpec
from tronlab.devices.laboratory import MountingSpec, PoseSpec
from tronlab.devices.readings import Posture
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.kinematics import kr16
from tronlab.planning.assessment import Finding, PlanAssessment, ShotAssessment, ShotDuration
from tronlab.planning.context import PlanContext, Rules
from tronlab.planning.duration import Timing
from tronlab.planning.shots import make_plan
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.renderer import Lamp
from tronlab.report.plan_stage import Stage
from tronlab.terrain.heightmap import HeightMap

MOUNTING = MountingSpec(
    trs_from_rail=PoseSpec(xyz_m=(2.3, 2.08, 6.0), zyx_deg=(0.0, 90.0, 180.0)),
    flange_from_cam=PoseSpec(xyz_m=(0.0, 0.09, 0.08), zyx_deg=(-90.0, 0.0, 0.0)),
    flange_from_tmac=PoseSpec(xyz_m=(0.0, -0.09, 0.04), zyx_deg=(90.0, 0.0, 180.0)),
    rail_range_m=(0.0, 4.4),
    arm_forward_m=1.0,
)
CAMERA = CameraModel(width_px=64, height_px=48, fx_px=48.0, fy_px=48.0, cx_px=31.5, cy_px=23.5)
DURATION = ShotDuration(
    move_s=2.0, settle_s=0.7, tracker_s=1.0, camera_s=0.1, confirm_s=0.1, read_s=0.0, write_s=0.1
)
TOO_DARK = Finding("light", "3.0 % of what is seen is lit, at least 5 % shall be", is_refusal=False)
TOO_FAR = Finding("usable", "12.0 % of the image shows the model, at least 20 % shall")
OUT_OF_REACH = Finding("reach", "robot: axis A3 would be at 160 deg, allowed up to 154 deg")


def planned(n_shots: int = 6) -> PlanAssessment:
    """An approach whose first shot is too far away, second too dark, and last out of reach."""
    heights_m = np.linspace(4.0, 1.5, n_shots)
    poses = [
        pose_along_boresight([1.08, 2.08, z], boresight=[0, 0, -1], right=[0, 1, 0])
        for z in heights_m
    ]
    shots = list(map(_assessed, make_plan(poses, mounting=MOUNTING.nominal).shots, heights_m))
    nearer = RigidTransform.from_translation([0.0, 0.03, -0.04]) * poses[0]
    shots[0] = replace(shots[0], findings=(TOO_FAR,), usable_fraction=0.12, nearest=nearer)
    shots[1] = replace(shots[1], findings=(TOO_DARK,), lit_fraction=0.03)
    shots[-1] = replace(
        shots[-1],
        findings=(OUT_OF_REACH, TOO_DARK),
        posture=None,
        clearance_m=float("nan"),
        tmac_angle_rad=float("nan"),
    )
    return PlanAssessment(tuple(shots), drift_checks_s=9.0, start_s=3.0)


def small_stage() -> Stage:
    """A bumpy model, the mounting of the twin, and a cabinet in the way of nothing."""
    heights = 0.05 * np.random.default_rng(3).normal(size=(23, 43)).astype(np.float32)
    heightmap = HeightMap(heights, 0.1, np.array([0.0, 0.0, 0.0]))
    cabinet = {"low_trs_m": (1.0, -1.6, 2.0), "high_trs_m": (2.6, -1.0, 2.8)}
    context = PlanContext(
        robot=None,  # only those who draw want this context
        mounting=MOUNTING.nominal,
        camera=CAMERA,
        tmac_from_cam=RigidTransform.from_translation([0.0, 0.18, -0.04]),
        p_tracker_trs_m=np.array([1.1, 4.6, 2.8]),
        lamp=Lamp(np.array([-3.0, -2.5, 3.5]), intensity=1.0),
        heightmap=heightmap,
        renderer=HeightfieldRenderer(heightmap, n_threads=1),
        cell=CellSpec.model_validate({"envelope": {"obstacles": {"cabinet": cabinet}}}),
        rules=Rules(0.2, (0.3, 100.0), 0.05, 0.02),
        timing=Timing(0.5, 0.1, 1.0, 0.02),
    )
    return Stage(context, MOUNTING.rail_range_m)


def _assessed(shot, range_los_m: float) -> ShotAssessment:
    axes_rad = kr16.axes_for(shot.robot_target.base_from_flange, np.radians([0, -90, 90, 0, 0, 0]))
    return ShotAssessment(
        shot=shot,
        posture=Posture(shot.robot_target.rail_m, axes_rad),
        findings=(),
        range_los_m=float(range_los_m),
        usable_fraction=0.6,
        lit_fraction=0.8,
        robot_shadow=0.0,
        tmac_distance_m=3.0,
        tmac_angle_rad=0.4,
        clearance_m=0.3,
        duration=DURATION,
    )
