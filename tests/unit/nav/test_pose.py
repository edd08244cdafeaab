"""EPnP, RANSAC and least squares against exact data, theory and bad data."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import rotation_angle_rad
from tronlab.geometry.uncertainty import perturb, pose_difference
from tronlab.nav.pose import (
    Correspondences,
    NoPoseError,
    jacobian_px,
    refine_pose,
    residuals_px,
    solve_epnp,
    solve_ransac,
)

pytestmark = pytest.mark.opencv

CAMERA = CameraModel(1024, 1024, 744.0, 745.0, 511.0, 509.0, (-0.12, 0.05, 5e-4, -3e-4, 0.0))
TRUTH = RigidTransform.from_components(
    [1.1, 2.1, 2.5],
    Rotation.from_rotvec([0.03, -0.05, 0.1])
    * Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
)


def make_matches(
    rng: np.random.Generator, n: int, *, sigma_px: float = 0.0, n_wrong: int = 0
) -> Correspondences:
    """Matches of points on a rough surface; the first ``n_wrong`` show another point."""
    rays = rng.uniform(-0.55, 0.55, (n, 2))
    p_cam = np.column_stack([rays, np.ones(n)]) * rng.uniform(2.3, 2.6, (n, 1))
    p_trs = TRUTH.apply(p_cam)
    uv = CAMERA.project(p_cam) + rng.normal(0.0, 1.0, (n, 2)) * sigma_px
    p_trs[:n_wrong] = np.roll(p_trs[:n_wrong], 1, axis=0)
    return Correspondences(uv, CAMERA.rays(uv), p_trs, np.ones(n))


def bound(matches: Correspondences, sigma_px: float) -> np.ndarray:
    """The Cramer-Rao bound from numerical derivatives of the projection."""
    steps = np.eye(6) * 1e-6
    columns = [
        (
            residuals_px(perturb(TRUTH, -h), matches, CAMERA)
            - residuals_px(perturb(TRUTH, h), matches, CAMERA)
        ).ravel()
        / 2e-6
        for h in steps
    ]
    jacobian = np.column_stack(columns)
    return np.linalg.inv(jacobian.T @ jacobian) * sigma_px**2


def test_jacobian_agrees_with_finite_differences(rng: np.random.Generator) -> None:
    matches = make_matches(rng, 30)
    jacobian = jacobian_px(TRUTH, matches, CAMERA)
    for k in range(6):
        h = np.zeros(6)
        h[k] = 1e-6
        ahead, behind = (residuals_px(perturb(TRUTH, s * h), matches, CAMERA) for s in (1, -1))
        np.testing.assert_allclose(jacobian[:, :, k], (behind - ahead) / 2e-6, atol=1e-4)


def test_epnp_and_ransac_find_an_exact_pose(rng: np.random.Generator) -> None:
    matches = make_matches(rng, 80)
    found, agrees = solve_ransac(matches, tolerance=0.001)
    assert agrees.all()
    for pose in (solve_epnp(matches), found):
        assert np.linalg.norm(pose.translation - TRUTH.translation) < 1e-6
        assert rotation_angle_rad(pose, TRUTH) < 1e-6


def test_least_squares_from_a_wrong_start_finds_an_exact_pose(rng: np.random.Generator) -> None:
    start = perturb(TRUTH, np.array([2e-3, -1e-3, 1e-3, 0.003, -0.002, 0.004]))
    estimate = refine_pose(start, make_matches(rng, 80), CAMERA, gate_px=20.0)
    assert np.abs(pose_difference(estimate.trs_from_cam, TRUTH)).max() < 1e-8


def test_least_squares_reaches_the_bound_and_says_how_good_it_is(rng: np.random.Generator) -> None:
    n_trials, sigma_px = 100, 0.5
    errors, nees, said = [], [], []
    for _ in range(n_trials):
        matches = make_matches(rng, 100, sigma_px=sigma_px)
        estimate = refine_pose(TRUTH, matches, CAMERA, gate_px=6.0)
        difference = pose_difference(estimate.trs_from_cam, TRUTH)
        nees.append(difference @ np.linalg.solve(estimate.covariance, difference))
        errors.append(np.sum(difference[3:] ** 2) / np.trace(bound(matches, sigma_px)[3:, 3:]))
        said.append(estimate.sigma_px)
    assert 0.85 < np.sqrt(np.mean(errors)) < 1.10
    # Scale and weights are estimated from 100 points, so the statistic is a little wider than chi2.
    low, high = chi2.ppf([0.0001, 0.9999], 6 * n_trials) / n_trials
    assert low * 0.95 < np.mean(nees) < high * 1.10
    # Tukey's weights cost 5 % of variance, which the standard deviation reported includes.
    assert np.mean(said) == pytest.approx(sigma_px * 1.025, rel=0.05)


def test_uncertain_positions_count_less(rng: np.random.Generator) -> None:
    weighted, equal = [], []
    for _ in range(40):
        exact = make_matches(rng, 60)
        scale = np.where(np.arange(60) < 30, 1.0, 5.0)
        uv = exact.uv + rng.normal(0, 0.2, (60, 2)) * scale[:, None]
        for errors, factor in ((weighted, scale), (equal, np.ones(60))):
            matches = Correspondences(uv, CAMERA.rays(uv), exact.p_trs_m, factor)
            estimate = refine_pose(TRUTH, matches, CAMERA, gate_px=8.0)
            errors.append(np.linalg.norm(estimate.trs_from_cam.translation - TRUTH.translation))
    assert np.mean(weighted) < 0.9 * np.mean(equal)


def test_ransac_and_least_squares_leave_wrong_matches_out(rng: np.random.Generator) -> None:
    matches = make_matches(rng, 200, sigma_px=0.3, n_wrong=80)
    start, agrees = solve_ransac(matches, tolerance=4 / 744)
    estimate = refine_pose(start, matches, CAMERA, gate_px=6.0)
    assert agrees[80:].mean() > 0.9
    assert not estimate.is_inlier[:80].any()
    assert estimate.is_inlier[80:].mean() > 0.9
    difference = pose_difference(estimate.trs_from_cam, TRUTH)
    assert difference @ np.linalg.solve(estimate.covariance, difference) < chi2.ppf(0.9999, 6)


def test_epnp_alone_is_spoilt_by_wrong_matches(rng: np.random.Generator) -> None:
    """The reason for the refined cores: if this fails the paper's estimator rejects outliers."""
    matches = make_matches(rng, 200, sigma_px=0.3, n_wrong=20)
    assert np.linalg.norm(solve_epnp(matches).translation - TRUTH.translation) > 0.05


def test_too_few_matches_are_no_pose(rng: np.random.Generator) -> None:
    few = make_matches(rng, 5)
    with pytest.raises(NoPoseError, match="5 matches, at least 6 needed"):
        solve_epnp(few)
    with pytest.raises(NoPoseError, match="5 matches, at least 6 needed"):
        solve_ransac(few, tolerance=0.01)
    with pytest.raises(NoPoseError, match="at least 6 needed"):
        refine_pose(TRUTH, few, CAMERA, gate_px=5.0)


def test_matches_that_do_not_belong_together_are_no_pose(rng: np.random.Generator) -> None:
    matches = make_matches(rng, 60, n_wrong=60)
    with pytest.raises(NoPoseError):
        refine_pose(TRUTH, matches, CAMERA, gate_px=2.0)


def test_one_point_seen_often_does_not_determine_a_pose(rng: np.random.Generator) -> None:
    one = make_matches(rng, 1)
    matches = one.take(np.zeros(40, np.intp))
    with pytest.raises(NoPoseError, match="do not determine the pose"):
        refine_pose(TRUTH, matches, CAMERA, gate_px=2.0)
