"""The checks of a plan together, on the twin's laboratory as designed with a flat model."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.campaign.rig import load_rig
from tronlab.devices.cell import BoxSpec, CellSpec, EnvelopeSpec, PaceSpec, SightSpec
from tronlab.devices.readings import Posture, RobotTarget
from tronlab.errors import LimitError
from tronlab.geometry.poses import pose_along_boresight
from tronlab.kinematics.kr16 import axes_for
from tronlab.planning import assess as assess_module
from tronlab.planning.assess import assess
from tronlab.planning.assessment import Finding, PlanAssessment
from tronlab.planning.collision import Clearance, Scene
from tronlab.planning.context import PlanContext, Rules
from tronlab.planning.duration import Timing
from tronlab.planning.examination import Examiner
from tronlab.planning.passage import ClearanceCheck, check_clearance_along
from tronlab.planning.shots import make_plan
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.renderer import Lamp
from tronlab.terrain.heightmap import HeightMap

REPOSITORY = Path(__file__).resolve().parents[3]
UPRIGHT_RAD = np.radians([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
TMAC_TO_TRACKER = SightSpec(tmac_axis=(-1.0, 0.0, 0.0))


class Arm:
    """A KR 16 on the rail of the rig file; a metre of rail or a radian takes a second."""

    name = "arm"

    def __init__(self, rail_range_m: tuple[float, float]) -> None:
        self._rail_range_m = rail_range_m

    def posture_for(self, target: RobotTarget, *, near: Posture | None = None) -> Posture:
        low, high = self._rail_range_m
        if not low <= target.rail_m <= high:
            raise LimitError(f"rail at {target.rail_m:.3f} m", device=self.name)
        start = UPRIGHT_RAD if near is None else near.axes_rad
        return Posture(target.rail_m, axes_for(target.base_from_flange, start))

    def move_duration_s(self, start: Posture, end: Posture) -> float:
        turns = np.abs(end.axes_rad - start.axes_rad)
        return max(abs(end.rail_m - start.rail_m), float(turns.max()))


class Mute:
    """A robot that says nothing before it is connected."""

    name = "mute"


@cache
def laboratory():
    return load_rig(REPOSITORY / "campaigns/rigs/twin.yaml").config.laboratory


@cache
def renderer() -> HeightfieldRenderer:
    return HeightfieldRenderer(heightmap(), n_threads=1)


@cache
def heightmap() -> HeightMap:
    return HeightMap(np.zeros((45, 85), np.float32), 0.05, np.zeros(3))


def context(*, cell: CellSpec | None = None, robot: object = None, **rules: object) -> PlanContext:
    mounting = laboratory().mounting
    flange_from_cam, flange_from_tmac = mounting.flange_from_cam, mounting.flange_from_tmac
    wanted = Rules(
        min_usable_fraction=0.15,
        range_los_m=(0.3, 9.0),
        min_lit_fraction=0.05,
        max_robot_shadow=0.02,
    )
    return PlanContext(
        robot=robot or Arm(mounting.rail_range_m),  # pyright: ignore[reportArgumentType]
        mounting=mounting.nominal,
        camera=laboratory().camera.nominal_model.scaled(128),
        tmac_from_cam=flange_from_tmac.pose.inv() * flange_from_cam.pose,
        p_tracker_trs_m=np.array([1.08, 4.6, 2.8]),
        lamp=Lamp(np.array(laboratory().lamp.p_trs_m), intensity=1.0),
        heightmap=heightmap(),
        renderer=renderer(),
        cell=cell or CellSpec(sight=TMAC_TO_TRACKER),
        rules=replace(wanted, **rules),  # pyright: ignore[reportArgumentType]
        timing=Timing(0.0, 0.1, 1.0, 0.02, 1.0, 3, n_drift_checks=lambda n_shots: 1 + n_shots),
    )


def facing(*heights_m: float, x_m: float = 1.08, boresight=(0.0, 0.0, -1.0)) -> list:
    return [
        pose_along_boresight((x_m, 2.08, z), boresight=boresight, right=(0.0, 1.0, 0.0))
        for z in heights_m
    ]


def facing_at(y_m: float, z_m: float) -> RigidTransform:
    return pose_along_boresight((1.08, y_m, z_m), boresight=(0.0, 0.0, -1.0), right=(0.0, 1.0, 0.0))


def assessed(
    poses: list[RigidTransform], where: PlanContext | None = None, *, max_tries: int = 0
) -> PlanAssessment:
    where = where or context()
    return assess(make_plan(poses, mounting=where.mounting), where, max_tries=max_tries)


def refusals(assessment: PlanAssessment) -> list[set[str]]:
    return [
        {finding.check for finding in shot.findings if finding.is_refusal}
        for shot in assessment.shots
    ]


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> CellSpec:
    obstacles = {"box": BoxSpec(low_trs_m=low, high_trs_m=high)}
    envelope = EnvelopeSpec.model_validate({"obstacles": obstacles})
    return CellSpec(sight=TMAC_TO_TRACKER, envelope=envelope)


def test_a_straight_approach_can_be_taken_and_is_timed_part_by_part():
    told: list[tuple[int, int]] = []
    where = context(cell=CellSpec(sight=TMAC_TO_TRACKER, pace=PaceSpec(start_s=7.0, write_s=0.0)))
    plan = make_plan(facing(3.0, 2.5, 1.5), mounting=where.mounting)
    result = assess(plan, where, on_shot=lambda *counts: told.append(counts))
    assert refusals(result) == [set()] * 3
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert [shot.duration.move_s for shot in result.shots] == pytest.approx([0.0, 0.5, 1.0])
    shot_s = 2 * 0.1 + 1.0 + 0.07 + 0.1
    assert result.total_s == pytest.approx(7.0 + 1.5 + 3 * shot_s + 4 * 3 * 1.0)
    first = result.shots[0]
    assert first.range_los_m == pytest.approx(3.0)
    assert first.lit_fraction == 1.0
    assert first.robot_shadow == 0.0
    assert first.clearance_m > 0.05
    t_mac = np.array([1.08, 2.26, 3.04])  # 0.18 m to the right of the camera, 0.04 m behind it
    assert first.tmac_distance_m == pytest.approx(
        np.linalg.norm([1.08, 4.6, 2.8] - t_mac), abs=1e-9
    )


@pytest.mark.parametrize(
    ("where", "pose", "checks"),
    [
        (context(), facing(4.95)[0], {"reach"}),
        (context(), facing(2.0, boresight=(0.0, 0.0, 1.0))[0], {"view", "usable"}),
        (context(range_los_m=(0.3, 1.9)), facing(2.0)[0], {"range"}),
        (context(min_usable_fraction=0.99), facing(2.0)[0], {"usable"}),
        (context(cell=box((0.0, 3.3, 0.0), (2.2, 3.4, 3.0))), facing(2.0)[0], {"sight"}),
        (
            context(cell=CellSpec(sight=SightSpec(tmac_axis=(1.0, 0.0, 0.0)))),
            facing(2.0)[0],
            {"sight"},
        ),
        (context(cell=box((1.0, 1.9, 3.0), (1.2, 2.2, 3.1))), facing(2.0)[0], {"collision"}),
        (context(min_lit_fraction=1.1), facing(2.0)[0], {"light"}),
    ],
    ids=["rail", "away", "range", "usable", "bar", "angle", "collision", "light"],
)
def test_each_check_refuses_what_it_is_for(where, pose, checks):
    assert refusals(assessed([pose], where)) == [checks]


def test_a_lamp_behind_the_robot_is_kept_from_the_model():
    where = replace(context(), lamp=Lamp(np.array([1.4, 2.08, 6.0]), intensity=1.0))
    result = assessed(facing(2.0), where)
    assert refusals(result) == [{"light"}]
    assert 0.02 < result.shots[0].robot_shadow < 1.0
    assert result.shots[0].lit_fraction == pytest.approx(1.0 - result.shots[0].robot_shadow)


def test_refused_shots_take_no_time_and_are_passed_by():
    result = assessed(facing(3.0, 4.95, 2.0))
    assert [shot.is_refused for shot in result.shots] == [False, True, False]
    assert result.shots[1].duration.total_s == 0.0
    assert result.shots[2].duration.move_s == pytest.approx(1.0)  # from the first one
    assert result.drift_checks_s == pytest.approx((1 + 2) * 3 * 1.0)


def test_the_pose_proposed_instead_can_be_taken():
    where = context(min_usable_fraction=0.6)
    result = assessed(
        [*facing(1.5, 3.2), *facing(1.5, boresight=(-1.0, 0.0, -0.8))], where, max_tries=60
    )
    assert refusals(result)[1:] == [{"usable"}, {"usable"}]
    proposed = [shot.nearest for shot in result.shots[1:]]
    assert all(pose is not None for pose in proposed)
    again = assessed([pose for pose in proposed if pose is not None], where)
    assert refusals(again) == [set(), set()]
    # A model of 4.25 m x 2.25 m and a view of 67.5 deg in the square: 60 % from 2.6 m.
    assert proposed[0] is not None
    assert proposed[0].translation[2] == pytest.approx(2.65, abs=0.15)


def test_the_pose_proposed_for_a_barred_way_is_off_that_way():
    """A post stands between the first two shots: each is free, the way from one to the next not."""
    where = context(cell=box((0.5, 2.0, 2.0), (2.2, 2.16, 2.1)))
    left, right, far = (facing_at(y_m, z_m) for y_m, z_m in ((1.4, 2.0), (2.76, 2.0), (1.4, 2.6)))
    result = assessed([left, right, far], where, max_tries=20)
    assert refusals(result) == [set(), {"collision"}, set()]
    assert "on the way there" in result.shots[1].findings[0].text
    proposed = result.shots[1].nearest
    assert proposed is not None
    assert refusals(assessed([left, proposed, far], where)) == [set()] * 3


def test_tries_are_not_more_than_asked_for(monkeypatch):
    asked: list[RigidTransform] = []
    monkeypatch.setattr(Examiner, "can_be_taken", lambda _, pose, **_ways: bool(asked.append(pose)))
    result = assessed(
        facing(*np.linspace(1.0, 3.0, 7)), context(min_lit_fraction=1.1), max_tries=35
    )
    assert [shot.nearest for shot in result.shots] == [None] * 7
    assert len(asked) == 30, "three shots with ten tries each, none for the others"


def test_an_obstacle_may_have_the_name_of_a_part_of_the_robot():
    where = replace(context(), lamp=Lamp(np.array([1.4, 2.08, 6.0]), intensity=1.0))
    (alone,) = assessed(facing(2.0), where).shots
    spec = BoxSpec(low_trs_m=(-3.0, -3.0, 0.0), high_trs_m=(-2.9, -2.9, 0.1))
    envelope = EnvelopeSpec.model_validate({"obstacles": {"forearm": spec, "plate": spec}})
    cell = CellSpec(sight=TMAC_TO_TRACKER, envelope=envelope)
    (beside,) = assessed(facing(2.0), replace(context(cell=cell), lamp=where.lamp)).shots
    assert beside.robot_shadow == alone.robot_shadow > 0.02


def test_without_a_motion_model_the_rest_is_checked():
    result = assessed(facing(3.0, 4.95), context(robot=Mute(), range_los_m=(0.3, 4.0)))
    assert [[finding.text for finding in shot.findings] for shot in result.shots] == [
        [
            "robot 'mute' cannot be asked without a connection: reach, clearance and duration of"
            " its moves are unknown; the run asks it about reach before anything moves"
        ],
        [
            "range is 4.950 m, allowed 0.3 to 4 m",
        ],
    ]
    assert result.shots[1].nearest is None
    assert np.isnan(result.shots[0].clearance_m)


def test_after_a_barred_way_the_next_shot_is_reached_from_the_one_before(monkeypatch):
    """Ways to and from the second shot are barred, that from the first to the third is free."""

    def barred(postures: list[Posture], scene: Scene) -> tuple[ClearanceCheck, ...]:
        checks = check_clearance_along(postures, scene)
        if len(postures) != 3:
            return checks
        finding = Finding("collision", "on the way there plate and box meet")
        hit = ClearanceCheck(None, Clearance(-0.1, ("plate", "box")), (finding,))
        return (checks[0], hit, hit)

    monkeypatch.setattr(assess_module, "check_clearance_along", barred)
    result = assessed(facing(3.0, 2.5, 2.0))
    assert refusals(result) == [set(), {"collision"}, set()]
    assert result.shots[2].duration.move_s == pytest.approx(1.0)
