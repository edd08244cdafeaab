"""The Cramer-Rao bound against theory, and estimators against the bound."""

import numpy as np
import pytest
from pose_views import CAMERA, TRUTH, make_matches, numerical_jacobian_px
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from tronlab.geometry.uncertainty import pose_difference
from tronlab.nav.pose import (
    Correspondences,
    cramer_rao_bound,
    refine_pose,
    solve_epnp,
    solve_sqpnp,
)
from tronlab.nav.pose.refinement import TUKEY_EFFICIENCY

N_TRIALS = 60
SIGMA_PX = 0.5


def test_bound_is_the_inverse_of_the_information(rng: np.random.Generator) -> None:
    exact = make_matches(rng, 40)
    scale = rng.uniform(1.0, 4.0, 40)
    matches = Correspondences(exact.uv, exact.rays, exact.p_trs_m, scale)
    weighted = numerical_jacobian_px(matches) / (SIGMA_PX * np.repeat(scale, 2)[:, None])
    expected = np.linalg.inv(weighted.T @ weighted)
    bound = cramer_rao_bound(TRUTH, matches, CAMERA, sigma_px=SIGMA_PX)
    np.testing.assert_allclose(bound, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def test_uncertain_landmarks_bound_as_if_they_were_estimated_too(rng: np.random.Generator) -> None:
    """The pose's block of the bound of pose and landmarks, whose survey is a measurement."""
    n = 12
    matches = make_matches(rng, n)
    shape = rng.normal(0.0, 1e-3, (n, 3, 3))
    landmarks = shape @ shape.swapaxes(1, 2) + 1e-8 * np.eye(3)
    by_pose = numerical_jacobian_px(matches) / SIGMA_PX
    by_landmarks = np.zeros((2 * n, 3 * n))
    information = np.zeros((6 + 3 * n, 6 + 3 * n))
    for i in range(n):
        # Moving a landmark is moving the camera the other way.
        by_landmarks[2 * i : 2 * i + 2, 3 * i : 3 * i + 3] = -by_pose[2 * i : 2 * i + 2, 3:]
        at = slice(6 + 3 * i, 9 + 3 * i)
        information[at, at] = np.linalg.inv(landmarks[i])
    both = np.hstack([by_pose, by_landmarks])
    expected = np.linalg.inv(information + both.T @ both)[:6, :6]
    bound = cramer_rao_bound(
        TRUTH, matches, CAMERA, sigma_px=SIGMA_PX, landmark_covariance_m2=landmarks
    )
    np.testing.assert_allclose(bound, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
    exact = cramer_rao_bound(TRUTH, matches, CAMERA, sigma_px=SIGMA_PX)
    assert np.linalg.eigvalsh(bound - exact).min() > 0
    none = cramer_rao_bound(
        TRUTH, matches, CAMERA, sigma_px=SIGMA_PX, landmark_covariance_m2=np.zeros((3, 3))
    )
    np.testing.assert_allclose(none, exact, rtol=1e-9, atol=1e-15)


@pytest.mark.opencv
def test_sqpnp_and_least_squares_reach_the_bound_and_epnp_does_not() -> None:
    """Errors weighed by a right covariance are chi-square distributed."""
    errors: dict[str, list[float]] = {"epnp": [], "sqpnp": [], "refined": [], "as it says": []}
    noises: list[float] = []
    for seed in range(N_TRIALS):
        matches = make_matches(np.random.default_rng(seed), 100, sigma_px=SIGMA_PX)
        bound = cramer_rao_bound(TRUTH, matches, CAMERA, sigma_px=SIGMA_PX)
        start = solve_sqpnp(matches)
        estimate = refine_pose(start, matches, CAMERA, gate_px=6.0)
        noises.append(estimate.noise_px)
        errors["epnp"].append(weighed_error(solve_epnp(matches), bound))
        errors["sqpnp"].append(weighed_error(start, bound))
        errors["refined"].append(weighed_error(estimate.trs_from_cam, bound))
        errors["as it says"].append(weighed_error(estimate.trs_from_cam, estimate.covariance))
    mean = {name: np.mean(values) for name, values in errors.items()}
    low, high = chi2.ppf([0.0005, 0.9995], 6 * N_TRIALS) / N_TRIALS
    assert low < mean["sqpnp"] < 1.05 * high
    assert low < mean["refined"] * TUKEY_EFFICIENCY < high
    # Scale and weights come from 100 points, so the statistic is a little wider than chi-square.
    assert 0.95 * low < mean["as it says"] < 1.1 * high
    assert mean["epnp"] > 1.3 * high
    assert np.mean(noises) == pytest.approx(SIGMA_PX, rel=0.03)


def weighed_error(pose: RigidTransform, covariance: np.ndarray) -> float:
    difference = pose_difference(pose, TRUTH)
    return float(difference @ np.linalg.solve(covariance, difference))
