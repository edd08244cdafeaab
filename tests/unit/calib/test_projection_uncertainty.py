from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tronlab.calib.camera.projection import intrinsics_of, with_intrinsics
from tronlab.calib.camera.projection_uncertainty import projection_sigma_px
from tronlab.calib.results import CameraResult
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

GRID = np.stack(np.meshgrid(*[np.linspace(0, 1023, 21)] * 2), axis=-1).reshape(-1, 2)
INDEPENDENT = np.diag([0.2, 0.2, 0.5, 0.5, 3e-4, 5e-4, 5e-5, 5e-5, 2e-4, 0, 0, 0]) ** 2


def project_moved(camera: CameraModel, move: FloatArray, points: FloatArray) -> FloatArray:
    turned = Rotation.from_rotvec(move[:3]).apply(points)
    return camera.project(turned + (move[3:] if len(move) > 3 else 0.0))


@pytest.mark.parametrize(("distance_m", "n_moves"), [(None, 3), (0.7, 6)])
def test_it_is_what_a_turn_to_fit_leaves_of_each_error(
    bench: SimpleNamespace, distance_m: float | None, n_moves: int
) -> None:
    """Each intrinsic one sigma off, the camera turned (and moved) to fit by another solver."""
    camera, sigmas = bench.camera, np.sqrt(np.diag(INDEPENDENT))
    points = np.column_stack([camera.rays(GRID), np.ones(len(GRID))]) * (distance_m or 1.0)
    squares = np.zeros(len(GRID))
    for error in np.diag(sigmas)[sigmas > 0]:
        other = with_intrinsics(camera, intrinsics_of(camera) + error)
        fit = least_squares(
            lambda move, other=other: (project_moved(other, move, points) - GRID).ravel(),
            np.zeros(n_moves),
        )
        squares += ((project_moved(other, fit.x, points) - GRID) ** 2).mean(axis=1)
    predicted = projection_sigma_px(
        CameraResult(camera, INDEPENDENT, "brown"), GRID, distance_m=distance_m
    )
    np.testing.assert_allclose(predicted, np.sqrt(squares), rtol=0.02, atol=0.002)


def test_a_turn_of_the_camera_is_no_uncertainty(bench: SimpleNamespace) -> None:
    """A long lens knows its principal point badly, and where it looks well all the same."""
    camera = CameraModel(1024, 1024, 1e5, 1e5, 511.5, 511.5)
    covariance = np.zeros((12, 12))
    covariance[2, 2] = covariance[3, 3] = 25.0
    sigma = projection_sigma_px(CameraResult(camera, covariance, "pinhole"), GRID)
    assert sigma.max() < 1e-3
