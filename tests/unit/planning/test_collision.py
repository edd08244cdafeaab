"""Bodies of the robot against floor, obstacles, terrain and each other, in place and on the way."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.spatial import KDTree
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.devices.cell import BoxSpec, EnvelopeSpec
from tronlab.devices.mounting import Mounting
from tronlab.devices.readings import Posture
from tronlab.planning.clearance import clearance, distances_at
from tronlab.planning.collision import PLATE, Box, Capsule, Scene, solids_at, stacked
from tronlab.planning.passage import check_clearance_along, passage_clearances
from tronlab.planning.terrain_clearance import TerrainClearance
from tronlab.terrain.heightmap import HeightMap

seeds = st.integers(0, 10_000)
HELD_RAD = np.radians([6.0, -96.0, 104.0, 37.0, -10.0, -36.0])
"""As the first campaign holds the arm: flange 1 m ahead of the base, 1.2 m above it."""


def posture(rail_m: float = 1.0, **degrees: float) -> Posture:
    axes_rad = HELD_RAD.copy()
    for name, angle in degrees.items():
        axes_rad[int(name[1]) - 1] = np.radians(angle)
    return Posture(rail_m, axes_rad)


@cache
def flat_model(origin_trs_m: tuple[float, ...]) -> TerrainClearance:
    heights = np.zeros((56, 106), np.float32)
    return TerrainClearance.of(HeightMap(heights, 0.04, np.array(origin_trs_m)))


def make_scene(shift_m=(0.0, 0.0, 0.0), **envelope: object) -> Scene:
    """Give a flat model and a rail that leads to it along -Z of trs, as the twin has them."""
    shift = np.array(shift_m)
    rotation = Rotation.from_euler("ZYX", [0.0, 90.0, 180.0], degrees=True)
    p_rail = np.array([2.3, 2.08, 6.0]) + shift
    obstacles = {
        name: BoxSpec(low_trs_m=tuple(low + shift), high_trs_m=tuple(high + shift))
        for name, (low, high) in dict(envelope.pop("obstacles", {})).items()  # pyright: ignore[reportCallIssue, reportArgumentType]
    }
    return Scene(
        terrain=flat_model(tuple(shift)),
        mounting=Mounting(
            trs_from_rail=RigidTransform.from_components(p_rail, rotation),
            rail_axis=np.array([1.0, 0.0, 0.0]),
            flange_from_cam=RigidTransform.identity(),
            arm_forward_m=1.0,
        ),
        envelope=EnvelopeSpec.model_validate({**envelope, "obstacles": obstacles}),
    )


OPEN = make_scene()


def box_surface(box: Box, n: int = 15) -> np.ndarray:
    steps = np.linspace(-1.0, 1.0, n)
    face = np.stack(np.meshgrid(steps, steps, [-1.0, 1.0], indexing="ij"), axis=-1).reshape(-1, 3)
    unit = np.concatenate([np.roll(face, k, axis=1) for k in range(3)])
    return box.boxes.centre_m + (unit * box.boxes.half_m) @ box.boxes.rotation.T


def capsule_surface(capsule: Capsule, n: int = 16) -> np.ndarray:
    """Give points of a capsule: spheres along its axis."""
    i = np.arange(200)
    z, turn = 1.0 - (2.0 * i + 1.0) / 200, np.pi * (1.0 + np.sqrt(5.0)) * i
    ring = np.sqrt(1.0 - z**2)
    sphere = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=-1)
    centres = np.linspace(capsule.p0_trs_m, capsule.p1_trs_m, n)
    return (centres[:, np.newaxis] + capsule.radius_m * sphere).reshape(-1, 3)


def surfaces(at: Posture, scene: Scene) -> dict[str, np.ndarray]:
    return {
        solid.name: capsule_surface(solid) if isinstance(solid, Capsule) else box_surface(solid)
        for solid in (*solids_at(at, scene), *scene.obstacles)
    }


def plate_corners_trs_m(at: Posture) -> np.ndarray:
    (plate,) = (s for s in solids_at(at, OPEN) if isinstance(s, Box) and s.name == PLATE)
    return plate.corners_trs_m


def random_posture(rng: np.random.Generator) -> Posture:
    low, high = np.radians([[-60, -110, 60, -180, -100, -180], [60, -50, 120, 180, 100, 180]])
    return Posture(rng.uniform(0.0, 4.0), rng.uniform(low, high))


@settings(max_examples=6, deadline=None)
@given(seeds)
def test_distances_of_all_pairs_are_those_of_sampled_surfaces(seed: int):
    rng = np.random.default_rng(seed)
    at = random_posture(rng)
    middle = np.array([2.08, 2.08, 5.0 - at.rail_m]) + rng.uniform(-1.5, 1.5, 3)
    scene = make_scene(obstacles={"chair": (middle - 0.3, middle + rng.uniform(0.0, 0.3, 3))})
    found = distances_at(*stacked([at]), scene)
    clouds = {name: KDTree(points) for name, points in surfaces(at, scene).items()}
    for (a, b), distance_m in zip(found.pairs, found.distance_m[0], strict=True):
        if a in clouds and b in clouds and distance_m > 0.02:
            sampled_m = clouds[a].query(clouds[b].data)[0].min()
            assert distance_m - 1e-5 < sampled_m < distance_m + 0.07, (a, b)


def test_clearance_is_the_same_wherever_the_laboratory_is():
    chair = {"chair": (np.array([1.0, 1.0, 3.0]), np.array([1.4, 1.2, 3.6]))}
    here, there = (make_scene(shift, obstacles=chair) for shift in ((0, 0, 0), (5.0, -3.0, 0.7)))
    for seed in range(5):
        at = random_posture(np.random.default_rng(seed))
        one, other = clearance(at, here), clearance(at, there)
        assert one.between == other.between
        assert one.distance_m == pytest.approx(other.distance_m, abs=1e-4)


def test_bodies_are_where_the_camera_and_the_rail_say():
    at = posture(rail_m=1.5)
    capsules = [solid for solid in solids_at(at, OPEN) if isinstance(solid, Capsule)]
    assert [c.name for c in capsules] == ["column", "upper arm", "forearm", "wrist", "hand"]
    # Rail at 1.5: the base stands at Z = 6 - 1.5, and the arm reaches on towards the model.
    assert capsules[0].p0_trs_m[2] == pytest.approx(4.5, abs=0.05)
    corners = plate_corners_trs_m(at)
    np.testing.assert_allclose(corners.mean(axis=0), [1.08, 2.08, 3.42], atol=0.1)
    assert np.ptp(corners, axis=0).max() < np.linalg.norm([0.2, 0.34, 0.2])


def test_nearest_thing_is_named_with_its_distance():
    wall = {"wall": (np.array([-1.0, 0.0, -0.5]), np.array([3.0, 4.2, 3.0]))}
    found = clearance(posture(rail_m=1.5), make_scene(obstacles=wall))
    assert found.between == ("plate", "wall")
    corners = plate_corners_trs_m(posture(rail_m=1.5))
    assert found.distance_m == pytest.approx(corners[:, 2].min() - 3.0, abs=1e-6)


def test_model_is_as_far_as_the_front_of_the_plate():
    found = clearance(posture(rail_m=4.3), OPEN)
    assert found.between == ("plate", "terrain model")
    front_m = plate_corners_trs_m(posture(rail_m=4.3))[:, 2].min()
    assert front_m - 0.02 < found.distance_m <= front_m + 1e-9


def test_arm_that_reaches_down_meets_the_floor():
    found = clearance(posture(a2=20.0, a3=30.0), OPEN)
    assert found.distance_m < 0.0
    assert "floor" in found.between


def test_plate_that_folds_back_meets_the_wrist_it_hangs_on():
    folded = clearance(posture(a5=130.0, a6=90.0), OPEN)
    assert folded.distance_m < 0.0
    assert set(folded.between) <= {"plate", "wrist", "forearm"}
    assert clearance(posture(), OPEN).distance_m > 0.5  # else what it hangs on does not count


POST = {"post": (np.array([0.5, 2.3, 2.9]), np.array([2.7, 2.5, 3.1]))}
"""Upright, where the plate passes while A1 turns."""


def test_on_the_way_a_post_is_met_that_neither_end_is_near():
    scene = make_scene(obstacles=POST)
    left, right = posture(rail_m=2.0, a1=-45.0), posture(rail_m=2.0, a1=55.0)
    for end in (left, right):
        assert clearance(end, scene).distance_m > 0.3
    first, second = check_clearance_along([left, right], scene)
    assert first.findings == ()
    assert first.on_way is None
    (finding,) = second.findings
    assert finding.is_refusal
    assert finding.check == "collision"
    assert "on the way there" in finding.text
    assert "post meet" in finding.text


@pytest.mark.parametrize("a1_deg", [-37.0, -19.0, 11.0, 23.0, 44.0])
def test_a_pin_that_only_a_corner_of_the_plate_touches_is_found(a1_deg: float):
    p_axis = np.array([2.3, 2.08, 4.0])
    corners = plate_corners_trs_m(posture(rail_m=2.0, a1=a1_deg))
    outermost = corners[np.linalg.norm((corners - p_axis)[:, 1:], axis=1).argmax()]
    pin = {"pin": (outermost - 0.005, outermost + 0.005)}
    scene = make_scene(obstacles=pin, clearance_m=0.02)
    ends = [posture(rail_m=2.0, a1=a1) for a1 in (-60.0, 70.0)]
    assert min(clearance(end, scene).distance_m for end in ends) > 0.1
    (found,) = passage_clearances(ends, scene)
    assert found.between == ("plate", "pin")
    assert found.distance_m < 0.02


def test_a_bar_across_the_rail_s_way_is_found():
    bar = {"bar": (np.array([1.0, 1.0, 3.69]), np.array([1.05, 3.0, 3.71]))}
    scene = make_scene(obstacles=bar)
    ends = [posture(rail_m=0.0), posture(rail_m=4.2)]
    assert min(clearance(end, scene).distance_m for end in ends) > 0.4
    (found,) = passage_clearances(ends, scene)
    assert found.distance_m < 0.0
    assert found.between[1] == "bar"


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_what_dense_samples_of_a_way_find_is_never_missed(seed: int):
    rng = np.random.default_rng(seed)
    scene = make_scene(obstacles=POST)
    start, end = random_posture(rng), random_posture(rng)
    t = np.linspace(0.0, 1.0, 151)[:, np.newaxis]
    axes_rad = start.axes_rad + t * (end.axes_rad - start.axes_rad)
    rail_m = start.rail_m + t[:, 0] * (end.rail_m - start.rail_m)
    dense = distances_at(rail_m, axes_rad, scene)
    allowed_m = np.where(dense.is_own, 0.0, scene.envelope.clearance_m)
    (found,) = passage_clearances([start, end], scene)
    if (dense.distance_m < allowed_m - 0.005).any():
        assert found.distance_m < scene.envelope.clearance_m
    if found.distance_m < scene.envelope.clearance_m:  # then a dense look finds it as well
        k = dense.pairs.index(found.between)
        assert dense.distance_m[:, k].min() < found.distance_m + 0.05


def test_shots_that_cannot_be_reached_are_passed_by():
    scene = make_scene(obstacles=POST)
    left, right = posture(rail_m=2.0, a1=-45.0), posture(rail_m=2.0, a1=55.0)
    checks = check_clearance_along([None, left, None, right], scene, start=right)
    assert [check.at_shot is None for check in checks] == [True, False, True, False]
    assert np.isnan(checks[0].least_m)
    for check in (checks[1], checks[3]):
        assert check.least_m < 0.0
        assert check.on_way is not None
    assert [len(c.findings) for c in check_clearance_along([None], scene)] == [0]


def test_way_from_a_shot_that_is_refused_is_not_held_against_the_next():
    folded = posture(a5=130.0, a6=90.0)
    checks = check_clearance_along([posture(), folded, posture()], OPEN)
    assert [len(check.findings) for check in checks] == [0, 1, 0]
    assert "on the way" not in checks[1].findings[0].text
    assert checks[2].on_way.distance_m < 0.0


def test_too_near_says_how_near_and_what_is_allowed():
    at = posture(rail_m=1.5)
    front_m = plate_corners_trs_m(at)[:, 2].min()
    wall = {"wall": (np.array([-1.0, 0.0, 0.0]), np.array([3.0, 4.2, front_m - 0.03]))}
    (check,) = check_clearance_along([at], make_scene(obstacles=wall))
    (finding,) = check.findings
    assert finding.text.startswith("plate comes to 0.030 m from wall, allowed 0.05 m")
    (check,) = check_clearance_along([at], make_scene(obstacles=wall, clearance_m=0.02))
    assert check.findings == ()


def test_box_whose_corners_are_the_wrong_way_round_is_refused():
    with pytest.raises(ValidationError, match=r"Y goes from 2 to 1 m, low_trs_m must be below"):
        BoxSpec(low_trs_m=(0.0, 2.0, 0.0), high_trs_m=(1.0, 1.0, 1.0))
