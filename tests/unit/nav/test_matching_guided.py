"""Guided matching looks where the covariance of a pose says, and nowhere else."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.uncertainty import perturb
from tronlab.nav.database import Database
from tronlab.nav.features import Features
from tronlab.nav.matching import Matches, guided, guided_matches
from tronlab.nav.matching.guided import INSIDE_PROBABILITY, RADIUS_PX

N = 600
N_POSES = 50
SIZE_PX = 6.0
COVARIANCE = np.diag([0.02, 0.01, 0.03, 0.02, 0.04, 0.03]) ** 2
COVARIANCE[0, 4] = COVARIANCE[4, 0] = 0.9 * 0.02 * 0.04


@pytest.fixture(scope="module")
def truth(pose) -> RigidTransform:
    return pose(1.9, x_m=0.1, tilt=(0.2, -0.1, 0.5))


@pytest.fixture(scope="module")
def database(camera, truth) -> Database:
    """Landmarks that are seen well inside the image from ``truth``."""
    rng = np.random.default_rng(0)
    uv = rng.uniform([60, 60], [260, 230], (N, 2))
    depth = rng.uniform(1.7, 2.1, N)
    p_cam = np.column_stack([camera.rays(uv), np.ones(N)]) * depth[:, None]
    descriptors = rng.integers(0, 256, (N, 61), dtype=np.uint8)
    size_m = SIZE_PX * depth / camera.fx_px
    view, eyes = np.arange(N) % 3, truth.translation + np.array([[0.0], [0.5], [2.0]])
    return Database(truth.apply(p_cam), size_m, descriptors, view, eyes)


def seen(database, camera, trs_from_cam, *, noise_px: float = 0.0) -> Features:
    uv = camera.project(trs_from_cam.inv().apply(database.p_trs_m))
    uv += noise_px * np.random.default_rng(1).standard_normal(uv.shape)
    return Features(uv, np.full(N, SIZE_PX), database.descriptors.copy())


def n_right(matches: Matches) -> int:
    """Count the right ones; what is left, a landmark like a feature by chance, is ambiguous."""
    is_right = matches.feature == matches.landmark
    assert (matches.ratio[~is_right] > 0.8).all()
    return int(is_right.sum())


def test_as_many_are_found_as_the_ellipse_shall_hold(camera, database, truth) -> None:
    """The pose is wrong as its covariance says, the detector as ``radius_px`` says."""
    rng = np.random.default_rng(2)
    gate = np.sqrt(-2 * np.log(1 - INSIDE_PROBABILITY))  # chi-square of two degrees of freedom
    found = []
    for error in rng.multivariate_normal(np.zeros(6), COVARIANCE, N_POSES):
        features = seen(database, camera, truth, noise_px=2.0 / gate)
        near = perturb(truth, error)
        matches = guided_matches(database, features, camera, near, COVARIANCE, radius_px=2.0)
        found.append(n_right(matches) / N)
    # The landmarks of one pose share its error: their mean has the spread of the poses.
    assert np.mean(found) == pytest.approx(
        INSIDE_PROBABILITY, abs=4 * np.std(found) / np.sqrt(N_POSES) + 1e-3
    )
    assert np.mean(found) < 1


def test_without_a_covariance_the_radius_counts(camera, database, truth) -> None:
    features = seen(database, camera, truth)
    for shift_px, expected in ((0.9 * RADIUS_PX, N), (1.1 * RADIUS_PX, 0)):
        uv = features.uv + np.array([0, shift_px])
        moved = Features(uv, features.size_px, features.descriptors)
        matches = guided_matches(database, moved, camera, truth)
        assert n_right(matches) == expected


def test_a_wrong_prior_finds_nothing(camera, database, truth) -> None:
    features = seen(database, camera, truth)
    wrong = perturb(truth, np.array([0, 0, 0, 0.5, 0.4, 0]))
    assert n_right(guided_matches(database, features, camera, wrong)) == 0
    behind = perturb(truth, np.array([np.pi, 0, 0, 0, 0, 0]))
    assert len(guided_matches(database, features, camera, behind, COVARIANCE)) == 0
    nothing = Features(np.empty((0, 2)), np.empty(0), np.empty((0, 61), np.uint8))
    assert len(guided_matches(database, nothing, camera, truth)) == 0


def test_a_landmark_of_another_size_is_another_one(camera, database, truth) -> None:
    features = seen(database, camera, truth)
    for factor, expected in ((1.3, N), (0.75, N), (1.5, 0), (0.65, 0)):
        other = Features(features.uv, factor * features.size_px, features.descriptors)
        assert n_right(guided_matches(database, other, camera, truth)) == expected


def test_of_a_large_database_the_nearest_views_count(camera, database, truth, monkeypatch) -> None:
    features = seen(database, camera, truth)
    monkeypatch.setattr(guided, "MAX_LANDMARKS", N // 2)
    assert set(guided_matches(database, features, camera, truth).landmark % 3) == {0, 1}


def test_the_rival_is_what_else_should_be_seen_there(camera, database, truth) -> None:
    """Two landmarks at one place in the image, one behind the other, a quarter of bits apart."""
    rng = np.random.default_rng(5)
    flips = np.packbits(rng.random((N, 488)) < 0.25, axis=1)
    arms = database.p_trs_m - truth.translation
    twice = Database(
        np.concatenate([database.p_trs_m, truth.translation + 1.05 * arms]),
        np.tile(database.size_m, 2),
        np.concatenate([database.descriptors, database.descriptors ^ flips]),
        np.tile(database.view, 2),
    )
    features = seen(database, camera, truth)
    noisy = features.descriptors ^ np.packbits(rng.random((N, 488)) < 0.05, axis=1)
    matches = guided_matches(
        twice, Features(features.uv, features.size_px, noisy), camera, truth, radius_px=1.0
    )
    assert len(matches) == N
    assert (matches.feature == matches.landmark).all()
    rival = np.bitwise_count(noisy ^ twice.descriptors[N:]).sum(axis=1)[matches.feature]
    assert np.mean(matches.ratio == matches.distance / rival) > 0.95
