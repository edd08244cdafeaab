import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import DegenerateGeometryError
from tronlab.geometry.alignment import (
    align_points,
    align_points_weighted,
    frame_from_reflectors,
    largest_misfit_m,
)
from tronlab.geometry.poses import rotation_angle_rad
from tronlab.geometry.uncertainty import perturb, pose_difference

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


@given(seeds, st.tuples(*[st.floats(-0.2, 0.5)] * 3))
def test_the_marks_lie_below_centres_of_any_height(seed, heights):
    trk_from_trs = random_pose(np.random.default_rng(seed))
    centres = np.array([[0, 0, 0], [2.16, 0, 0], [-0.7, 4.16, 0]])
    centres[:, 2] = heights
    found = frame_from_reflectors(*trk_from_trs.apply(centres), heights_m=heights)
    np.testing.assert_allclose(found.as_matrix(), trk_from_trs.as_matrix(), atol=1e-9)


def test_centres_above_one_another_have_no_frame():
    with pytest.raises(DegenerateGeometryError, match=r"collinear within 0\.00 deg"):
        frame_from_reflectors([0, 0, 0], [0, 0, 1], [0, 4, 0], heights_m=[0, 1, 0])


def test_collinear_reflectors_are_refused():
    with pytest.raises(DegenerateGeometryError, match="collinear"):
        frame_from_reflectors([0, 0, 0], [1, 0, 0], [2, 0.001, 0])


def test_coinciding_reflectors_are_refused():
    message = "reflectors bottom_left and top_right lie within 1 mm"
    with pytest.raises(DegenerateGeometryError, match=message):
        frame_from_reflectors([0, 0, 0], [0, 4.0005, 0], [0, 4, 0])


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


def test_misfit_is_that_of_the_best_placing():
    p = np.random.default_rng(7).normal(size=(5, 3))
    moved = random_pose(np.random.default_rng(8)).apply(p)
    assert largest_misfit_m(p, moved) < 1e-12
    assert largest_misfit_m(p, moved * [1, 1, -1]) > 0.1
    assert largest_misfit_m([[0, 0, 0], [1, 0, 0]], [[5, 0, 0], [5, 1.2, 0]]) == pytest.approx(0.1)


def test_equal_weights_change_nothing():
    rng = np.random.default_rng(9)
    p_b = rng.normal(size=(9, 3))
    p_a = random_pose(rng).apply(p_b) + 0.01 * rng.normal(size=(9, 3))
    found = align_points_weighted(p_a, p_b, np.tile(1e-4 * np.eye(3), (9, 1, 1)))
    plain = align_points(p_a, p_b)
    np.testing.assert_allclose(pose_difference(found.a_from_b, plain), 0.0, atol=1e-9)
    np.testing.assert_allclose(found.residuals_m, p_a - plain.apply(p_b), atol=1e-9)
    assert found.chi_square == pytest.approx((found.residuals_m**2).sum() / 1e-4)
    assert found.dof == 21


def test_weighted_alignment_is_the_best_there_is():
    """No small step makes the weighted residuals smaller; plain alignment is far from that."""
    rng = np.random.default_rng(10)
    roots = rng.normal(size=(6, 3, 3)) * rng.uniform(0.1, 3.0, (6, 1, 1))
    covariances = 1e-6 * roots @ roots.transpose(0, 2, 1)
    a_from_b, p_a = random_pose(rng), rng.normal(size=(6, 3))
    noise = 1e-3 * np.einsum("nij,nj->ni", roots, rng.normal(size=(6, 3)))
    p_b = a_from_b.inv().apply(p_a) + noise

    def weighted_squares(pose):
        r = pose.rotation.as_matrix()
        weights = np.linalg.inv(r @ covariances @ r.T)
        off = p_a - pose.apply(p_b)
        return np.einsum("ni,nij,nj", off, weights, off)

    found = align_points_weighted(p_a, p_b, covariances)
    assert weighted_squares(found.a_from_b) == pytest.approx(found.chi_square)
    assert weighted_squares(align_points(p_a, p_b)) > 1.1 * found.chi_square
    for step in 3.0 * np.linalg.cholesky(found.covariance).T:
        assert weighted_squares(perturb(found.a_from_b, step)) > found.chi_square
        assert weighted_squares(perturb(found.a_from_b, -step)) > found.chi_square
