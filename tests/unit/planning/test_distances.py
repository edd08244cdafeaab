"""Distances of segments and boxes against brute force, and where they must not change."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.planning.distances import (
    EDGES,
    Boxes,
    box_to_box_m,
    point_to_box_m,
    segment_to_box_m,
    segment_to_segment_m,
)

seeds = st.integers(0, 10_000)
few = settings(max_examples=40, deadline=None)


def random_box(rng: np.random.Generator, *, spread_m: float = 1.0) -> Boxes:
    return Boxes(
        Rotation.random(rng=rng).as_matrix(),
        rng.uniform(-spread_m, spread_m, 3),
        rng.uniform(0.02, 0.5, 3),
    )


def moved(box: Boxes, by: RigidTransform) -> Boxes:
    return Boxes(by.rotation.as_matrix() @ box.rotation, by.apply(box.centre_m), box.half_m)


def random_motion(rng: np.random.Generator) -> RigidTransform:
    return RigidTransform.from_components(rng.uniform(-3, 3, 3), Rotation.random(rng=rng))


def filled(box: Boxes, n: int = 9) -> np.ndarray:
    """Give points all through a box."""
    steps = np.linspace(-1.0, 1.0, n)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    return box.centre_m + (grid * box.half_m) @ box.rotation.T


def nearest_by_optimiser(a: Boxes, b: Boxes) -> float:
    """Give the distance of two boxes as the least distance of a point of each."""

    moves = np.hstack([a.rotation, -b.rotation])
    half_m = np.concatenate([a.half_m, b.half_m])
    found = lsq_linear(moves, b.centre_m - a.centre_m, (-half_m, half_m), tol=1e-14)
    return float(np.sqrt(2.0 * found.cost))


@few
@given(seeds)
def test_segments_are_as_far_apart_as_their_nearest_samples(seed: int):
    rng = np.random.default_rng(seed)
    p0, p1, q0, q1 = rng.uniform(-1, 1, (4, 3))
    t = np.linspace(0, 1, 201)[:, np.newaxis]
    p, q = p0 + t * (p1 - p0), q0 + t * (q1 - q0)
    brute = np.linalg.norm(p[:, np.newaxis] - q, axis=-1).min()
    found = float(segment_to_segment_m(p0, p1, q0, q1))
    assert brute - 0.02 < found <= brute + 1e-12
    assert segment_to_segment_m(q0, q1, p1, p0) == pytest.approx(found, abs=1e-12)
    move = random_motion(rng).apply
    assert segment_to_segment_m(move(p0), move(p1), move(q0), move(q1)) == pytest.approx(found)


@pytest.mark.parametrize(
    ("q0", "q1", "distance_m"),
    [
        ([0, 1, 0], [1, 1, 0], 1.0),  # parallel
        ([2, 0, 0], [3, 0, 0], 1.0),  # in line
        ([0.5, 0, 2], [0.5, 0, 2], 2.0),  # a point
        ([0.5, -1, 0], [0.5, 1, 0], 0.0),  # crossing
        ([0.2, 0, 0], [3, 0, 0], 0.0),  # over each other
    ],
)
def test_segments_in_special_positions(q0, q1, distance_m):
    p0, p1 = np.zeros(3), np.array([1.0, 0, 0])
    q0, q1 = np.array(q0, dtype=float), np.array(q1, dtype=float)
    assert segment_to_segment_m(p0, p1, q0, q1) == pytest.approx(distance_m, abs=1e-12)
    assert segment_to_segment_m(q0, q1, p0, p1) == pytest.approx(distance_m, abs=1e-12)


@few
@given(seeds)
def test_segment_to_box_is_the_least_distance_of_its_points(seed: int):
    rng = np.random.default_rng(seed)
    box, (p0, p1) = random_box(rng, spread_m=0.6), rng.uniform(-1.5, 1.5, (2, 3))
    points = p0 + np.linspace(0, 1, 2001)[:, np.newaxis] * (p1 - p0)
    brute = point_to_box_m(points, box).min()
    found = float(segment_to_box_m(p0, p1, box))
    assert brute - 2e-3 < found < brute + 1e-5
    motion = random_motion(rng)
    again = segment_to_box_m(motion.apply(p0), motion.apply(p1), moved(box, motion))
    assert again == pytest.approx(found, abs=2e-5)


@few
@given(seeds)
def test_boxes_are_as_far_apart_as_an_optimiser_finds(seed: int):
    rng = np.random.default_rng(seed)
    a, b = random_box(rng), random_box(rng)
    found = float(box_to_box_m(a, b))
    assert max(found, 0.0) == pytest.approx(nearest_by_optimiser(a, b), abs=2e-4)
    assert box_to_box_m(b, a) == pytest.approx(found, abs=1e-9)
    motion = random_motion(rng)
    assert box_to_box_m(moved(a, motion), moved(b, motion)) == pytest.approx(found, abs=2e-5)


def test_a_box_within_another_meets_it():
    outer = Boxes(np.eye(3), np.zeros(3), np.full(3, 1.0))
    inner = Boxes(Rotation.from_euler("x", 0.3).as_matrix(), np.zeros(3), np.full(3, 0.1))
    assert box_to_box_m(outer, inner) < -0.5


def test_two_boards_that_cross_meet_though_no_corner_is_in_the_other():
    lying = Boxes(np.eye(3), np.zeros(3), np.array([1.0, 0.2, 0.01]))
    standing = Boxes(np.eye(3), np.zeros(3), np.array([0.2, 0.01, 1.0]))
    assert box_to_box_m(lying, standing) < 0.0


def test_stacks_are_measured_one_by_one():
    rng = np.random.default_rng(3)
    boxes = [random_box(rng) for _ in range(5)]
    stack = Boxes(
        np.stack([b.rotation for b in boxes]),
        np.stack([b.centre_m for b in boxes]),
        np.stack([b.half_m for b in boxes]),
    )
    p0, p1 = rng.uniform(-1, 1, (2, 5, 3))
    single = [float(segment_to_box_m(p0[i], p1[i], b)) for i, b in enumerate(boxes)]
    np.testing.assert_allclose(segment_to_box_m(p0, p1, stack), single, atol=1e-12)
    to_first = [float(box_to_box_m(b, boxes[0])) for b in boxes]
    np.testing.assert_allclose(box_to_box_m(stack, boxes[0]), to_first, atol=1e-9)


def test_edges_join_corners_that_differ_along_one_axis():
    box = random_box(np.random.default_rng(0))
    lengths = sorted(np.linalg.norm(box.corners_m[a] - box.corners_m[b]) for a, b in EDGES)
    np.testing.assert_allclose(lengths, np.repeat(np.sort(2 * box.half_m), 4))
    assert point_to_box_m(filled(box), box).max() < 1e-12
