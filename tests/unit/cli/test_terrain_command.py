"""``tronlab terrain`` as a person meets it, on small terrains."""

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tronlab.cli.app import main
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.conversion import Conversion, convert, heightmap_of
from tronlab.terrain.dem import describe_dem, open_dem
from tronlab.terrain.formats.model import Raster
from tronlab.terrain.formats.png import write_png
from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.procedural import make_terrain

RIGS = Path(__file__).parents[3] / "campaigns/rigs"
SMALL = ("--size-m", 0.12, 0.2, "--spacing-m", 0.002, "--relief-m", 0.03, "--seed", 4)
Tronlab = Callable[..., tuple[int, str, str]]


@pytest.fixture
def tronlab(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Tronlab:
    """``tronlab(*arguments)`` gives exit code, stdout and stderr of the command line."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["tronlab", "terrain", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        return int(ended.value.code or 0), captured.out, captured.err

    return run


@pytest.fixture
def small(tronlab: Tronlab) -> Path:
    """A terrain of 61 x 101 samples in the working folder."""
    code, _, told = tronlab("make", *SMALL, "--out", "small.npy")
    assert code == 0, told
    return Path("small.npy")


def facts(tronlab: Tronlab, path: Path) -> dict[str, Any]:
    code, printed, told = tronlab("info", path, "--json")
    assert code == 0, told
    return json.loads(printed)


def test_make_writes_what_a_rig_with_these_settings_has(small: Path, tronlab: Tronlab):
    config = ProceduralTerrain(size_m=(0.12, 0.2), spacing_m=0.002, relief_m=0.03, seed=4)
    heightmap = open_dem(small)
    np.testing.assert_array_equal(heightmap.height_m, make_terrain(config))
    assert heightmap.spacing_m == pytest.approx(0.002)
    np.testing.assert_allclose(heightmap.origin_trs_m, config.origin_trs_m)
    assert describe_dem(small).made_by["seed"] == 4
    code, printed, _ = tronlab("info", small)
    assert code == 0
    assert re.search(r"^samples +61 x 101, every 2 mm$", printed, re.MULTILINE)
    assert "relief 30.0 mm" in printed
    assert re.search(r"^craters +\d+ of 6 mm to 800 mm on the model", printed, re.MULTILINE)


def test_make_takes_a_files_settings_and_options_on_top(tronlab: Tronlab):
    Path("mine.yaml").write_text(
        "terrain: {kind: procedural, seed: 9, size_m: [0.1, 0.1], spacing_m: 0.002,"
        " albedo_map: paint.png}\n"
    )
    code, printed, told = tronlab("make", "mine.yaml", "--relief-m", 0.02, "--out", "mine.npy")
    assert code == 0, told
    assert "relief 20.0 mm" in printed
    assert "from seed 9" in printed
    assert "only heights are used: the albedo map paint.png belongs to the rig" in told
    made_by = describe_dem(Path("mine.npy")).made_by
    assert (made_by["seed"], made_by["relief_m"]) == (9, 0.02)


def test_info_of_a_rig_counts_in_si_units(tronlab: Tronlab):
    Path("rig.yaml").write_text(
        f"extends: {RIGS}/twin.yaml\n"
        "terrain: {kind: procedural, seed: 2, size_m: [0.3, 0.4], spacing_m: 0.002}\n"
    )
    found = facts(tronlab, Path("rig.yaml"))
    assert found["name"] == "rig twin"
    assert found["shape"] == [151, 201]
    assert found["size_m"] == pytest.approx([0.3, 0.4])
    assert found["highest"] - found["lowest"] == pytest.approx(0.26)
    slope_rad = found["facet_slope_rad"]
    assert 0 < slope_rad["p50"] < slope_rad["rms"] < slope_rad["p99"] < np.pi / 2
    craters = found["craters"]
    n_expected = 0.15 * (0.006**-2 - 0.8**-2) * 0.3 * 0.4
    assert craters["n_expected"] == pytest.approx(n_expected)
    assert abs(craters["n_drawn"] - n_expected) < 4 * np.sqrt(n_expected)


def test_a_picture_is_drawn_of_a_file_and_of_a_rigs_terrain(small: Path, tronlab: Tronlab):
    Path("model.yaml").write_text("terrain: {kind: dem, path: small.npy}\n")
    code, printed, told = tronlab("view", "model.yaml", "--out", "view.jpg", "--lamp", 0, -1, 0.5)
    assert code == 0, told
    assert printed == "terrain: view.jpg\n"
    assert Path("view.jpg").read_bytes().startswith(b"\xff\xd8")
    code, _, told = tronlab("view", small, "--out", "view.jpg")
    assert (code, told) == (2, "error: view.jpg: exists already; --force replaces it\n")


def test_a_picture_of_numbers_without_a_unit_says_what_to_do(tronlab: Tronlab):
    np.save("raw.npy", np.arange(400, dtype=np.uint16).reshape(20, 20))
    code, _, told = tronlab("view", "raw.npy")
    assert code == 2
    assert "does not say its unit of height" in told
    assert "tronlab terrain convert raw.npy NAME.npy --size-m X Y --relief-m Z" in told
    assert facts(tronlab, Path("raw.npy"))["facet_slope_rad"] is None
    levels = np.arange(400, dtype=np.float32).reshape(20, 20)
    write_png(Raster(levels, spacing_m=(2.0, 2.0), has_unit=False), Path("raw.png"))
    assert "give it with --height-unit-m, or make a model" in tronlab("view", "raw.png")[2]


def test_there_and_back_through_16_bit_png_loses_at_most_half_a_step(small: Path, tronlab: Tronlab):
    code, printed, told = tronlab("convert", small, "there.png")
    assert code == 0, told
    assert "not kept in this format: the origin -0.02 -0.02 -0.13 m in trs" in printed
    code, printed, told = tronlab("convert", "there.png", "back.npy")
    assert code == 0, told
    assert "61 x 101 samples every 2 mm" in printed
    before, back = open_dem(small), open_dem(Path("back.npy"))
    heights = back.height_m + (back.origin_trs_m[2] - 0)
    np.testing.assert_allclose(heights, before.height_m, atol=0.5001 * 0.03 / 65534 + 1e-8)


def test_a_map_laid_on_a_size_keeps_its_proportions_unless_told_otherwise(
    small: Path, tronlab: Tronlab
):
    before = open_dem(small)
    code, _, told = tronlab("convert", small, "half.npy", "--size-m", 0.06, 0.1)
    assert code == 0, told
    assert "heights are scaled as the lengths are, by 0.5" in told
    half = open_dem(Path("half.npy"))
    assert half.spacing_m == pytest.approx(0.001)
    np.testing.assert_allclose(half.height_m, before.height_m / 2, atol=1e-8)
    code, printed, told = tronlab(
        "convert", small, "flat.npy", "--size-m", 0.1, 0.1, "--relief-m", 0.01, "--spacing-m", 0.005
    )
    assert code == 0, told
    assert "using the middle, 61 x 61 from row 0, column 20" in told
    assert "resampling changed heights by" in told
    assert "21 x 21 samples every 5 mm" in printed
    assert open_dem(Path("flat.npy")).relief_m == pytest.approx(0.01)


def test_a_map_with_two_spacings_keeps_its_shape_and_needs_one_to_be_a_model():
    heights = np.fromfunction(lambda i, j: 0.1 * i + 0.1 * j, (21, 31))
    raster = Raster(heights, spacing_m=(2.0, 1.0))
    laid, _ = convert(raster, Conversion(size_m=(0.4, 0.3)), announce=print)
    assert laid.spacing_m == pytest.approx((0.02, 0.01))
    np.testing.assert_allclose(laid.height_m, heights / 100)
    with pytest.raises(TerrainError, match=r"0.02 m apart along X and 0.01 m along Y"):
        heightmap_of(laid, np.zeros(3), announce=print)
    squared, _ = convert(raster, Conversion(size_m=(0.4, 0.3), spacing_m=0.01), announce=print)
    model = heightmap_of(squared, np.array([1.0, 2.0, 3.0]), announce=print)
    assert model.height_m.shape == (41, 31)
    plane = 0.0005 * np.arange(41)[:, None] + 0.001 * np.arange(31)
    np.testing.assert_allclose(model.height_m + model.origin_trs_m[2], plane + 3.0, atol=1e-7)


def test_a_part_of_a_model_stays_where_it_was_and_a_copy_what_it_was(small: Path, tronlab: Tronlab):
    assert tronlab("convert", small, "part.npy", "--crop", 10, 20, 30, 40)[0] == 0
    whole, part = open_dem(small), open_dem(Path("part.npy"))
    np.testing.assert_array_equal(part.height_m, whole.height_m[10:40, 20:60])
    np.testing.assert_allclose(part.origin_trs_m - whole.origin_trs_m, [0.02, 0.04, 0.0])
    assert facts(tronlab, Path("part.npy"))["craters"] is None, "the law was that of the whole"
    assert tronlab("convert", small, "copy.npy")[0] == 0
    assert facts(tronlab, Path("copy.npy"))["craters"] == facts(tronlab, small)["craters"]


def test_holes_are_refused_or_filled_and_counted(tronlab: Tronlab):
    heights = np.fromfunction(lambda i, j: 0.001 * i + 0.002 * j, (20, 30))
    heights[5:7, 8:10] = np.nan
    np.save("holes.npy", heights)
    size = ("--size-m", 0.19, 0.29)
    code, _, told = tronlab("convert", "holes.npy", "filled.npy", *size, "--relief-m", 0.077)
    assert code == 2
    assert "4 samples are holes, the first at row 5, column 8; fill them (--fill-holes)" in told
    assert not Path("filled.npy").exists()
    code, _, told = tronlab(
        "convert", "holes.npy", "filled.npy", *size, "--relief-m", 0.077, "--fill-holes", 2
    )
    assert code == 0, told
    assert "4 samples were holes and are filled" in told
    assert describe_dem(Path("filled.npy")).n_holes_filled == 4
    # A plane is harmonic: the filling is exact.
    plane = np.fromfunction(lambda i, j: 0.001 * i + 0.002 * j, (20, 30))
    np.testing.assert_allclose(open_dem(Path("filled.npy")).height_m, plane, atol=1e-6)


def test_a_mesh_has_every_nth_sample(small: Path, tronlab: Tronlab):
    code, printed, told = tronlab("convert", small, "mesh.ply", "--every", 2)
    assert code == 0, told
    assert printed == "mesh: mesh.ply\n"
    header = Path("mesh.ply").read_bytes()[:400]
    assert b"element vertex 1581\n" in header  # 31 x 51
    assert b"element face 3000\n" in header


def test_a_scan_knows_the_terrain_but_for_its_errors(small: Path, tronlab: Tronlab):
    code, printed, told = tronlab(
        "scan", small, "--out", "scan.npy", "--noise-mm", 0.1, "--seed", 3, "--scanner", "0,0,5"
    )
    assert code == 0, told
    assert "registration error: moved by +0, +0, +0 mm" in printed
    difference = open_dem(Path("scan.npy")).height_m - open_dem(small).height_m
    assert np.std(difference) == pytest.approx(1e-4, rel=0.05)
    made_by = describe_dem(Path("scan.npy")).made_by
    assert made_by["source"]["seed"] == 4
    assert made_by["truth"]["scan_from_true_xyz_m_quat_xyzw"] == [0, 0, 0, 0, 0, 0, 1]
    code, printed, told = tronlab(
        "scan", small, "--out", "moved.npy", "--registration-mm", 1, "--registration-deg", 0.1
    )
    assert code == 0, told
    assert re.search(r"\d+ samples \(.+ %\) beyond the true terrain", printed)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("info", "nowhere.npy"), "nowhere.npy: does not exist"),
        (("info", "nowhere.yaml"), "nowhere.yaml: no such file"),
        (("info", "typo.yaml"), "typo.yaml:1: terrain.sead: unknown key, did you mean seed?"),
        (("info", RIGS.parent / "straight_line.yaml"), "is a campaign; give the rig file"),
        (("make", "--out", "a.tif"), "a.tif: a terrain model is written to a file NAME.npy"),
        (("make", "--out", "nowhere/a.npy"), "there is no folder nowhere"),
        (("make", "--spacing-m", -1, "--out", "a.npy"), "terrain.spacing_m: must be greater"),
        (("make", "model.yaml", "--out", "a.npy"), "its terrain is the file other.npy already"),
        (("make", "model.yaml", "--seed", 2, "--out", "a.npy"), "only a procedural one takes"),
        (("view", "nowhere.npy", "--out", "a.gif"), "ends in one of .png, .jpg, .pdf"),
        (("convert", "nowhere.npy", "a.xyz"), "a.xyz: cannot be written (allowed: .npy"),
        (
            ("convert", "raw.npy", "a.npy"),
            "the unit of its heights: tronlab terrain convert with --relief-m",
        ),
        (("convert", "raw.npy", "a.npy", "--relief-m", 1), "how far apart its samples are"),
        (("convert", "raw.npy", "a.npy", "--relief-m", -1), "relief is -1.0 m, must be positive"),
        (("convert", "raw.npy", "a.tif", "--crop", 0, 0, 30, 5), "reaches to row 30"),
        (("convert", "raw.npy", "a.tif", "--every", 2), "--every 2 is for meshes (.ply,"),
        (
            ("convert", "raw.npy", "a.npy", "--relief-m", 1, "--size-m", 1, 1, "--spacing-m", 1e-9),
            "would have 1000000001 x 1000000001 samples (at most 2147483647)",
        ),
        (("scan", "raw.npy", "--out", "a.npy", "--noise-mm", -1), "scan.noise_sigma_m: must be"),
        (("scan", "raw.npy", "--out", "a.npy", "--scanner", "1,2"), "'1,2' is no point"),
    ],
)
def test_a_mistake_is_one_clear_message(
    arguments: tuple[object, ...], says: str, tronlab: Tronlab, tmp_path: Path
):
    Path("typo.yaml").write_text("terrain: {kind: procedural, sead: 3}\n")
    Path("model.yaml").write_text("terrain: {kind: dem, path: other.npy}\n")
    np.save("raw.npy", np.arange(400, dtype=np.uint16).reshape(20, 20))
    code, printed, told = tronlab(*arguments)
    assert (code, printed) == (2, "")
    assert says in told
    assert not list(tmp_path.glob("a.*"))


def test_nothing_is_written_over_without_force(
    small: Path, tronlab: Tronlab, monkeypatch: pytest.MonkeyPatch
):
    before = small.read_bytes()
    for command in (
        ("make", *SMALL, "--out", small),
        ("convert", small, small),
        ("scan", small, "--out", small),
    ):
        code, _, told = tronlab(*command)
        assert (code, told) == (2, "error: small.npy: exists already; --force replaces it\n")
    with monkeypatch.context() as patch:
        patch.setattr("os.access", lambda _path, mode: mode != os.W_OK)
        code, _, told = tronlab("convert", small, "other.npy")
    assert (code, told) == (2, "error: other.npy: the folder . cannot be written to\n")
    assert small.read_bytes() == before
    assert tronlab("make", *SMALL[:-1], 5, "--out", small, "--force")[0] == 0
    assert small.read_bytes() != before


def test_ctrl_c_leaves_nothing_behind(
    tronlab: Tronlab, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    def interrupt(*_args: object, **_kwargs: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tronlab.terrain.load.make_terrain", interrupt)
    code, _, told = tronlab("make", *SMALL, "--out", "half.npy")
    assert code == 130
    assert told.endswith("interrupted: no terrain was written\n")
    assert not list(tmp_path.glob("*half*"))
