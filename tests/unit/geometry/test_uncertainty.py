import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from tronlab.geometry.uncertainty import (
    compose_covariance,
    inverse_covariance,
    perturb,
    pose_difference,
)

N_DRAWS = 1000


def random_pose(rng):
    return RigidTransform.from_components(rng.normal(size=3), Rotation.random(rng=rng))


def random_covariance(rng):
    root = rng.normal(size=(6, 6)) * 1e-4
    return root @ root.T + 1e-10 * np.eye(6)


def draws(rng, pose, covariance):
    differences = rng.multivariate_normal(np.zeros(6), covariance, size=N_DRAWS)
    return [perturb(pose, difference) for difference in differences]


def assert_is_covariance(differences, covariance):
    """The mean normalised square error of n draws lies in its 99.9 % interval."""
    nees = np.einsum("ni,ij,nj->n", differences, np.linalg.inv(covariance), differences)
    low, high = chi2.ppf([0.0005, 0.9995], 6 * len(differences)) / len(differences)
    assert low < nees.mean() < high


def test_difference_undoes_perturbation():
    rng = np.random.default_rng(1)
    pose, difference = random_pose(rng), rng.normal(size=6) * 0.1
    np.testing.assert_allclose(pose_difference(pose, perturb(pose, difference)), difference)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_covariance_of_a_product_agrees_with_draws(seed):
    rng = np.random.default_rng(seed)
    first, second = random_pose(rng), random_pose(rng)
    cov_first, cov_second = random_covariance(rng), random_covariance(rng)
    pairs = zip(draws(rng, first, cov_first), draws(rng, second, cov_second), strict=True)
    differences = np.array([pose_difference(first * second, a * b) for a, b in pairs])
    assert_is_covariance(differences, compose_covariance(first, cov_first, second, cov_second))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_covariance_of_the_inverse_agrees_with_draws(seed):
    rng = np.random.default_rng(seed)
    pose, covariance = random_pose(rng), random_covariance(rng)
    inverses = [drawn.inv() for drawn in draws(rng, pose, covariance)]
    differences = np.array([pose_difference(pose.inv(), inverse) for inverse in inverses])
    assert_is_covariance(differences, inverse_covariance(pose, covariance))


def test_inverting_twice_gives_the_covariance_back():
    rng = np.random.default_rng(4)
    pose, covariance = random_pose(rng), random_covariance(rng)
    twice = inverse_covariance(pose.inv(), inverse_covariance(pose, covariance))
    np.testing.assert_allclose(twice, covariance, rtol=1e-9, atol=1e-18)
