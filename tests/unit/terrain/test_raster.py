import errno
import json
import mmap
import struct
import zlib

import numpy as np
import pytest

from tronlab.terrain.dem import save_dem
from tronlab.terrain.heightmap import HeightMap, TerrainError
from tronlab.terrain.raster import Raster, read_raster, write_raster


def hills(rows=40, columns=56, dtype=np.float64):
    x, y = np.arange(rows)[:, None], np.arange(columns)
    return (0.3 * np.sin(x / 7) * np.cos(y / 11) + 0.01 * x).astype(dtype)


def read(path, **settings):
    return read_raster(path, announce=lambda _: None, **settings)


def png_with(tmp_path, text):
    path = tmp_path / "map.png"
    write_raster(Raster(hills()), path)
    data = path.read_bytes()
    chunk = b"tEXt" + b"tronlab-heights\0" + text
    end = 33 + 12 + struct.unpack(">I", data[33:37])[0]
    own = struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
    path.write_bytes(data[:33] + own + data[end:])
    return path


def test_npy_is_mapped_not_read(tmp_path):
    path = tmp_path / "map.npy"
    np.save(path, hills())
    raster = read(path)
    owner = raster.height_m
    while isinstance(owner, np.ndarray):
        owner = owner.base
    assert isinstance(owner, mmap.mmap)
    assert (raster.has_unit, raster.spacing_m, raster.n_holes) == (True, None, 0)


@pytest.mark.parametrize("dtype", [np.int16, np.uint16])
def test_npy_of_whole_numbers_has_no_unit(tmp_path, dtype):
    path = tmp_path / "map.npy"
    numbers = np.linspace(0, np.iinfo(dtype).max, 2000).reshape(40, 50).astype(dtype)
    np.save(path, numbers)
    raster = read(path)
    np.testing.assert_array_equal(raster.height_m, numbers)
    assert not raster.has_unit


def test_a_terrain_model_of_our_own_gives_its_spacing(tmp_path):
    path = tmp_path / "model.npy"
    heights = hills(dtype=np.float32)
    save_dem(path, HeightMap(heights, 0.002, np.zeros(3)), made_by={"by": "hand"})
    raster = read(path)
    np.testing.assert_array_equal(raster.height_m, heights)
    assert raster.spacing_m == (0.002, 0.002)
    path.write_bytes(path.read_bytes()[:-4] + b"\0\0\0\1")
    with pytest.raises(TerrainError, match="damaged"):
        read(path)


def test_somebody_elses_json_says_nothing(tmp_path):
    np.save(tmp_path / "map.npy", hills())
    (tmp_path / "map.json").write_text(json.dumps({"spacing_m": 3.0}))
    assert read(tmp_path / "map.npy").spacing_m is None


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_png_says_by_itself_what_its_levels_mean(tmp_path, dtype):
    path = tmp_path / "map.png"
    heights = hills(dtype=dtype)
    heights[3, 4:9] = np.nan
    written = Raster(heights, (0.5, 0.25), True, 'LOCAL_CS["Höhe"]', (12.5, -7.25))
    report = write_raster(written, path)
    raster = read(path)
    assert (raster.spacing_m, raster.has_unit) == ((0.5, 0.25), True)
    assert (raster.crs, raster.corner_m) == ('LOCAL_CS["Höhe"]', (12.5, -7.25))
    np.testing.assert_array_equal(np.isnan(raster.height_m), np.isnan(heights))
    assert raster.n_holes == 5
    error = np.nanmax(np.abs(raster.height_m - heights.astype(np.float64)))
    assert 0.4 * report.height_step_m < error <= 1.001 * report.largest_error_m
    assert report.height_step_m == pytest.approx(np.nanmax(heights) / 65534, rel=0.7)
    assert f"in steps of {report.height_step_m:.4g} m" in str(report)
    part = read(path, window=(2, 3, 10, 8))
    np.testing.assert_array_equal(part.height_m, raster.height_m[2:12, 3:11])
    assert part.corner_m == (12.5 + 3 * 0.25, -7.25 - 2 * 0.5)


@pytest.mark.parametrize(
    ("lowest", "has_holes"), [(0, False), (-6000, False), (0, True), (7, True)]
)
def test_a_png_keeps_whole_numbers_exactly(tmp_path, lowest, has_holes):
    path = tmp_path / "map.png"
    numbers = (lowest + np.arange(2000).reshape(40, 50) ** 1.3 // 1).astype(np.float32)
    if has_holes:
        numbers[0, 1] = np.nan
    report = write_raster(Raster(numbers, has_unit=False), path)
    raster = read(path)
    np.testing.assert_array_equal(raster.height_m, numbers)
    assert not raster.has_unit
    assert (report.largest_error_m, report.height_step_m) == (0.0, 1.0)


def test_a_flat_map_is_no_division_by_zero(tmp_path):
    write_raster(Raster(np.full((9, 9), 0.3)), tmp_path / "flat.png")
    np.testing.assert_allclose(read(tmp_path / "flat.png").height_m, 0.3)


@pytest.mark.opencv
def test_somebody_elses_png_has_no_unit(tmp_path):
    import cv2

    levels = np.arange(63 * 65, dtype=np.uint16).reshape(63, 65) * 16
    cv2.imwrite(str(tmp_path / "map.png"), levels)
    raster = read(tmp_path / "map.png")
    np.testing.assert_array_equal(raster.height_m, levels)
    assert (raster.has_unit, raster.spacing_m) == (False, None)
    write_raster(raster, tmp_path / "copy.png")
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "copy.png"), -1), levels)


@pytest.mark.parametrize(
    ("text", "message"),
    [(b"{", "Invalid JSON"), (b'{"height_step": 0}', "height_step: "), (b'{"a": 1}', "a: ")],
)
def test_a_png_with_a_damaged_text(tmp_path, text, message):
    with pytest.raises(TerrainError, match=rf"map\.png: the text chunk.* is damaged: .*{message}"):
        read(png_with(tmp_path, text))


def test_npy_says_what_it_does_not_keep(tmp_path):
    report = write_raster(Raster(hills(), (1.0, 1.0), crs="C", corner_m=(0, 0)), tmp_path / "m.npy")
    assert str(report) == (
        "m.npy: heights kept as they are; not kept in this format: spacing, coordinate reference"
        " system, place on the map"
    )
    np.testing.assert_array_equal(np.load(tmp_path / "m.npy"), hills())


@pytest.mark.parametrize(
    ("window", "message"),
    [
        ((35, 0, 6, 20), "reaches to row 41 and column 20, the file has 40 x 56"),
        ((0, 50, 6, 7), "reaches to row 6 and column 57"),
        ((-1, 0, 6, 7), "must start at 0 or more"),
        ((0, 0, 0, 7), "at least one row and column"),
    ],
)
@pytest.mark.parametrize("suffix", [".npy", ".png"])
def test_a_part_outside_the_file(tmp_path, suffix, window, message):
    path = tmp_path / f"map{suffix}"
    write_raster(Raster(hills()), path)
    with pytest.raises(TerrainError, match=message):
        read(path, window=window)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("missing.npy", "does not exist or is not a file"),
        (".", "does not exist or is not a file"),
        ("notes.txt", r"cannot be read \(allowed: \.npy, .*\.lbl\)"),
    ],
)
def test_files_that_are_no_height_map(tmp_path, name, message):
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(TerrainError, match=message):
        read(tmp_path / name)


def test_an_archive_is_no_array(tmp_path):
    np.savez(tmp_path / "map.npz", a=hills())
    (tmp_path / "map.npz").rename(tmp_path / "map.npy")
    with pytest.raises(TerrainError, match="is an archive of arrays"):
        read(tmp_path / "map.npy")


def test_a_file_stays_as_it_was_when_writing_fails(tmp_path, monkeypatch):
    path = tmp_path / "map.npy"
    write_raster(Raster(hills()), path)

    def full(file, heights):
        file.write(b"some")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "save", full)
    with pytest.raises(TerrainError, match=r"map\.npy: cannot be written: No space left on device"):
        write_raster(Raster(2 * hills()), path)
    np.testing.assert_array_equal(np.load(path), hills())
    assert list(tmp_path.iterdir()) == [path]


def test_files_that_cannot_be_written(tmp_path):
    with pytest.raises(TerrainError, match=r"cannot be written \(allowed: \.npy, .*\.tiff\)"):
        write_raster(Raster(hills()), tmp_path / "map.img")
    with pytest.raises(TerrainError, match=r"map\.npy: cannot be written: No such file"):
        write_raster(Raster(hills()), tmp_path / "nowhere" / "map.npy")
    with pytest.raises(TerrainError, match=r"/map\.png: all samples are holes"):
        write_raster(Raster(np.full((9, 9), np.nan)), tmp_path / "map.png")
    (tmp_path / "map.npy").mkdir()
    with pytest.raises(TerrainError, match=r"map\.npy: cannot be written: Is a directory"):
        write_raster(Raster(hills()), tmp_path / "map.npy")
    assert [file.name for file in tmp_path.iterdir()] == ["map.npy"]
