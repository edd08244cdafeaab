"""The terrain is never told to be farther than it is, and over flat ground it is told exactly."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from tronlab.planning.terrain_clearance import TerrainClearance
from tronlab.terrain.heightmap import HeightMap

SPACING_M = 0.01


def rough_heightmap(seed: int, *, relief_m: float = 0.3) -> HeightMap:
    """Give hills, pits and cliffs on 1.0 m x 1.6 m."""
    rng = np.random.default_rng(seed)
    coarse = rng.uniform(0.0, relief_m, (10, 16))
    height_m = np.kron(coarse, np.ones((10, 10)))
    return HeightMap(height_m.astype(np.float32), SPACING_M, np.array([0.2, -0.3, 0.05]))


def surface_points(heightmap: HeightMap) -> np.ndarray:
    rows, columns = heightmap.height_m.shape
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    steps = np.stack([i * SPACING_M, j * SPACING_M, heightmap.height_m], axis=-1)
    return heightmap.origin_trs_m + steps.reshape(-1, 3)


@pytest.mark.parametrize("seed", [0, 1])
def test_points_are_never_told_farther_than_the_nearest_sample(seed: int):
    heightmap = rough_heightmap(seed)
    rng = np.random.default_rng(seed)
    points = rng.uniform([-0.5, -1.0, 0.06], [1.9, 2.0, 1.5], (300, 3))
    true_m = KDTree(surface_points(heightmap)).query(points)[0]
    told_m = TerrainClearance.of(heightmap).of_cylinders_m(points, np.zeros(300), points[:, 2])
    assert np.all(told_m <= true_m + 1e-9)
    is_above = np.all((points[:, :2] > [0.2, -0.3]) & (points[:, :2] < [1.19, 1.29]), axis=1)
    is_far = is_above & (points[:, 2] > 0.5)
    assert np.all(told_m[is_far] > 0.6 * true_m[is_far] - 0.02)


def test_over_flat_ground_the_distance_is_exact_at_any_height():
    flat = HeightMap(np.full((101, 161), 0.1, np.float32), SPACING_M, np.array([0.0, 0.0, 0.0]))
    p0 = np.array([[0.5, 0.4, z] for z in (0.15, 0.3, 0.7, 2.0)])
    p1 = p0 + np.array([0.0, 0.3, 0.2])
    told_m = TerrainClearance.of(flat).of_segments_m(p0, p1)
    np.testing.assert_allclose(told_m, p0[:, 2] - 0.1, atol=1e-6)


def test_below_the_surface_is_negative_and_beside_the_model_is_not():
    clearance = TerrainClearance.of(rough_heightmap(2))
    points = np.array([[0.7, 0.5, -0.2], [0.7, -0.7, -0.2], [0.7, 1.5, 0.1]])
    told_m = clearance.of_cylinders_m(points, np.zeros(3), points[:, 2])
    assert told_m[0] < 0.0
    np.testing.assert_allclose(told_m[1], 0.4, atol=1e-6)
    np.testing.assert_allclose(told_m[2], 0.21, atol=1e-6)


def test_a_single_peak_is_found_whatever_cell_it_is_in():
    for row, column in ((0, 0), (99, 159), (47, 53), (20, 20), (100, 160)):
        height_m = np.zeros((101, 161), np.float32)
        height_m[row, column] = 0.4
        heightmap = HeightMap(height_m, SPACING_M, np.zeros(3))
        above = np.array([[row * SPACING_M, column * SPACING_M, 0.5]])
        told_m = TerrainClearance.of(heightmap).of_cylinders_m(above, np.zeros(1), above[:, 2])
        assert told_m[0] == pytest.approx(0.1, abs=1e-6)


def test_terrain_coarser_than_the_cells_is_taken_as_it_is():
    heightmap = HeightMap(np.zeros((12, 22), np.float32), 0.2, np.zeros(3))
    point = np.array([[1.0, 2.0, 0.35]])
    told_m = TerrainClearance.of(heightmap).of_cylinders_m(point, np.zeros(1), point[:, 2])
    assert told_m[0] == pytest.approx(0.35)
