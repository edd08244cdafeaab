"""Covariances of poses whose image positions err together, against the errors themselves."""

from dataclasses import replace

import numpy as np
import pytest
from pose_views import CAMERA, TRUTH, make_matches
from scipy.stats import chi2

from tronlab.geometry.uncertainty import pose_difference
from tronlab.nav.pose import Correspondences, jacobian_px, refine_pose
from tronlab.nav.pose.smooth_noise import DEGREE, MIN_MATCHES, unit_covariance

N = 800
N_TRIALS = 40
SIGMA_PX = 0.3


def displaced(matches: Correspondences, shift_px: np.ndarray) -> Correspondences:
    uv = matches.uv + shift_px
    return replace(matches, uv=uv, rays=CAMERA.rays(uv))


def smooth_fields(matches: Correspondences) -> np.ndarray:
    """Orthonormal fields of motions and of cubic polynomials, shape (2 n, fields)."""
    x, y = ((matches.uv - 512.0) / 512.0).T
    terms = [x**i * y**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    polynomials = np.kron(np.column_stack(terms), np.eye(2))
    motions = jacobian_px(TRUTH, matches, CAMERA).reshape(-1, 6)
    fields = np.hstack([motions / np.linalg.norm(motions, axis=0), polynomials])
    return np.linalg.svd(fields, full_matrices=False)[0]


def mean_squares(noise) -> tuple[float, float, float]:
    """Give mean squared errors, weighed as the estimate says and without the ratio; the ratio."""
    found = []
    for seed in range(N_TRIALS):
        rng = np.random.default_rng(seed)
        matches = make_matches(rng, N, sigma_px=SIGMA_PX, depth_m=(1.5, 3.0))
        estimate = refine_pose(TRUTH, displaced(matches, noise(rng, matches)), CAMERA, gate_px=9.0)
        error = pose_difference(estimate.trs_from_cam, TRUTH)
        square = float(error @ np.linalg.solve(estimate.covariance, error))
        found.append((square, square * estimate.smooth_ratio, estimate.smooth_ratio))
    return tuple(np.mean(found, axis=0).tolist())


def test_smooth_noise_of_known_strength_is_found_and_believed() -> None:
    """Noise nine times as strong in smooth fields: the error is chi-square by the covariance."""

    def noise(rng: np.random.Generator, matches: Correspondences) -> np.ndarray:
        fields = smooth_fields(matches)
        amplitudes = np.sqrt(8.0) * SIGMA_PX * rng.normal(size=fields.shape[1])
        return (fields @ amplitudes).reshape(-1, 2)

    honest, naive, ratio = mean_squares(noise)
    low, high = chi2.ppf([0.0005, 0.9995], 6 * N_TRIALS) / N_TRIALS
    # Sizes come from few fields: the statistic is wider than chi-square, as F is.
    assert low < honest < high * 20 / 18
    assert naive > 5 * high
    # Over the noise in all, and large residuals, in which the fields are, have less weight.
    in_all = ((2 * N - 26) + 20 * 9.0) / (2 * N - 6)
    assert 0.7 * 9.0 < ratio * in_all < 1.2 * 9.0


def test_independent_noise_stays_as_it_is() -> None:
    honest, _, ratio = mean_squares(lambda _rng, matches: np.zeros_like(matches.uv))
    low, high = chi2.ppf([0.0005, 0.9995], 6 * N_TRIALS) / N_TRIALS
    assert 0.9 * low < honest < 1.1 * high
    assert 1.0 < ratio < 1.4


def test_noise_that_fades_with_distance_is_believed_in_part() -> None:
    """A random field of another form than the model's: better by far, but still too sure."""

    def noise(rng: np.random.Generator, matches: Correspondences) -> np.ndarray:
        waves, phases = rng.normal(size=(100, 2)) / 120.0, rng.uniform(0, 2 * np.pi, 100)
        return 0.1 * np.cos(matches.uv @ waves.T + phases) @ rng.normal(size=(100, 2)) / 50**0.5

    honest, naive, _ = mean_squares(noise)
    assert honest < 0.6 * naive
    assert honest < 20


def test_few_matches_and_a_line_of_them_do_no_harm(rng: np.random.Generator) -> None:
    few = make_matches(rng, MIN_MATCHES - 1, sigma_px=SIGMA_PX)
    assert refine_pose(TRUTH, few, CAMERA, gate_px=6.0).smooth_ratio == pytest.approx(1.0)
    line = make_matches(rng, 80, half_x=1e-4)
    residuals = rng.normal(size=(80, 2))
    jacobian = jacobian_px(TRUTH, line, CAMERA)
    assert np.isfinite(unit_covariance(line, residuals, jacobian)).all()


def test_exact_matches_have_a_ratio(rng: np.random.Generator) -> None:
    estimate = refine_pose(TRUTH, make_matches(rng, 100), CAMERA, gate_px=6.0)
    assert np.isfinite(estimate.covariance).all()


def test_scale_is_no_noise(rng: np.random.Generator) -> None:
    """Positions that are less certain than others, as they say, are not taken for smooth noise."""
    exact = make_matches(rng, 400)
    scale = 1.0 + 3.0 * (exact.uv[:, 0] > 512)
    uv = exact.uv + 0.2 * scale[:, None] * rng.normal(size=exact.uv.shape)
    matches = Correspondences(uv, CAMERA.rays(uv), exact.p_trs_m, scale)
    assert refine_pose(TRUTH, matches, CAMERA, gate_px=6.0).smooth_ratio < 2.0
