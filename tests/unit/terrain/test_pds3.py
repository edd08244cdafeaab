"""PDS3 images against numpy, and the label's map against GDAL's reader where that is installed."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.raster import files_of_raster, read_raster

LDEM_4 = Path(__file__).parents[4] / "shared/data/lunar_dem/LDEM_4.IMG"
needs_ldem = pytest.mark.skipif(not LDEM_4.exists(), reason=f"{LDEM_4} is not there")
needs_gdal = pytest.mark.skipif(
    importlib.util.find_spec("rasterio") is None, reason="rasterio (tronlab[geo]) is not installed"
)
pytest.importorskip("pvl", reason="pvl (tronlab[geo]) is not installed")

IMAGE = {"LINES": 12, "LINE_SAMPLES": 17, "SAMPLE_TYPE": "LSB_INTEGER", "SAMPLE_BITS": 16}
MAP = """
OBJECT = IMAGE_MAP_PROJECTION
  MAP_PROJECTION_TYPE = "{projection}"
  A_AXIS_RADIUS = 1737.4 <KM>
  B_AXIS_RADIUS = 1737.4 <KM>
  C_AXIS_RADIUS = 1737.4 <KM>
  POSITIVE_LONGITUDE_DIRECTION = "EAST"
  CENTER_LATITUDE = {latitude} <DEG>
  CENTER_LONGITUDE = 20.0 <DEG>
  MAP_PROJECTION_ROTATION = 0.0
  MAP_SCALE = {scale}
  LINE_PROJECTION_OFFSET = 7.5 <PIXEL>
  SAMPLE_PROJECTION_OFFSET = -3.5 <PIXEL>
END_OBJECT = IMAGE_MAP_PROJECTION
"""


def label(pointer='"MAP.IMG"', map_text="", top="RECORD_BYTES = 34", **image):
    keywords = "\n".join(f"  {key} = {value}" for key, value in {**IMAGE, **image}.items() if value)
    return (
        f"PDS_VERSION_ID = PDS3\n{top}\n^IMAGE = {pointer}\nTARGET_NAME = MOON\n"
        f"/* a comment */\nOBJECT = IMAGE\n{keywords}\nEND_OBJECT = IMAGE\n{map_text}\nEND\n"
    )


def numbers(dtype="<i2"):
    return (np.arange(12 * 17).reshape(12, 17) * 7 - 500).astype(dtype)


@pytest.fixture
def pds(tmp_path):
    def write(text, data=None):
        (tmp_path / "map.lbl").write_text(text, newline="\r\n")
        (tmp_path / "map.img").write_bytes(numbers().tobytes() if data is None else data)
        return tmp_path / "map.lbl"

    return write


def read(path, told=None, **settings):
    return read_raster(path, announce=[].append if told is None else told.append, **settings)


@pytest.mark.parametrize(
    ("name", "dtype"),
    [
        ("LSB_INTEGER", "<i2"),
        ("MSB_INTEGER", ">i2"),
        ("PC_INTEGER", "<i4"),
        ("SUN_INTEGER", ">i4"),
        ("LSB_UNSIGNED_INTEGER", "<u2"),
        ("UNSIGNED_INTEGER", ">u2"),
        ("PC_REAL", "<f4"),
        ('"IEEE REAL"', ">f4"),
        ("PC_REAL", "<f8"),
        ("IEEE_REAL", ">f8"),
    ],
)
def test_samples_of_every_type(pds, name, dtype):
    samples = np.abs(numbers(float)).astype(dtype) if "u" in dtype else numbers(dtype)
    bits = 8 * samples.dtype.itemsize
    path = pds(label(SAMPLE_TYPE=name, SAMPLE_BITS=bits), samples.tobytes())
    raster = read(path)
    np.testing.assert_array_equal(raster.height_m, samples)
    assert raster.has_unit is ("f" in dtype)
    part = read(path.with_suffix(".img"), window=(2, 5, 8, 9))
    np.testing.assert_array_equal(part.height_m, samples[2:10, 5:14])


def test_scale_offset_unit_and_missing_constants(pds):
    text = label(
        UNIT="KILOMETER",
        SCALING_FACTOR=0.001,
        OFFSET=1.5,
        MISSING_CONSTANT=-500,
        NULL_CONSTANT="(-493, -486)",
        INVALID_CONSTANT='"N/A"',
    )
    raster = read(pds(text))
    expected = 1500 + numbers().astype(float)
    expected[0, :3] = np.nan
    np.testing.assert_allclose(raster.height_m, expected)
    assert raster.has_unit


def test_bit_patterns_and_special_pixels_of_reals(pds):
    samples = numbers("<f4")
    samples[1, 1] = np.array(0xFF7FFFFB, np.uint32).view(np.float32)
    samples[2, 2] = -3.4e38
    samples[3, 3] = np.inf
    samples[4, 4] = -32768.0
    expected = samples.copy()
    expected[[1, 2, 3, 4], [1, 2, 3, 4]] = np.nan
    text = label(
        SAMPLE_TYPE="PC_REAL",
        SAMPLE_BITS=32,
        MISSING_CONSTANT="16#FF7FFFFB#",
        CORE_NULL=-32768.0,
        UNIT="METERS",
    )
    np.testing.assert_array_equal(read(pds(text, samples.tobytes())).height_m, expected)


def test_lines_with_a_prefix_and_a_suffix(pds):
    lines = np.full((12, 5 + 34 + 3), 0x77, np.uint8)
    lines[:, 5:39] = numbers().view(np.uint8)
    path = pds(label(LINE_PREFIX_BYTES=5, LINE_SUFFIX_BYTES=3), lines.tobytes())
    np.testing.assert_array_equal(read(path).height_m, numbers())


@pytest.mark.parametrize(
    ("pointer", "offset"),
    [
        ('"map.img"', 0),
        ('("MAP.IMG")', 0),
        ('("MAP.IMG", 3)', 68),
        ('("MAP.IMG", 11 <BYTES>)', 10),
    ],
)
def test_pointers_to_an_image_beside(pds, pointer, offset):
    path = pds(label(pointer), b"x" * offset + numbers().tobytes())
    np.testing.assert_array_equal(read(path).height_m, numbers())
    assert files_of_raster(path.with_suffix(".img")) == (path, path.with_suffix(".img"))


@pytest.mark.parametrize(("pointer", "offset"), [("41", 1360), ("1501 <BYTES>", 1500)])
def test_an_attached_label(tmp_path, pointer, offset):
    path = tmp_path / "map.IMG"
    path.write_bytes(label(pointer).encode().ljust(offset) + numbers().tobytes())
    np.testing.assert_array_equal(read(path).height_m, numbers())
    assert files_of_raster(path) == (path,)


@pytest.mark.parametrize(
    ("scale", "spacing_m"),
    [("0.25 <KM/PIXEL>", 250.0), ("20 <m/pix>", 20.0), ("0.1", 100.0), ("5 <METERS/PIXEL>", 5.0)],
)
def test_map_scale(pds, scale, spacing_m):
    map_text = MAP.format(projection="SIMPLE CYLINDRICAL", latitude=0, scale=scale)
    raster = read(pds(label(map_text=map_text)))
    assert raster.spacing_m == (spacing_m, spacing_m)
    assert raster.corner_m == (3.5 * spacing_m, 7.5 * spacing_m)


@needs_gdal
@pytest.mark.parametrize(
    ("projection", "latitude"), [("SIMPLE CYLINDRICAL", 0), ("POLAR STEREOGRAPHIC", -90)]
)
def test_gdal_finds_the_same_place(pds, projection, latitude):
    import rasterio
    from rasterio import warp

    map_text = MAP.format(projection=projection, latitude=latitude, scale="0.25 <KM/PIXEL>")
    path = pds(label(map_text=map_text))
    raster = read(path, window=(2, 3, 9, 9))
    with rasterio.open(path) as dataset:
        np.testing.assert_array_equal(raster.height_m, dataset.read(1)[2:11, 3:12])
        assert dataset.xy(2, 3) == pytest.approx(raster.corner_m)
        ours = rasterio.CRS.from_wkt(raster.crs)
        x, y = warp.transform(dataset.crs, ours, [1000.0], [-5e5])
        assert (x[0], y[0]) == pytest.approx((1000.0, -5e5))


@pytest.mark.parametrize(
    "change",
    [
        ("SIMPLE CYLINDRICAL", "SINUSOIDAL"),
        ('"EAST"', '"WEST"'),
        ("ROTATION = 0.0", "ROTATION = 20.0"),
        ("C_AXIS_RADIUS = 1737.4", "C_AXIS_RADIUS = 1700"),
    ],
)
def test_a_map_that_is_not_carried_over_is_told(pds, change):
    text = MAP.format(projection="SIMPLE CYLINDRICAL", latitude=0, scale="0.25")
    told = []
    raster = read(pds(label(map_text=text.replace(*change))), told)
    assert (raster.spacing_m, raster.crs, raster.corner_m) == ((250.0, 250.0), None, None)
    assert "is not carried over" in told[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (label(SAMPLE_TYPE="VAX_REAL"), "gives SAMPLE_TYPE as VAX_REAL \\(allowed: MSB_INTEGER, "),
        (label(SAMPLE_TYPE=None), "gives SAMPLE_TYPE as nothing"),
        (label(SAMPLE_BITS=8), "gives SAMPLE_BITS as 8; LSB_INTEGER heights have 16 or 32"),
        (label(LINES=None), "LINES is missing"),
        (label(LINES='"many"'), "LINES is 'many', must be a number"),
        (label(LINES=12.5), "LINES is 12.5, must be a whole number"),
        (label(LINE_PREFIX_BYTES=-4), "LINE_PREFIX_BYTES is -4, must be a whole number, 0 or more"),
        (label(LINES=13), "has 408 bytes, its label promises 442; the file is cut off"),
        (label(LINES=4), r"shape is \(4, 17\)"),
        (label(BANDS=3), "has an image of 3 BANDS"),
        (label(ENCODING_TYPE="HUFFMAN"), "ENCODING_TYPE HUFFMAN"),
        (label(UNIT="DEGREE"), "gives UNIT as DEGREE; heights are in metres or kilometres"),
        (label('"OTHER.IMG"'), r"OTHER\.IMG: does not exist; the PDS3 label map\.lbl names it"),
        (label('("MAP.IMG", 0)'), "points to \\^IMAGE 0; counting begins at 1"),
        (label('("MAP.IMG", 3)', top=""), "RECORD_BYTES is missing"),
        (
            label(map_text=MAP.format(projection="X", latitude=0, scale="3 <DEG>")),
            "MAP_SCALE in DEG",
        ),
        (label(map_text=MAP.format(projection="X", latitude=0, scale="0")), "must be positive"),
        (label('("MAP.TIF")'), r"points to map\.tif, which is no raw image"),
        ("PDS_VERSION_ID = PDS3\nEND\n", "describes no IMAGE"),
        ("PDS_VERSION_ID = PDS3\nA = 1 /* \nEND\n", "is damaged|ends inside"),
        ("PDS_VERSION_ID = PDS3\nOBJECT\nEND\n", "is damaged"),
        (label().replace("END_OBJECT = IMAGE\n", ""), "describes no IMAGE"),
        (label().removesuffix("END\n"), "does not begin with a PDS3 label"),
        ("hello", "does not begin with a PDS3 label"),
    ],
)
def test_labels_of_no_height_map(pds, text, message):
    path = pds(text)
    path.with_suffix(".tif").touch()
    with pytest.raises(TerrainError, match=message):
        read(path)


def test_an_image_without_any_label(tmp_path):
    (tmp_path / "map.img").write_bytes(numbers().tobytes())
    with pytest.raises(TerrainError, match=r"there is no map\.lbl beside it"):
        read(tmp_path / "map.img")


@needs_ldem
def test_lola():
    """LDEM_4: heights of -8878.5 to 10504 m on a sphere of 1737.4 km, 4 samples a degree."""
    told = []
    raster = read(LDEM_4, told)
    height_m = raster.height_m - 1737400.0
    assert raster.height_m.shape == (720, 1440)
    assert (height_m.min(), height_m.max()) == (-8878.5, 10504.0)
    assert raster.spacing_m == (7580.84, 7580.84)
    assert raster.corner_m == pytest.approx((-719.5 * 7580.84, 359.5 * 7580.84))
    assert "OFFSET is the radius of the body" in told[0]


@needs_ldem
@needs_gdal
def test_lola_as_gdal_reads_it():
    import rasterio

    raster = read(LDEM_4)
    with rasterio.open(LDEM_4.with_suffix(".LBL")) as dataset:
        expected = dataset.read(1) * dataset.scales[0] + dataset.offsets[0]
        assert dataset.xy(0, 0) == pytest.approx(raster.corner_m)
        assert dataset.crs == rasterio.CRS.from_wkt(raster.crs)
    np.testing.assert_array_equal(raster.height_m, expected)
