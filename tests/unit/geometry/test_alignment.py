import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import DegenerateGeometryError
from tronlab.geometry.alignment import align_points, frame_from_reflectors
from tronlab.geometry.poses import rotation_angle_rad

seeds = st.integers(0, 2**32 - 1)


def random_pose(rng):
    return RigidTransform.from_components(rng.normal(size=3), Rotation.random(rng=rng))


@given(seeds)
def test_the_model_frame_is_found_wherever_the_tracker_stands(seed):
    rng = np.random.default_rng(seed)
    trk_from_trs = random_pose(rng)
    corners = trk_from_trs.apply([[0, 0, 0], [2.16, 0, 0], [0.1, 4.16, 0]])
    found = frame_from_reflectors(*corners)
    np.testing.assert_allclose(found.as_matrix(), trk_from_trs.as_matrix(), atol=1e-9)


def test_the_axes_are_those_of_the_paper():
    # Top-left, bottom-left, top-right in a tracker frame with z up and x towards the model.
    found = frame_from_reflectors([5, 2, 2], [5, 2, 0], [5, -2, 2])
    np.testing.assert_allclose(found.translation, [5, 2, 2])
    x, y, z = found.rotation.as_matrix().T
    np.testing.assert_allclose(x, [0, 0, -1], atol=1e-12)  # towards the bottom-left reflector
    np.testing.assert_allclose(y, [0, -1, 0], atol=1e-12)  # to the right
    np.testing.assert_allclose(z, [-1, 0, 0], atol=1e-12)  # out of the model, to the viewer


def test_y_stays_in_the_plane_though_the_third_reflector_is_skewed():
    found = frame_from_reflectors([0, 0, 0], [2, 0, 0], [0.7, 4, 0])
    np.testing.assert_allclose(found.rotation.as_matrix(), np.eye(3), atol=1e-12)


def test_collinear_reflectors_are_refused():
    with pytest.raises(DegenerateGeometryError, match="collinear"):
        frame_from_reflectors([0, 0, 0], [1, 0, 0], [2, 0.001, 0])


def test_coinciding_reflectors_are_refused():
    with pytest.raises(DegenerateGeometryError, match="within 1 mm"):
        frame_from_reflectors([0, 0, 0], [0.0005, 0, 0], [0, 4, 0])


@given(seeds, st.integers(3, 20))
def test_points_are_aligned_exactly_without_noise(seed, n):
    rng = np.random.default_rng(seed)
    a_from_b, p_b = random_pose(rng), rng.normal(size=(n, 3))
    found = align_points(a_from_b.apply(p_b), p_b)
    np.testing.assert_allclose(found.as_matrix(), a_from_b.as_matrix(), atol=1e-8)


def test_alignment_of_a_mirrored_set_is_still_a_rotation():
    p = np.random.default_rng(5).normal(size=(8, 3))
    found = align_points(p * [1, 1, -1], p)
    assert np.linalg.det(found.rotation.as_matrix()) == pytest.approx(1.0)


def test_alignment_agrees_with_scipys_own_solver():
    rng = np.random.default_rng(6)
    p_b = rng.normal(size=(30, 3))
    p_a = random_pose(rng).apply(p_b) + 0.01 * rng.normal(size=(30, 3))
    rotation, _ = Rotation.align_vectors(p_a - p_a.mean(0), p_b - p_b.mean(0))
    found = align_points(p_a, p_b)
    expected = RigidTransform.from_components(p_a.mean(0) - rotation.apply(p_b.mean(0)), rotation)
    assert rotation_angle_rad(found, expected) < 1e-9
    np.testing.assert_allclose(found.translation, expected.translation, atol=1e-9)


@pytest.mark.parametrize(
    ("points", "message"),
    [(np.zeros((2, 3)), "2 points"), (np.outer(np.arange(5), [1, 2, 3]), "one line")],
)
def test_points_that_do_not_fix_a_frame_are_refused(points, message):
    with pytest.raises(DegenerateGeometryError, match=message):
        align_points(points, points)
