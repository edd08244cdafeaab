"""GeoTIFF against files that rasterio (GDAL) wrote."""

import builtins
import math
import warnings
from pathlib import Path

import numpy as np
import pytest

from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.raster import Raster, files_of_raster, read_raster, write_raster

rasterio = pytest.importorskip("rasterio", reason="rasterio (tronlab[geo]) is not installed")
warp = pytest.importorskip("rasterio.warp")

Affine = rasterio.Affine
NORTH_UP = Affine(2.0, 0.0, 1000.0, 0.0, -3.0, 500.0)
MOON = "+proj=stere +lat_0=-90 +R=1737400 +units=m +no_defs"
MOON_DEGREES = "+proj=longlat +R=1737400 +no_defs"
KEPLER = Path(__file__).parents[4] / "shared/data/lunar_dem/kepler_lola_804.tif"


def hills(dtype=np.float32, rows=30, columns=44):
    x, y = np.arange(rows)[:, None], np.arange(columns)
    return (100 * np.sin(x / 7) * np.cos(y / 11) + x).astype(dtype)


@pytest.fixture
def tiff(tmp_path):
    def write(heights, *, transform=NORTH_UP, crs=MOON, unit=None, scale=None, **profile):
        path = tmp_path / "map.tif"
        bands = heights if heights.ndim == 3 else heights[None]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with rasterio.open(
                path,
                "w",
                driver="GTiff",
                count=bands.shape[0],
                height=bands.shape[1],
                width=bands.shape[2],
                dtype=bands.dtype.name,
                transform=transform,
                crs=crs,
                **profile,
            ) as dataset:
                dataset.write(bands)
                if unit is not None:
                    dataset.units = (unit,)
                if scale is not None:
                    dataset.scales, dataset.offsets = ((value,) for value in scale)
        return path

    return write


def read(path, told=None, **settings):
    return read_raster(path, announce=[].append if told is None else told.append, **settings)


def test_a_map_in_metres(tiff):
    heights = hills()
    heights[4, 7] = -9999
    told = []
    path = tiff(heights, nodata=-9999)
    raster = read(path, told)
    assert raster.n_holes == 1
    heights[4, 7] = np.nan
    np.testing.assert_array_equal(raster.height_m, heights)
    assert raster.height_m.dtype == np.float32
    assert (raster.spacing_m, raster.corner_m) == ((3.0, 2.0), (1001.0, 498.5))
    with rasterio.open(path) as dataset:
        assert rasterio.CRS.from_wkt(raster.crs) == dataset.crs
    assert raster.has_unit
    assert told == []


@pytest.mark.parametrize(
    "transform", [NORTH_UP, NORTH_UP @ Affine.scale(1, -1), NORTH_UP @ Affine.scale(-1, 1)]
)
def test_north_is_up_and_west_is_left_whatever_the_file(tiff, transform):
    path = tiff(hills(), transform=transform)
    whole, part = read(path), read(path, window=(5, 7, 11, 13))
    with rasterio.open(path) as dataset:
        for i, j in [(0, 0), (3, 40), (29, 2)]:
            x, y = whole.corner_m[0] + 2.0 * j, whole.corner_m[1] - 3.0 * i
            assert next(dataset.sample([(x, y)]))[0] == whole.height_m[i, j]
    np.testing.assert_array_equal(part.height_m, whole.height_m[5:16, 7:20])
    assert part.corner_m == (whole.corner_m[0] + 14, whole.corner_m[1] - 15)
    write_raster(part, path)
    np.testing.assert_array_equal(read(path).height_m, part.height_m)


@pytest.mark.parametrize(
    ("unit", "scale", "metres", "has_unit"),
    [
        ("m", None, 1.0, True),
        ("km", None, 1000.0, True),
        ("US survey foot", None, 1200 / 3937, True),
        (None, (0.5, 0.0), 0.5, True),
        (None, None, 1.0, False),
    ],
)
def test_units_and_scales_become_metres(tiff, unit, scale, metres, has_unit):
    raster = read(tiff(hills(np.int16), unit=unit, scale=scale))
    np.testing.assert_allclose(raster.height_m, metres * hills(np.int16), rtol=1e-6)
    assert raster.has_unit is has_unit


def test_an_offset_keeps_its_digits(tiff):
    raster = read(tiff(hills(np.int16), scale=(0.5, 1737400.0)))
    np.testing.assert_array_equal(raster.height_m, 1737400.0 + 0.5 * hills(np.int16))


def test_a_map_in_feet_lies_in_metres(tiff):
    foot = 1200 / 3937
    raster = read(tiff(hills(), crs="EPSG:2263"))
    assert raster.spacing_m == pytest.approx((3 * foot, 2 * foot))
    copy = tiff(hills()).with_name("copy.tif")
    write_raster(raster, copy)
    with rasterio.open(copy) as dataset:
        assert dataset.transform.almost_equals(NORTH_UP)


def test_degrees_become_metres_at_the_middle_latitude(tiff):
    step_deg = 0.01
    transform = Affine(step_deg, 0, 10.0, 0, -step_deg, 60.0 + 15 * step_deg)
    told = []
    raster = read(tiff(hills(), transform=transform, crs=MOON_DEGREES), told)
    metres_a_degree = math.pi / 180 * 1737400
    expected = (step_deg * metres_a_degree, step_deg * metres_a_degree / 2)
    assert raster.spacing_m == pytest.approx(expected, rel=1e-9)
    assert "degrees made metres at latitude 60 deg" in told[0]
    # The map that is said to be its own gives the degrees back.
    longitude, latitude = warp.transform(
        rasterio.CRS.from_wkt(raster.crs),
        rasterio.CRS.from_proj4(MOON_DEGREES),
        [raster.corner_m[0] + 5 * raster.spacing_m[1]],
        [raster.corner_m[1] - 9 * raster.spacing_m[0]],
    )
    assert (longitude[0], latitude[0]) == pytest.approx((10.055, 60.055))


def test_degrees_of_the_earth_agree_with_its_ellipsoid(tiff):
    """One second of arc at 45 deg: 30.868 m of meridian, 21.895 m of parallel (WGS 84)."""
    transform = Affine(1 / 3600, 0, 7.0, 0, -1 / 3600, 45.0 + 15 / 3600)
    raster = read(tiff(hills(), transform=transform, crs="EPSG:4326"))
    assert raster.spacing_m == pytest.approx((30.868, 21.895), rel=2e-3)


def test_a_part_of_the_globe_in_degrees(tiff):
    """LOLA's global maps: 180 deg by 360 deg; whole they have no one scale, a part has."""
    transform = Affine(4, 0, 0, 0, -4, 90)
    path = tiff(hills(rows=45, columns=90), transform=transform, crs=MOON_DEGREES)
    with pytest.raises(TerrainError, match=r"-88\.00 to 88\.00 deg: no"):
        read(path)
    raster = read(path, window=(18, 20, 9, 12))
    metres_a_degree = math.pi / 180 * 1737400
    assert raster.spacing_m == pytest.approx((4 * metres_a_degree, 4 * metres_a_degree))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"transform": Affine.rotation(20) @ NORTH_UP}, "turned or sheared.*gdalwarp"),
        ({"transform": Affine(2, 0.1, 0, 0, -2, 0)}, "turned or sheared"),
        ({"unit": "fathom"}, "heights are in 'fathom' \\(allowed: m, "),
        (
            {"crs": MOON_DEGREES, "transform": Affine(1, 0, 0, 0, -1, 85)},
            "from latitude 55.50 to 84.50 deg: no one length of a degree",
        ),
        (
            {"crs": MOON_DEGREES, "transform": Affine(0.1, 0, 0, 0, -0.1, 90.05)},
            "no one length of a degree",
        ),
    ],
)
def test_maps_that_do_not_become_metres(tiff, settings, message):
    with pytest.raises(TerrainError, match=rf"map\.tif: .*{message}"):
        read(tiff(hills(), **settings))


@pytest.mark.parametrize(
    ("heights", "message"),
    [
        (np.zeros((3, 20, 20), np.float32), "has 3 bands, a height map has one"),
        (np.zeros((20, 20), np.uint8), "samples are uint8"),
        (np.zeros((20, 20), np.complex64), "samples are complex64"),
        (np.zeros((4, 20), np.float32), r"shape is \(4, 20\)"),
    ],
)
def test_tiffs_that_are_no_height_map(tiff, heights, message):
    with pytest.raises(TerrainError, match=message):
        read(tiff(heights))


def test_a_file_beside_that_says_the_unit_is_one_of_its_files(tiff):
    path = tiff(hills())
    assert files_of_raster(path) == (path,)
    beside = path.with_name("map.tif.aux.xml")
    band = '<PAMRasterBand band="1"><UnitType>km</UnitType></PAMRasterBand>'
    beside.write_text(f"<PAMDataset>{band}</PAMDataset>")
    assert files_of_raster(path) == (path, beside)
    np.testing.assert_allclose(read(path).height_m, 1000 * hills(), rtol=1e-6)


def test_a_tiff_without_a_place(tiff):
    told = []
    raster = read(tiff(hills(), transform=Affine.identity(), crs=None), told)
    assert (raster.spacing_m, raster.crs, raster.corner_m) == (None, None, None)
    assert "neither how far apart its samples are" in told[0]
    raster = read(tiff(hills(), crs=None), told)
    assert (raster.spacing_m, raster.crs) == ((3.0, 2.0), None)
    assert "map units are taken as metres" in told[1]


@pytest.mark.parametrize("damage", [lambda data: b"no tiff", lambda data: data[:1500]])
def test_a_damaged_tiff(tiff, damage):
    path = tiff(hills(rows=80))
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(TerrainError, match=r"map\.tif: cannot be read as a GeoTIFF"):
        read(path)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("has_unit", [True, False])
def test_what_is_written_comes_back(tmp_path, dtype, has_unit):
    heights = hills(dtype)
    heights[2, 3:6] = np.nan
    crs = rasterio.CRS.from_proj4(MOON).to_wkt()
    written = Raster(heights, (0.25, 0.5), has_unit, crs, (-3.5, 7.25))
    report = write_raster(written, tmp_path / "map.tif")
    raster = read(tmp_path / "map.tif")
    np.testing.assert_array_equal(raster.height_m, heights)
    assert raster.height_m.dtype == dtype
    assert (raster.spacing_m, raster.has_unit) == ((0.25, 0.5), has_unit)
    assert raster.corner_m == (-3.5, 7.25)
    assert rasterio.CRS.from_wkt(raster.crs) == rasterio.CRS.from_wkt(crs)
    assert str(report) == "map.tif: heights kept as they are"


def test_a_reference_system_that_is_none(tmp_path):
    with pytest.raises(TerrainError, match="the reference system cannot be written"):
        write_raster(Raster(hills(), (1.0, 1.0), crs="nonsense"), tmp_path / "map.tif")


def test_without_rasterio_the_extra_is_named(tiff, monkeypatch):
    path, real = tiff(hills()), builtins.__import__

    def without(name, *arguments, **settings):
        if name.startswith("rasterio"):
            raise ImportError(name)
        return real(name, *arguments, **settings)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(TerrainError, match=r"needs the package rasterio.*'tronlab\[geo\]'"):
        read(path)
    with pytest.raises(TerrainError, match="needs the package rasterio"):
        write_raster(Raster(hills()), path)


@pytest.mark.skipif(not KEPLER.exists(), reason=f"{KEPLER} is not there")
def test_kepler():
    told = []
    raster = read(KEPLER, told)
    assert raster.height_m.shape == (804, 804)
    assert (raster.height_m.min(), raster.height_m.max()) == (-6145, 278)
    assert raster.spacing_m == pytest.approx((47.68, 47.68), abs=0.002)
    assert not raster.has_unit
    assert told == []
