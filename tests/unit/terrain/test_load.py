import logging
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tronlab.terrain import load, tiled
from tronlab.terrain.config import (
    DemTerrain,
    FileTerrain,
    ProceduralTerrain,
    ScanConfig,
    ScannedTerrain,
)
from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.load import load_terrain, make_dem

CONFIG = ProceduralTerrain(size_m=(0.1, 0.2), spacing_m=0.002, relief_m=0.02)


@pytest.fixture(autouse=True)
def cache_folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.setattr(
        "tronlab.terrain.cache.platformdirs.user_cache_path", lambda name: tmp_path / "cache" / name
    )
    return tmp_path / "cache" / "tronlab" / "terrain"


@pytest.fixture
def announced():
    return []


def load_again(config=CONFIG, *, base_dir=Path(), announced=None):
    return load_terrain(
        config, base_dir=base_dir, announce=None if announced is None else announced.append
    )


def test_a_height_map_stands_where_it_is_told():
    heightmap = load_again(CONFIG.model_copy(update={"origin_trs_m": (1.0, 2.0, 3.0)}))
    assert heightmap.height_m.shape == (51, 101)
    assert heightmap.size_m == pytest.approx((0.1, 0.2))
    np.testing.assert_array_equal(heightmap.origin_trs_m, [1, 2, 3])


def test_the_second_time_comes_from_the_cache(announced, cache_folder, monkeypatch):
    first = load_again(announced=announced)
    assert len(announced) == 1
    assert "51 x 101 samples" in announced[0]
    monkeypatch.setattr(load, "make_terrain", lambda _: pytest.fail("was made again"))
    second = load_again(announced=announced)
    np.testing.assert_array_equal(first.height_m, second.height_m)
    assert len(announced) == 1
    assert sorted(path.suffix for path in cache_folder.iterdir()) == [".json", ".npy"]


def test_another_place_needs_no_other_heights(announced):
    load_again(announced=announced)
    load_again(CONFIG.model_copy(update={"origin_trs_m": (0.0, 0.0, 0.0)}), announced=announced)
    assert len(announced) == 1


@pytest.mark.parametrize(
    "change", [{"seed": 2}, {"relief_m": 0.03}, {"crater_exponent": 2.5}, {"spacing_m": 0.001}]
)
def test_other_settings_are_other_heights(announced, change):
    first = load_again(announced=announced)
    second = load_again(CONFIG.model_copy(update=change), announced=announced)
    assert len(announced) == 2
    assert not np.array_equal(first.height_m, second.height_m)


def test_another_generator_makes_new_heights(announced, monkeypatch):
    load_again(announced=announced)
    monkeypatch.setattr(load, "GENERATOR_VERSION", 10_000)
    load_again(announced=announced)
    assert len(announced) == 2


@pytest.mark.parametrize(
    "damage", ["truncated", "empty", "a flipped bit", "another shape", "another description"]
)
def test_a_damaged_cache_is_made_again(announced, cache_folder, damage, caplog):
    first = load_again(announced=announced)
    (path,) = cache_folder.glob("*.npy")
    content = bytearray(path.read_bytes())
    if damage == "truncated":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "a flipped bit":
        content[5000] ^= 1
        path.write_bytes(content)
    elif damage == "another description":
        path.with_suffix(".json").write_text("{}")
    else:
        np.save(path, np.zeros((3, 3), np.float32))
    second = load_again(announced=announced)
    assert len(announced) == 2
    assert "is made again" in caplog.text
    np.testing.assert_array_equal(first.height_m, second.height_m)
    load_again(announced=announced)
    assert len(announced) == 2, "the cache was mended"


def test_without_a_writable_cache_the_terrain_is_made_all_the_same(cache_folder, caplog):
    cache_folder.parent.parent.mkdir()
    cache_folder.parent.write_text("a file where the folder should be")
    heightmap = load_again()
    assert heightmap.relief_m == pytest.approx(0.02)
    assert "the terrain is not cached" in caplog.text


def test_by_default_the_log_is_told(caplog):
    with caplog.at_level(logging.INFO, logger="tronlab.terrain.load"):
        load_again()
    assert "making the terrain model" in caplog.text


def test_a_file_is_looked_for_beside_the_rig(tmp_path, announced):
    samples = np.random.default_rng(1).random((20, 40)).cumsum(axis=0)
    np.save(tmp_path / "map.npy", samples)
    config = FileTerrain(path=Path("map.npy"), size_m=(0.1, 0.2), relief_m=0.02, spacing_m=0.002)
    first = load_again(config, base_dir=tmp_path, announced=announced)
    n_announced = len(announced)
    load_again(config, base_dir=tmp_path, announced=announced)
    assert len(announced) == n_announced
    np.save(tmp_path / "map.npy", samples[::-1].copy())
    other = load_again(config, base_dir=tmp_path, announced=announced)
    assert not np.array_equal(first.height_m, other.height_m), "the file's content is in the key"


def test_a_missing_file_says_where_it_was_looked_for(tmp_path):
    config = FileTerrain(path=Path("maps/none.png"))
    with pytest.raises(TerrainError, match=r"maps/none\.png does not exist; a relative path"):
        load_again(config, base_dir=tmp_path)


def test_a_folder_is_no_terrain_file(tmp_path):
    with pytest.raises(TerrainError, match="does not exist"):
        load_again(FileTerrain(path=tmp_path), base_dir=tmp_path)


@pytest.fixture
def small_memory(monkeypatch):
    """Let a terrain of more than 20000 samples count as too large for memory."""
    monkeypatch.setattr(load, "MAX_SAMPLES_IN_MEMORY", 20_000)


LARGE = CONFIG.model_copy(update={"size_m": (0.4, 0.5), "relief_m": 0.03})


def test_a_large_terrain_stays_in_the_cache(small_memory, announced, cache_folder, monkeypatch):
    first = load_again(LARGE, announced=announced)
    assert first.height_m.shape == LARGE.shape
    assert first.file is not None
    assert first.file.parent == cache_folder
    assert first.relief_m == np.float32(0.03)
    assert "201 x 251 samples" in announced[0]
    n_announced = len(announced)
    monkeypatch.setattr(tiled, "write_terrain", lambda *_, **__: pytest.fail("was made again"))
    second = load_again(
        LARGE.model_copy(update={"origin_trs_m": (1.0, 2.0, 3.0)}), announced=announced
    )
    assert len(announced) == n_announced
    np.testing.assert_array_equal(first.height_m, second.height_m)
    np.testing.assert_array_equal(second.origin_trs_m, [1, 2, 3])
    assert (second.fingerprint, second.statistics) == (first.fingerprint, first.statistics)


def test_a_large_terrain_needs_its_cache(small_memory, cache_folder, monkeypatch):
    monkeypatch.setattr(
        "tronlab.terrain.new_file.os.statvfs", lambda _: SimpleNamespace(f_bavail=10, f_frsize=512)
    )
    with pytest.raises(TerrainError, match=r"are needed and 0\.0 GB are free(?s:.*)XDG_CACHE_HOME"):
        load_again(LARGE)
    assert not list(cache_folder.iterdir())


def test_a_terrain_model_of_ones_own(tmp_path, announced, small_memory):
    dem = DemTerrain(path=Path("model.npy"))
    for config in (CONFIG, LARGE):
        make_dem(config, tmp_path / "model.npy", announce=announced.append)
        heightmap = load_again(dem, base_dir=tmp_path)
        np.testing.assert_array_equal(heightmap.origin_trs_m, config.origin_trs_m)
        assert heightmap.height_m.shape == config.shape
        assert heightmap.relief_m == np.float32(config.relief_m)
        assert (heightmap.file is None) == (config is CONFIG)
    assert len(announced) == 2
    moved = load_again(dem.model_copy(update={"origin_trs_m": (0.0, 1.0, 2.0)}), base_dir=tmp_path)
    np.testing.assert_array_equal(moved.origin_trs_m, [0, 1, 2])
    np.testing.assert_array_equal(moved.height_m, heightmap.height_m)
    with pytest.raises(TerrainError, match=r"none\.npy does not exist; a relative path"):
        load_again(DemTerrain(path=Path("none.npy")), base_dir=tmp_path)


def test_a_scan_of_a_terrain_differs_by_what_the_scanner_adds(announced, cache_folder):
    noisy = ScannedTerrain(of=CONFIG, scan=ScanConfig(noise_sigma_m=1e-4))
    true = load_again(announced=announced)
    scanned = load_again(noisy, announced=announced)
    assert (scanned.height_m - true.height_m).std() == pytest.approx(1e-4, rel=0.05)
    np.testing.assert_array_equal(scanned.origin_trs_m, true.origin_trs_m)
    told = len(announced)
    np.testing.assert_array_equal(load_again(noisy, announced=announced).height_m, scanned.height_m)
    assert len(announced) == told  # it came from the cache


def test_a_perfect_scan_of_a_file_is_the_file_and_follows_its_contents(tmp_path):
    make_dem(CONFIG, tmp_path / "model.npy")
    config = ScannedTerrain(of=DemTerrain(path=Path("model.npy")))
    assert config.files == (Path("model.npy"),)
    first = load_again(config, base_dir=tmp_path)
    np.testing.assert_allclose(first.height_m, load_again().height_m, atol=1e-7)
    make_dem(CONFIG.model_copy(update={"seed": 2}), tmp_path / "model.npy")
    assert not np.array_equal(load_again(config, base_dir=tmp_path).height_m, first.height_m)


def test_a_scan_of_a_file_follows_where_its_description_puts_it(tmp_path):
    config = ScannedTerrain(of=DemTerrain(path=Path("model.npy")))
    for origin_trs_m in ((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)):
        moved = CONFIG.model_copy(update={"origin_trs_m": origin_trs_m})
        make_dem(moved, tmp_path / "model.npy")
        scanned = load_again(config, base_dir=tmp_path)
        np.testing.assert_array_equal(scanned.origin_trs_m, origin_trs_m)


def test_a_scan_stands_where_the_scanned_terrain_stands():
    config = ScannedTerrain(of=CONFIG.model_copy(update={"origin_trs_m": (1.0, 2.0, 3.0)}))
    load_again(ScannedTerrain(of=CONFIG))
    np.testing.assert_array_equal(load_again(config).origin_trs_m, [1, 2, 3])


@pytest.mark.parametrize(
    "other",
    [
        ScannedTerrain(of=CONFIG, scan=ScanConfig(noise_sigma_m=2e-4)),
        ScannedTerrain(of=CONFIG, scan=ScanConfig(noise_sigma_m=1e-4, spacing_m=0.004)),
        ScannedTerrain(
            of=CONFIG.model_copy(update={"seed": 2}), scan=ScanConfig(noise_sigma_m=1e-4)
        ),
    ],
)
def test_another_scan_is_not_taken_for_one_that_is_kept(other):
    first = load_again(ScannedTerrain(of=CONFIG, scan=ScanConfig(noise_sigma_m=1e-4)))
    second = load_again(other)
    assert not np.array_equal(first.height_m, second.height_m)
