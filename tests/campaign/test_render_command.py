"""``tronlab render`` on the small twin."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command import tronlab

from tronlab.campaign.rig import load_rig
from tronlab.render.cycles.process import PYTHON_VARIABLE

EditYaml = Callable[..., None]


def pixels(path: Path) -> np.ndarray:
    image: Any = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return image


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "views.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.opencv
def test_both_kinds_of_images_with_depth_and_poses(campaign_path: Path, tmp_path: Path) -> None:
    answer = tronlab("render", campaign_path, cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    assert "laboratory: 5 images of 64 x 64 px by heightfield" in answer.stdout
    assert "database: 2 images of 64 x 64 px by heightfield" in answer.stdout
    for name, n in (("laboratory", 5), ("database", 2)):
        folder = tmp_path / "out/small-images" / name
        assert len(rows(folder)) == n
        assert (folder / "contact_sheet.jpg").stat().st_size > 1000
        assert len((folder / "poses.txt").read_text().splitlines()) >= n
        for i in range(1, n + 1):
            image = pixels(folder / f"images/{i:04d}.png")
            radiance = pixels(folder / f"radiance/{i:04d}.tif")
            depth = pixels(folder / f"depth/{i:04d}.tif")
            assert (image.dtype, radiance.dtype, depth.dtype) == (np.uint8, np.float32, np.float32)
            bright = radiance > 0.5 * radiance.max()
            assert image[bright].min() > image[radiance < 0.1 * radiance.max()].mean()
            assert 1.5 < np.nanmedian(depth) < 3.5


def test_another_renderer_shows_the_same_terrain(campaign_path: Path, tmp_path: Path) -> None:
    arguments = ("render", campaign_path, "--shots", "2,4", "--images", "database")
    assert tronlab(*arguments, "--out", "a", cwd=tmp_path).returncode == 0
    answer = tronlab(*arguments, "--out", "b", "--renderer", "reference", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    assert "by reference" in answer.stdout
    assert [row["view_id"] for row in rows(tmp_path / "b/database")] == ["2", "4"]
    depths = [pixels(tmp_path / x / "database/depth/0004.tif") for x in "ab"]
    np.testing.assert_allclose(*depths, atol=2e-5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--renderer", "povray"), "error: no renderer 'povray'; known renderers: cycles, "),
        (("--shots", "9"), "error: --shots: the campaign has no shot 9; it has 1 to 5"),
        (("--shots", "two"), "error: "),
    ],
)
def test_what_cannot_be_is_one_line(
    campaign_path: Path, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    answer = tronlab("render", campaign_path, *arguments, "--images", "database", cwd=tmp_path)
    assert (answer.returncode, answer.stdout) == (2, "")
    assert answer.stderr.splitlines()[-1].startswith(message)


def test_folder_in_use_is_left_alone(campaign_path: Path, tmp_path: Path) -> None:
    (tmp_path / "used").mkdir()
    (tmp_path / "used/mine.txt").write_text("mine")
    answer = tronlab("render", campaign_path, "--out", "used", cwd=tmp_path)
    assert answer.returncode == 2
    assert "--out used: exists and is not empty, nothing is overwritten" in answer.stderr
    assert [path.name for path in (tmp_path / "used").iterdir()] == ["mine.txt"]


def test_what_a_renderer_cannot_do_leaves_nothing(
    campaign_path: Path, tmp_path: Path, edit_yaml: EditYaml, monkeypatch: pytest.MonkeyPatch
) -> None:
    edit_yaml(campaign_path, "database.photometry", "hapke")
    python = tmp_path / "python"
    python.touch()
    monkeypatch.setenv(PYTHON_VARIABLE, str(python))
    arguments = ("--images", "database", "--renderer", "cycles")
    answer = tronlab("render", campaign_path, *arguments, cwd=tmp_path)
    assert answer.returncode == 2
    assert "error: renderer cycles: photometry is 'hapke', must be 'lambert'" in answer.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("file", "key"), [("campaign", "database.renderer"), ("rig", "world.surface.renderer")]
)
def test_unknown_renderer_is_found_before_anything_begins(
    campaign_path: Path, rig_path: Path, tmp_path: Path, edit_yaml: EditYaml, file: str, key: str
) -> None:
    path = {"campaign": campaign_path, "rig": rig_path}[file]
    edit_yaml(path, key, "mitsubba")
    answer = tronlab("run", campaign_path, cwd=tmp_path)
    assert answer.returncode == 2
    assert f"{key}: no renderer 'mitsubba'; known renderers: cycles, heightfield" in answer.stderr
    assert not (tmp_path / "out").exists()


def test_terrain_as_it_really_is_need_not_be_the_one_that_is_known(
    rig_path: Path, edit_yaml: EditYaml
) -> None:
    """The camera sees ``world.terrain``; serial numbers and so calibrations stay."""
    rig = load_rig(rig_path)
    real = {"kind": "procedural", "seed": 7, "spacing_m": 0.01}
    edit_yaml(rig_path, "world.terrain", real)
    changed = load_rig(rig_path)
    setup = changed.world_setup(changed.load_heightmap)
    assert setup is not None
    seen = setup.load_heightmap().height_m
    assert not np.array_equal(seen, changed.load_heightmap().height_m)
    np.testing.assert_array_equal(changed.load_heightmap().height_m, rig.load_heightmap().height_m)
    serials = []
    for each in (rig, changed):
        devices = each.open_devices(0)
        devices.tracker.connect()
        serials.append(devices.tracker.identify().serial)
        devices.tracker.close()
    assert serials[0] == serials[1]
