from pathlib import Path

import numpy as np
import pytest

from tronlab.terrain.config import FileTerrain
from tronlab.terrain.file import read_terrain
from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.raster import Raster, write_raster

SETTINGS = {"size_m": (0.2, 0.3), "spacing_m": 0.002, "relief_m": 0.05}


def bump(rows, columns):
    """Give a smooth surface with the proportions of its array, so shapes stay recognisable."""
    x = np.arange(rows)[:, None] - rows / 2
    y = np.arange(columns) - columns / 2
    return np.exp(-(x**2 + y**2) / 900.0) + 0.3 * np.exp(-((x - 20) ** 2 + (y - 25) ** 2) / 200.0)


def read(path, announced=None, **settings):
    config = FileTerrain(path=path, **{**SETTINGS, **settings})
    announce = announced.append if announced is not None else lambda _: None
    return read_terrain(config, path, announce=announce)


@pytest.fixture
def npy(tmp_path) -> Path:
    path = tmp_path / "map.npy"
    np.save(path, bump(101, 151).astype(np.float32))
    return path


def test_a_map_with_the_models_grid_is_only_scaled(npy):
    announced = []
    samples = np.load(npy).astype(np.float64)
    expected = 0.05 * (samples - samples.min()) / np.ptp(samples)
    np.testing.assert_allclose(read(npy, announced), expected, atol=1e-7)
    assert announced == []


def test_a_coarser_map_is_interpolated_smoothly(tmp_path):
    path = tmp_path / "coarse.npy"
    fine = bump(101, 151)
    np.save(path, fine[::2, ::2])
    height = read(path)
    expected = 0.05 * (fine - fine[::2, ::2].min()) / np.ptp(fine[::2, ::2])
    np.testing.assert_allclose(height, expected, atol=0.05 * 2e-3)
    assert height.min() == 0
    assert height.max() == np.float32(0.05)


def test_a_finer_map_does_not_alias(tmp_path):
    path = tmp_path / "fine.npy"
    stripes = np.tile([0.0, 1.0], (401, 301))[:, :601]
    slope = np.linspace(0, 100, 601)
    np.save(path, stripes + slope)
    height = read(path)
    np.testing.assert_allclose(height[50], np.linspace(0, 0.05, 151), atol=0.05 * 0.005)


def test_the_middle_is_used_and_it_is_said(tmp_path):
    path = tmp_path / "square.npy"
    square = bump(151, 151)
    np.save(path, square)
    announced = []
    height = read(path, announced)
    middle = square[25:126]
    expected = 0.05 * (middle - middle.min()) / np.ptp(middle)
    np.testing.assert_allclose(height, expected, atol=1e-7)
    assert announced == [
        "square.npy: 151 x 151 samples do not have the shape of 0.2 x 0.3 m:"
        " using the middle, 101 x 151 from row 25, column 0"
    ]


def test_a_wide_map_is_cut_left_and_right(tmp_path):
    path = tmp_path / "wide.npy"
    wide = bump(101, 301)
    np.save(path, wide)
    middle = wide[:, 75:226]
    expected = 0.05 * (middle - middle.min()) / np.ptp(middle)
    np.testing.assert_allclose(read(path), expected, atol=1e-7)


def test_a_crop_is_taken_first(tmp_path):
    path = tmp_path / "clipped.npy"
    samples = bump(130, 170)
    samples[:10] = 99.0
    np.save(path, samples)
    part = samples[20:121, 10:161]
    expected = 0.05 * (part - part.min()) / np.ptp(part)
    np.testing.assert_allclose(read(path, crop_px=(20, 10, 101, 151)), expected, atol=1e-7)


def test_roughness_is_added_below_the_files_resolution_only(npy):
    plain, rough = read(npy), read(npy, roughness_slope=0.05)
    again = read(npy, roughness_slope=0.05)
    np.testing.assert_array_equal(rough, again)
    assert np.diff(rough, 2).std() > 1.3 * np.diff(plain, 2).std()
    assert np.corrcoef(plain.ravel(), rough.ravel())[0, 1] > 0.99
    assert rough.max() == np.float32(0.05)


@pytest.mark.opencv
def test_png_of_16_bit(tmp_path):
    import cv2

    path = tmp_path / "map.png"
    levels = np.round(bump(101, 151) * 40000).astype(np.uint16)
    cv2.imwrite(str(path), levels)
    expected = 0.05 * (levels - levels.min().astype(float)) / np.ptp(levels)
    np.testing.assert_allclose(read(path), expected, atol=1e-7)


@pytest.mark.opencv
@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((20, 30), np.uint8), "has 8 bit a sample, a height map needs 16"),
        (np.zeros((20, 30, 3), np.uint16), "has 3 colour channels, a height map has one"),
        (np.zeros((20, 30, 4), np.uint8), "has 4 colour channels, a height map has one"),
        (np.zeros((4, 30), np.uint16), r"shape is \(4, 30\)"),
    ],
)
def test_png_of_another_form(tmp_path, image, message):
    import cv2

    path = tmp_path / "bad.png"
    cv2.imwrite(str(path), image)
    with pytest.raises(TerrainError, match=message):
        read(path)


@pytest.mark.opencv
def test_a_png_that_is_none(tmp_path):
    import cv2

    path = tmp_path / "broken.png"
    path.write_bytes(cv2.imencode(".tif", np.zeros((20, 20), np.uint16))[1].tobytes())
    with pytest.raises(TerrainError, match=r"broken\.png: cannot be read as a PNG image"):
        read(path)


def test_holes_are_counted_and_located(npy):
    samples = np.load(npy)
    samples[7, 9] = np.nan
    samples[50, 3:6] = np.inf
    np.save(npy, samples)
    with pytest.raises(
        TerrainError, match="4 of 15251 samples are not finite, the first one at row 7, column 9"
    ):
        read(npy)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((20, 30), np.uint8), r"samples are uint8 \(allowed: float32"),
        (np.zeros((20, 30), complex), "samples are complex128"),
        (np.zeros((20, 30, 2), np.float32), r"shape is \(20, 30, 2\)"),
        (np.zeros((3, 30), np.float32), r"shape is \(3, 30\)"),
        (np.full((101, 151), 4.0), "all heights are 4.0"),
    ],
)
def test_npy_of_another_form(tmp_path, array, message):
    path = tmp_path / "bad.npy"
    np.save(path, array)
    with pytest.raises(TerrainError, match=message):
        read(path)


def test_a_truncated_npy(npy):
    npy.write_bytes(npy.read_bytes()[:5000])
    with pytest.raises(TerrainError, match=r"map\.npy: cannot be read as a NumPy array"):
        read(npy)


def test_an_object_array_is_not_unpickled(tmp_path):
    path = tmp_path / "object.npy"
    np.save(path, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(TerrainError, match="cannot be read as a NumPy array"):
        read(path)


def test_another_format_names_the_allowed_ones(tmp_path):
    path = tmp_path / "map.obj"
    path.write_bytes(b"")
    with pytest.raises(TerrainError, match=r"allowed: \.npy, \.png of 16 bit, \.tif"):
        read(path)


def test_a_crop_outside_names_the_files_size(npy):
    with pytest.raises(TerrainError, match=r"reaches to row 121 and column 151.*101 x 151"):
        read(npy, crop_px=(20, 0, 101, 151))


def test_a_map_too_narrow_for_the_shape(tmp_path):
    path = tmp_path / "strip.npy"
    np.save(path, bump(60, 60))
    with pytest.raises(TerrainError, match="leave 3 x 60, needed are at least 8 x 8"):
        read(path, size_m=(0.06, 2.0))


def test_holes_up_to_a_width_are_filled(npy):
    samples = np.load(npy)
    whole = read(npy)
    samples[20, 30:60] = np.nan
    samples[70:74, 100:104] = np.nan
    np.save(npy, samples)
    announced = []
    filled = read(npy, announced, holes_px=4)
    np.testing.assert_allclose(filled, whole, atol=0.05 * 0.01)
    assert announced == ["map.npy: 46 samples without a height filled from their surroundings"]
    with pytest.raises(TerrainError, match=r"map\.npy: the hole of rows 70 to 73, columns 100 to"):
        read(npy, holes_px=3)


def test_what_resampling_lost_is_told_in_metres_of_the_model(tmp_path):
    path = tmp_path / "fine.npy"
    stripes = np.sin(2 * np.pi * np.arange(601) / 6)  # 6 samples: 3 mm, the grid has 2 mm
    np.save(path, 1000 * np.tile(stripes, (401, 1)) + np.linspace(0, 9000, 401)[:, None])
    announced = []
    read(path, announced)
    rms_mm = 1000 * np.sqrt(0.5) / 11000 * 50
    assert float(announced[0].split()[5]) == pytest.approx(rms_mm, rel=0.1)
    assert announced[0].startswith("fine.npy: resampling changed heights by")
    assert announced[0].endswith("the shortest waves left are 4 mm long")


def test_radii_of_a_planet_keep_the_digits_of_the_heights(tmp_path):
    path = tmp_path / "radii.npy"
    np.save(path, bump(101, 151))
    near = read(path)
    np.save(path, 1737400.0 + bump(101, 151))
    np.testing.assert_allclose(read(path), near, atol=1e-8)


def test_samples_further_apart_along_rows_keep_their_shape(tmp_path):
    pytest.importorskip("rasterio", reason="rasterio (tronlab[geo]) is not installed")
    path = tmp_path / "tall.tif"
    fine = bump(101, 151)
    write_raster(Raster(fine[::2], spacing_m=(40.0, 20.0)), path)
    announced = []
    expected = 0.05 * (fine - fine[::2].min()) / np.ptp(fine[::2])
    np.testing.assert_allclose(read(path, announced), expected, atol=0.05 * 1e-3)
    assert not any("using the middle" in line for line in announced)
