"""The terrain made in tiles: as the theory has it, and the same whatever the tiles."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import special

from tronlab.terrain import tiled
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.craters import Craters, stamp_craters
from tronlab.terrain.dem import describe_dem, open_dem
from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.tiled import write_terrain
from tronlab.terrain.tiled_roughness import TiledRoughness, _Law

SHAPE = (600, 1000)
LAW = {"spacing_m": 0.0005, "hurst_exponent": 0.8, "slope": 0.12}


def rough(*, tile_px, seed=3, shape=SHAPE, **law):
    roughness = TiledRoughness(seed, shape, tile_px=tile_px, **{**LAW, **law})
    surface = np.empty(shape, np.float32)
    for row in range(0, shape[0], tile_px):
        for column in range(0, shape[1], tile_px):
            tile = roughness.tile(row, column)
            surface[row : row + tile.shape[0], column : column + tile.shape[1]] = tile
    return surface


@pytest.fixture(scope="module")
def surface():
    return rough(tile_px=512)


def test_tiles_join_whatever_their_size(surface):
    """Every sample is the same in another tiling, so a border cannot be told from the inside."""
    assert np.abs(surface - rough(tile_px=1024)).max() < 3e-7
    other = rough(tile_px=512, seed=9, shape=(500, 500))
    assert np.abs(surface[:500, :500] - other).mean() > 1e-3


def test_the_slope_is_that_asked_for(surface):
    """Long waves make it differ from model to model."""
    for rise in (surface[:, 20:] - surface[:, :-20], surface[20:] - surface[:-20]):
        assert np.sqrt(np.mean(rise**2, dtype=np.float64)) / 0.01 == pytest.approx(0.12, rel=0.15)


def test_the_power_of_every_band_of_waves_is_that_of_the_law(surface):
    """Long waves, short ones, and those of about 100 samples where the two meet."""
    law = _Law.of_slope(LAW["slope"], LAW["spacing_m"], LAW["hurst_exponent"])
    n, m = surface.shape
    window = np.hanning(n)[:, None] * np.hanning(m)
    power = np.abs(np.fft.rfft2((surface - surface.mean()) * window)) ** 2
    k = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(m))
    k[0, 0] = 1.0
    relative = power / (law.amplitude(k) ** 2 * np.sum(window**2))
    for low, high in pairwise(np.geomspace(0.005, 0.48, 14)):
        band = relative[(k >= low) & (k < high)]
        # The power of a wave has an exponential distribution; a Hann window makes neighbours
        # alike, so that of 1.5 in each direction one counts.
        assert band.mean() == pytest.approx(1.0, abs=0.01 + 4 * 1.5 / np.sqrt(band.size))


def test_the_expected_slope_is_that_of_the_theory():
    """Without a longest wave the structure function of power A k^-(2 H + 2) is A c(H) lag^(2 H).

    c(H) from Yaglom, Correlation Theory of Stationary and Related Random Functions, 1987, for the
    whole plane; a lag of many samples hardly notices the shortest waves.
    """
    h, lag = 0.6, 40
    law = _Law(1.0, h, 1e7)
    c = 2 * np.pi ** (2 * h + 1) * special.gamma(1 - h) / (h * special.gamma(1 + h))
    assert law.rms_rise(lag) == pytest.approx(np.sqrt(c * lag ** (2 * h)), rel=0.01)


@pytest.fixture(scope="module")
def config():
    return ProceduralTerrain(
        size_m=(0.3, 0.3), spacing_m=0.0005, relief_m=0.12, crater_largest_m=0.3, seed=6
    )


def test_a_whole_terrain_is_the_same_whatever_the_tiles(config, tmp_path, monkeypatch):
    announced = []
    write_terrain(config, tmp_path / "a.npy", made_by={"seed": 6}, announce=announced.append)
    monkeypatch.setattr(tiled, "_ANNOUNCED_EVERY_S", 0.0)
    write_terrain(config, tmp_path / "b.npy", made_by={}, announce=announced.append, tile_px=512)
    first, second = open_dem(tmp_path / "a.npy"), open_dem(tmp_path / "b.npy")
    assert first.height_m.shape == config.shape
    assert np.abs(first.height_m - second.height_m).max() < 5e-7
    assert (first.height_m.min(), first.height_m.max()) == (0, np.float32(0.12))
    assert describe_dem(tmp_path / "a.npy").made_by == {"seed": 6}
    np.testing.assert_array_equal(first.origin_trs_m, config.origin_trs_m)
    assert any("% made, about" in line for line in announced)


def test_craters_go_on_across_the_borders_of_tiles():
    craters = Craters(*(np.array([value]) for value in (0.1, 0.06, 0.05, 0.0)))
    whole = np.zeros((250, 250), np.float32)
    stamp_craters(whole, 0.0005, craters)
    pieces = np.zeros_like(whole)
    for row, column in tiled._corners(pieces.shape, 100):
        tile = pieces[row : row + 100, column : column + 100].copy()
        tiled._stamp(tile, row, column, 0.0005, craters)
        pieces[row : row + 100, column : column + 100] = tile
    assert whole.min() < -0.015
    np.testing.assert_allclose(pieces, whole, atol=1e-8)


def test_nothing_is_left_when_it_is_interrupted(config, tmp_path, monkeypatch):
    def interrupted(writer, *_):
        assert list(writer.path.parent.glob("a.npy.*.part"))
        raise KeyboardInterrupt

    monkeypatch.setattr(tiled, "_write_ground", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_terrain(config, tmp_path / "a.npy", made_by={}, announce=lambda _: None)
    assert not list(tmp_path.iterdir())


def test_a_law_of_too_many_craters_is_refused(config, tmp_path):
    many = config.model_copy(update={"crater_smallest_m": 0.001, "size_m": (20.0, 20.0)})
    with pytest.raises(TerrainError, match=r"about \d+ million.*make crater_smallest_m larger"):
        write_terrain(many, tmp_path / "a.npy", made_by={}, announce=lambda _: None)
