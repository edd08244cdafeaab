"""tronlab's own terrain files: what is written is read, and damage is told."""

import fcntl
import json
import os

import numpy as np
import pytest

from tronlab.terrain import dem
from tronlab.terrain.dem import describe_dem, open_dem, read_dem, save_dem
from tronlab.terrain.dem_file import HeightsFile
from tronlab.terrain.heightmap import HeightMap, TerrainError, measure_heights

ORIGIN = (0.5, -0.25, 2.0)


@pytest.fixture
def heightmap():
    heights = np.random.default_rng(1).normal(0.1, 0.02, (60, 50)).astype(np.float32)
    return HeightMap(heights, 0.002, np.array(ORIGIN))


@pytest.fixture
def saved(tmp_path, heightmap, monkeypatch):
    """A file in bands of 7 rows."""
    monkeypatch.setattr(dem, "rows_per_band", lambda _: 7)
    save_dem(tmp_path / "model.npy", heightmap, made_by={"seed": 1}, n_holes_filled=3)
    return tmp_path / "model.npy"


@pytest.mark.parametrize("open_file", [open_dem, read_dem])
def test_a_model_survives_its_file(saved, heightmap, open_file):
    found = open_file(saved)
    np.testing.assert_array_equal(found.height_m, heightmap.height_m)
    np.testing.assert_array_equal(found.origin_trs_m, ORIGIN)
    assert found.spacing_m == heightmap.spacing_m
    assert found.statistics == heightmap.statistics
    assert type(found.height_m) is np.ndarray
    assert found.file == (saved if open_file is open_dem else None)
    assert sorted(path.name for path in saved.parent.iterdir()) == ["model.json", "model.npy"]
    np.testing.assert_array_equal(np.load(saved), heightmap.height_m)  # anyone may open it


def test_the_description_says_how_it_was_made(saved, heightmap):
    said = json.loads(saved.with_suffix(".json").read_text())
    assert said["made_by"] == {"seed": 1}
    assert said["n_holes_filled"] == 3
    assert said["highest_m"] == heightmap.height_m.max()
    assert len(said["crc32"]) == 9


def test_writing_to_an_open_model_does_not_change_its_file(saved):
    found = open_dem(saved)
    before = saved.read_bytes()
    found.height_m[:] = 0.0
    assert saved.read_bytes() == before


def test_other_heights_have_another_fingerprint(saved, heightmap, tmp_path):
    first = describe_dem(saved).fingerprint
    moved = HeightMap(heightmap.height_m, 0.003, np.zeros(3))
    save_dem(tmp_path / "moved.npy", moved, made_by={})
    assert describe_dem(tmp_path / "moved.npy").fingerprint == first
    heightmap.height_m[20, 20] += 1e-5
    save_dem(tmp_path / "other.npy", heightmap, made_by={})
    assert describe_dem(tmp_path / "other.npy").fingerprint != first


def truncated(path):
    path.write_bytes(path.read_bytes()[:-100])


def with_a_flipped_bit(path):
    content = bytearray(path.read_bytes())
    content[-900] ^= 1
    path.write_bytes(content)


def of_doubles(path):
    np.save(path, np.load(path).astype(np.float64))


def in_fortran_order(path):
    np.save(path, np.asfortranarray(np.load(path)))


def of_another_shape(path):
    np.save(path, np.load(path)[:-1])


def no_array(path):
    path.write_text("heights")


def gone(path):
    path.unlink()


def undescribed(path):
    path.with_suffix(".json").unlink()


def described_as_something_else(path):
    path.with_suffix(".json").write_text('{"format": "tronlab-campaign"}')


def with_a_checksum_missing(path):
    said = json.loads(path.with_suffix(".json").read_text())
    said["crc32"].pop()
    path.with_suffix(".json").write_text(json.dumps(said))


def described_in_no_json(path):
    path.with_suffix(".json").write_text("{")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (truncated, r"model\.npy: has \d+ bytes, 60 x 50 heights need \d+; the file is damaged"),
        (with_a_flipped_bit, r"rows 49 to 55 are not those that model\.json was made for"),
        (of_doubles, "is float64 of shape .*says float32"),
        (in_fortran_order, "in Fortran order"),
        (of_another_shape, r"shape \(59, 50\), its description says float32 of shape \(60, 50\)"),
        (no_array, "is not a NumPy file"),
        (gone, "no such file, though its description is there"),
        (undescribed, r"there is no model\.json beside it"),
        (described_as_something_else, "is not the description of a terrain model: format"),
        (with_a_checksum_missing, "bands of 7 rows need 9 checksums, there are 8"),
        (described_in_no_json, "is not the description of a terrain model"),
    ],
)
@pytest.mark.parametrize("open_file", [open_dem, read_dem])
def test_damage_and_mismatch_are_told(saved, damage, message, open_file):
    damage(saved)
    with pytest.raises(TerrainError, match=message):
        open_file(saved)


def test_of_a_large_model_a_part_is_checked(saved, monkeypatch):
    monkeypatch.setattr(dem, "_MOST_BANDS_CHECKED", 2)
    with_a_flipped_bit(saved)  # in the last band but one
    assert open_dem(saved).height_m.shape == (60, 50)
    with pytest.raises(TerrainError, match="rows 49 to 55"):
        read_dem(saved)


def test_a_name_that_is_no_numpy_file_is_refused(tmp_path, heightmap):
    with pytest.raises(TerrainError, match=r"model\.tif: .* written to a file NAME"):
        save_dem(tmp_path / "model.tif", heightmap, made_by={})
    with pytest.raises(TerrainError, match="none: cannot be written to: No such file"):
        save_dem(tmp_path / "none" / "model.npy", heightmap, made_by={})


def test_what_is_not_finished_leaves_nothing_behind(tmp_path):
    with HeightsFile(tmp_path / "model.npy", (9, 9)) as file:
        file.write(0, 0, np.zeros((4, 9), np.float32))
        assert len(list(tmp_path.iterdir())) == 1
    assert not list(tmp_path.iterdir())


def test_what_a_killed_process_left_is_removed_and_what_another_writes_is_not(tmp_path, heightmap):
    (tmp_path / "model.npy.1-1.part").write_text("abandoned")
    writing = os.open(tmp_path / "model.npy.2-2.part", os.O_CREAT | os.O_RDWR)
    fcntl.flock(writing, fcntl.LOCK_EX)
    save_dem(tmp_path / "model.npy", heightmap, made_by={})
    os.close(writing)
    assert sorted(path.name for path in tmp_path.glob("*.part")) == ["model.npy.2-2.part"]


def test_statistics_are_gathered_by_bands(heightmap, monkeypatch):
    heights = heightmap.height_m
    monkeypatch.setattr("tronlab.terrain.heightmap._BYTES_AT_ONCE", 1000)
    found = measure_heights(heights)
    assert (found.lowest_m, found.highest_m) == (heights.min(), heights.max())
    assert found.mean_m == pytest.approx(heights.mean(dtype=np.float64), rel=1e-12)
    heights[3, 4], heights[50, 6] = np.nan, np.inf
    with pytest.raises(TerrainError, match="2 samples are not finite"):
        measure_heights(heights)
