"""Errors of a pose, against an independent computation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.score.metrics import pose_errors

TRUTH = RigidTransform.from_components(
    [1.0, 2.0, 3.0], Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
)
angles = st.floats(-3.0, 3.0)
vectors = st.tuples(*[st.floats(-2.0, 2.0)] * 3)


def test_signs_follow_the_paper_real_minus_solution() -> None:
    estimate = RigidTransform.from_components([1.0, 2.0, 3.5], TRUTH.rotation)
    errors = pose_errors(estimate, TRUTH)
    np.testing.assert_allclose(errors.error_trs_m, [0.0, 0.0, -0.5])
    np.testing.assert_allclose(errors.error_cam_m, [0.0, 0.0, 0.5])
    assert errors.position_error_m == pytest.approx(0.5)
    assert errors.rotation_error_rad == pytest.approx(0.0, abs=1e-12)


def test_turn_about_the_boresight_moves_only_the_other_two_axes() -> None:
    turn = TRUTH.rotation * Rotation.from_rotvec([0, 0, 1e-6])
    errors = pose_errors(RigidTransform.from_components(TRUTH.translation, turn), TRUTH)
    np.testing.assert_allclose(errors.axis_errors_rad, [1e-6, 1e-6, 0.0], atol=1e-12)
    assert errors.rotation_error_rad == pytest.approx(1e-6, rel=1e-6)


@given(vectors, vectors, vectors, vectors)
def test_agrees_with_matrices(a, b, t, u) -> None:
    truth = RigidTransform.from_components(t, Rotation.from_rotvec(a))
    estimate = RigidTransform.from_components(u, Rotation.from_rotvec(b))
    errors = pose_errors(estimate, truth)
    true, found = truth.as_matrix(), estimate.as_matrix()
    cosines = [true[:3, k] @ found[:3, k] for k in range(3)]
    np.testing.assert_allclose(np.cos(errors.axis_errors_rad), np.clip(cosines, -1, 1), atol=1e-9)
    trace = np.trace(true[:3, :3].T @ found[:3, :3])
    assert np.cos(errors.rotation_error_rad) == pytest.approx((trace - 1) / 2, abs=1e-9)
    np.testing.assert_allclose(
        errors.error_cam_m, np.linalg.inv(true[:3, :3]) @ (true[:3, 3] - found[:3, 3]), atol=1e-9
    )
    assert errors.position_error_m == pytest.approx(np.linalg.norm(errors.error_cam_m), abs=1e-9)
    assert errors.axis_errors_rad.max() <= errors.rotation_error_rad + 1e-7
