import numpy as np
import pytest

from tronlab.terrain import craters, procedural
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.procedural import make_terrain, rough_surface, scaled_to_relief


def small(**settings):
    return ProceduralTerrain(
        **{"size_m": (0.4, 0.6), "spacing_m": 0.002, "relief_m": 0.08, **settings}
    )


def test_the_same_seed_gives_the_same_terrain_and_another_seed_another():
    first = make_terrain(small(seed=4))
    np.testing.assert_array_equal(first, make_terrain(small(seed=4)))
    other = make_terrain(small(seed=5))
    assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 0.9
    assert np.abs(first - other).mean() > 0.005


@pytest.mark.parametrize("n", [1, 2, 3])
def test_the_number_of_threads_does_not_change_the_terrain(monkeypatch, n):
    reference = make_terrain(small())
    monkeypatch.setattr(craters, "n_cores", lambda: n)
    monkeypatch.setattr(procedural, "n_cores", lambda: n)
    np.testing.assert_array_equal(make_terrain(small()), reference)


@pytest.mark.parametrize("relief_m", [0.02, 0.26])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_relief_is_exact(seed, relief_m):
    config = small(seed=seed, relief_m=relief_m)
    height = make_terrain(config)
    assert height.shape == config.shape == (201, 301)
    assert height.dtype == np.float32
    assert height.flags.c_contiguous
    assert height.min() == 0
    assert height.max() == np.float32(relief_m)


def test_hills_fill_up_the_relief_and_leave_craters_their_depth():
    """Doubling the relief must not double the slopes at crater scale."""
    low, high = (make_terrain(small(relief_m=relief)) for relief in (0.1, 0.2))
    fine_low, fine_high = (np.diff(height, 2, axis=1).std() for height in (low, high))
    assert fine_high == pytest.approx(fine_low, rel=0.1)


def test_roughness_is_self_affine_with_the_slope_asked_for():
    surface = rough_surface(
        np.random.default_rng(3),
        (900, 1000),
        spacing_m=0.001,
        hurst_exponent=0.7,
        slope=0.1,
        longest_wave_m=1.5,
    )
    lags = np.array([5, 10, 20, 40])
    rms = np.array([np.sqrt(np.mean((surface[:, n:] - surface[:, :-n]) ** 2)) for n in lags])
    assert rms[1] == pytest.approx(0.1 * 0.01, rel=1e-3)
    assert np.polyfit(np.log(lags), np.log(rms), 1)[0] == pytest.approx(0.7, abs=0.08)
    down = np.sqrt(np.mean((surface[10:] - surface[:-10]) ** 2))
    assert down == pytest.approx(rms[1], rel=0.15), "rough in all directions alike"


def test_scaling_works_on_heights_far_from_zero():
    height = scaled_to_relief(np.array([[1000.0, 1000.5], [1001.0, 1002.0]], np.float32), 0.3)
    assert height.min() == 0
    assert height.max() == np.float32(0.3)
