"""Cores that crash, hang, chat or answer nonsense, scored beside one that does not."""

import csv
import re
import sys
from collections.abc import Mapping
from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
from misbehaving_core import EVERY, LATE_S, WAYS
from scipy.spatial.transform import RigidTransform, Rotation
from typer.testing import CliRunner

from tronlab.cli.app import app
from tronlab.dataset.records import ReferenceView
from tronlab.dataset.writer import DatasetWriter
from tronlab.geometry.camera import CameraModel
from tronlab.score.results import load_results

TESTS = Path(__file__).parents[2]
SCRIPT = TESTS / "support/misbehaving_core.py"
GOOD = "akaze-refined"
N_SHOTS = 12
LIMIT_S = 0.6
CAMERA = CameraModel(240, 224, 190.0, 190.0, 119.5, 111.5)
LOOKING_DOWN = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
SIDE_M = 3.0

WHAT_HAPPENS = {
    "crash": ("error", r"signal 6 \(Aborted\).*pose\.c:42: assertion failed"),
    "segfault": ("error", r"signal 11 \(Segmentation fault\)"),
    "leave": ("error", "code 3"),
    "hang": ("timeout", r"no answer within 0\.6 s"),
    "late": ("timeout", r"answered 0\.\d+ s after the limit of 0\.6 s"),
    "chat": ("error", 'wrote "Loading model'),
    "nan": ("error", "finite|nan|NaN"),
    "wrong-frame": ("error", "'?trs'?.*'?cam'?|'?cam'?.*'?trs'?"),
    "wrong-number": ("error", "8"),
}
"""The status of the tenth frame and a part of the reason, for each way but noise."""


def test_every_way_to_misbehave_is_expected() -> None:
    assert set(WHAT_HAPPENS) == set(WAYS) - {"noise"}
    assert LIMIT_S < LATE_S < 2 * LIMIT_S


def seen(texture: np.ndarray, trs_from_cam: RigidTransform) -> np.ndarray:
    """Give the grey values of a textured square around the origin of trs, in its plane z = 0."""
    texels_per_m = len(texture) / SIDE_M
    r, t = trs_from_cam.rotation.as_matrix().T, trs_from_cam.inv().translation
    k = [[CAMERA.fx_px, 0, CAMERA.cx_px], [0, CAMERA.fy_px, CAMERA.cy_px], [0, 0, 1]]
    uv_from_plane = k @ np.column_stack([r[:, 0], r[:, 1], t])
    plane_from_texel = np.array(
        [[1 / texels_per_m, 0, -SIDE_M / 2], [0, 1 / texels_per_m, -SIDE_M / 2], [0, 0, 1]]
    )
    size = (CAMERA.width_px, CAMERA.height_px)
    return cv2.warpPerspective(texture, uv_from_plane @ plane_from_texel, size)


def depth_m(trs_from_cam: RigidTransform) -> np.ndarray:
    towards = trs_from_cam.rotation.as_matrix()[2]
    rays = np.concatenate([CAMERA.ray_table(), np.ones((*CAMERA.shape, 1))], axis=-1)
    return -trs_from_cam.translation[2] / (rays @ towards)


def pose(i: float) -> RigidTransform:
    tilt = Rotation.from_rotvec([0.01, -0.02, 0.04 * i])
    return RigidTransform.from_components([0.02, 0.01 * i, 1.9 - 0.03 * i], tilt * LOOKING_DOWN)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Shots along a line over a flat, textured terrain, which the good core solves."""
    fakes = load_fakes()
    rng = np.random.default_rng(5)
    noise = cv2.GaussianBlur(rng.normal(size=(700, 700)).astype(np.float32), (0, 0), 3)
    texture = np.clip(120 + 40 * noise / noise.std(), 0, 255).astype(np.uint8)
    everything = np.ones(CAMERA.shape, np.bool_)
    path = tmp_path_factory.mktemp("plane") / "dataset.h5"
    with DatasetWriter(path, replace(fakes.fake_provenance(N_SHOTS), camera=CAMERA)) as writer:
        writer.add_references(
            [
                ReferenceView(
                    i, pose(at), seen(texture, pose(at)), depth_m(pose(at)).astype("f4"), everything
                )
                for i, at in enumerate((2.0, 8.0))
            ]
        )
        for i in range(N_SHOTS):
            shot = fakes.fake_shot(i, trs_from_cam=pose(i))
            truth = replace(shot.truth, range_los_m=1.9 - 0.03 * i, usable_fraction=1.0)
            frame = replace(shot.frame, image=seen(texture, pose(i)))
            writer.commit(replace(shot, frame=frame, mask=everything, truth=truth))
        writer.finish("complete")
    return path


def load_fakes() -> Any:
    spec = spec_from_file_location("fakes", TESTS / "conftest.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def score(dataset: Path, cores: list[str], out: Path, *options: str) -> str:
    """Score as a person does; give what is printed."""
    named = [text for core in cores for text in ("--core", core)]
    where = ("--workers", "1", "--fresh", "--out", str(out))
    done = CliRunner().invoke(app, ["score", str(dataset), *named, *where, *options])
    assert done.exit_code == 0, done.output
    return done.output


@pytest.fixture(scope="module")
def alone(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("alone")
    score(dataset, [GOOD], out)
    return out


@pytest.fixture(scope="module")
def crowd(dataset: Path, alone: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of the good core among all others, and what was printed.

    After ``alone``, so that what the good core does but once is not held against the short limit.
    """
    assert alone.is_dir()
    out = tmp_path_factory.mktemp("crowd")
    others = [f"{way}=cmd:{sys.executable} {SCRIPT} {way}" for way in WAYS]
    cores = [*others[:4], GOOD, *others[4:]]
    return out, score(dataset, cores, out, "--time-limit", str(LIMIT_S))


@pytest.fixture(scope="module")
def reasons(crowd: tuple[Path, str]) -> Mapping[tuple[str, int], str]:
    """Why there is no pose, by core and shot id."""
    return load_results(crowd[0]).reasons


def rows(folder: Path, core: str) -> list[Mapping[str, str]]:
    with (folder / "scores.csv").open(newline="") as file:
        return [row for row in csv.DictReader(file) if row["core"] == core]


def test_the_rows_of_the_good_core_are_those_it_has_alone(
    alone: Path, crowd: tuple[Path, str]
) -> None:
    def without_times(folder: Path) -> list[Mapping[str, str]]:
        return [
            {key: text for key, text in row.items() if not key.startswith("time_")}
            for row in rows(folder, GOOD)
        ]

    assert without_times(crowd[0]) == without_times(alone)
    assert [row["status"] for row in rows(alone, GOOD)] == ["ok"] * N_SHOTS
    assert max(float(row["position_error_m"]) for row in rows(alone, GOOD)) < 0.05


def test_so_are_its_matches(alone: Path, crowd: tuple[Path, str]) -> None:
    stored: list[dict[str, Any]] = []
    for folder in (alone, crowd[0]):
        with h5py.File(folder / "matches.h5") as file:
            found: dict[str, Any] = {}
            file[GOOD].visititems(
                lambda name, item, found=found: found.update(
                    {
                        name: (
                            dict(item.attrs),
                            item[()].tobytes() if hasattr(item, "shape") else b"",
                        )
                    }
                )
            )
            stored.append(found)
    assert stored[0]
    assert str(stored[0]) == str(stored[1])


@pytest.mark.parametrize("way", WHAT_HAPPENS)
def test_the_tenth_frame_says_what_happened_and_the_others_are_scored(
    crowd: tuple[Path, str], reasons: Mapping[tuple[str, int], str], way: str
) -> None:
    expected, reason = WHAT_HAPPENS[way]
    statuses = [row["status"] for row in rows(crowd[0], way)]
    assert statuses == [expected if i % EVERY == EVERY - 1 else "ok" for i in range(N_SHOTS)], (
        reasons
    )
    (shot_id,) = [int(row["shot_id"]) for row in rows(crowd[0], way) if row["status"] != "ok"]
    assert re.search(reason, reasons[way, shot_id]), reasons[way, shot_id]


def test_noise_is_scored_for_what_it_is(crowd: tuple[Path, str]) -> None:
    noise = rows(crowd[0], "noise")
    assert [row["status"] for row in noise] == ["ok"] * N_SHOTS
    assert np.median([float(row["position_error_m"]) for row in noise]) > 10.0


def test_the_command_names_each_of_them(crowd: tuple[Path, str]) -> None:
    for way in WAYS:
        assert re.search(rf"\b{way}\b", crowd[1]), crowd[1]
