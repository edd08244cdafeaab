"""The covariance of a terrain model's place is that of the errors that are drawn."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from tronlab.geometry.uncertainty import compose_covariance, pose_difference
from tronlab.terrain.config import DemTerrain, Registration, ScannedTerrain
from tronlab.terrain.heightmap import HeightMap
from tronlab.terrain.registration import draw_registration_error, registration_covariance

MAP = HeightMap(np.full((41, 81), 0.1, np.float32), 0.05, np.array([0.3, -0.4, -0.1]))
STATED = Registration(sigma_m=1e-4, sigma_deg=0.003)
DOWN = RigidTransform.from_components(
    [1.5, 2.0, 3.0], Rotation.from_euler("xz", [175, 30], degrees=True)
)


def test_drawn_errors_move_a_camera_as_the_covariance_says():
    rng, n = np.random.default_rng(3), 800
    drawn = [draw_registration_error(rng, MAP, STATED) * DOWN for _ in range(n)]
    moved = np.array([pose_difference(DOWN, pose) for pose in drawn])
    covariance = compose_covariance(
        RigidTransform.identity(), registration_covariance(MAP, STATED), DOWN, np.zeros((6, 6))
    )
    squares = np.einsum("ni,ij,nj->n", moved, np.linalg.inv(covariance), moved)
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 6 * n)
    assert low < squares.sum() < high
    # The camera has a lever of some metres about the middle, and no more.
    middle_m = np.array([0.3 + 1.0, -0.4 + 2.0, 0.0])
    lever_m2 = 2.0 * np.sum((DOWN.translation - middle_m) ** 2)
    expected_m2 = 3.0 * STATED.sigma_m**2 + np.radians(STATED.sigma_deg) ** 2 * lever_m2
    assert np.trace(covariance[3:, 3:]) == pytest.approx(expected_m2)


def test_a_terrain_that_is_scanned_cannot_be_badly_registered_itself():
    inner = DemTerrain(path=Path("model.npy"), registration_sigma_m=1e-4)
    assert inner.registration == Registration(1e-4, 0.0)
    with pytest.raises(ValueError, match="state both under scan"):
        ScannedTerrain(of=inner)
