"""Exports, read back by the rules of each format and by nothing of tronlab's."""

import errno
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from PIL import Image

from tronlab.dataset import schema
from tronlab.dataset.exchange import images as image_files
from tronlab.dataset.exchange.export import EXPORTERS, export
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Provenance, ShotQuality, ShotRecord
from tronlab.dataset.writer import DatasetWriter
from tronlab.errors import DatasetError, IntegrityError
from tronlab.geometry.camera import CameraModel

P_TRS_M = np.array([[1.05, 2.15, 0.02], [1.3, 1.9, -0.05], [0.6, 2.4, 0.1]])
"""Points of the model that all shots see."""
LOSSLESS = ("speedplus", "tum", "colmap", "folder")
GOOD = ShotQuality(0, 0, 0, 0, 0, 0, 0, 0, 0.2, 100.0, None)


def read(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.array(image)


def rows_of(path: Path) -> list[list[str]]:
    """Words of the lines that are no comments."""
    return [line.split() for line in path.read_text().splitlines() if line[:1] != "#"]


def rotation_of(w: float, x: float, y: float, z: float) -> np.ndarray:
    """Hamilton's, written out: p' = R p."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def projected(p_cam: np.ndarray, k: list[float], focal: list[float], centre: list[float]):
    """OpenCV's distortion, written out; as COLMAP's models OPENCV and FULL_OPENCV."""
    k = [*k, *[0.0] * (8 - len(k))]
    x, y = p_cam[:, 0] / p_cam[:, 2], p_cam[:, 1] / p_cam[:, 2]
    r2 = x * x + y * y
    radial = (1 + k[0] * r2 + k[1] * r2**2 + k[4] * r2**3) / (
        1 + k[5] * r2 + k[6] * r2**2 + k[7] * r2**3
    )
    u = x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x)
    v = y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y
    return np.column_stack([focal[0] * u + centre[0], focal[1] * v + centre[1]])


def seen(dataset: Dataset, i: int) -> np.ndarray:
    """Where tronlab says that the points are in the image of shot ``i``."""
    return dataset.camera.project(dataset.truth(i).trs_from_cam.inv().apply(P_TRS_M))


def exported(dataset_path: Path, format_name: str) -> Path:
    out = dataset_path.parent / format_name
    export(dataset_path, format_name, out)
    return out


def write(path: Path, provenance: Provenance, *shots: ShotRecord) -> Path:
    with DatasetWriter(path, provenance, n_spare_rows=1) as writer:
        for shot in shots:
            writer.commit(shot, replaces=shot.attempt > 1)
        writer.finish("complete")
    return path


def test_every_export_says_where_it_comes_from(small_dataset: Path) -> None:
    with Dataset(small_dataset) as dataset:
        for format_name, exporter in EXPORTERS.items():
            told: list[tuple[int, int]] = []
            out = small_dataset.parent / format_name
            export(small_dataset, format_name, out, on_shot=lambda *n, told=told: told.append(n))
            assert told == [(i, 5) for i in range(1, 6)]
            readme = (out / "README.txt").read_text()
            assert str(dataset.uuid) in readme
            assert exporter.conventions in readme
            manifest = json.loads((out / "tronlab.json").read_text())
            assert manifest["uuid"] == dataset.uuid
            assert [shot["shot_id"] for shot in manifest["shots"]] == dataset.shot_ids.tolist()
            for i, shot in enumerate(manifest["shots"]):
                assert shot["truth_state"] == "good"
                image = read(out / shot["image"])
                if format_name in LOSSLESS:
                    np.testing.assert_array_equal(image, dataset.image(i))
    assert not list(small_dataset.parent.glob(".*"))


def test_speed_plus_poses_project_as_its_authors_do(small_dataset: Path) -> None:
    out = exported(small_dataset, "speedplus")
    camera = json.loads((out / "camera.json").read_text())
    labels = json.loads((out / "lab/train.json").read_text())
    assert (camera["Nu"], camera["Nv"]) == (64, 48)
    k = np.array(camera["cameraMatrix"])
    assert (camera["ccx"], camera["ccy"]) == (k[0, 2], k[1, 2])
    with Dataset(small_dataset) as dataset:
        for i, label in enumerate(labels):
            assert label["filename"] == f"img{i:06d}.png"
            p_cam = P_TRS_M @ rotation_of(*label["q_vbs2tango_true"]).T + label["r_Vo2To_vbs_true"]
            uv = projected(p_cam, camera["distCoeffs"], [k[0, 0], k[1, 1]], [k[0, 2], k[1, 2]])
            np.testing.assert_allclose(uv, seen(dataset, i), atol=1e-9)


@pytest.mark.parametrize(
    ("distortion", "model"),
    [
        ((), "PINHOLE"),
        ((-0.1, 0.03, 1e-4, -2e-4), "OPENCV"),
        ((-0.1, 0.03, 1e-4, -2e-4, 0.01, 0.02, -0.01, 0.005), "FULL_OPENCV"),
    ],
)
def test_colmap_begins_at_the_corner_of_the_image(
    tmp_path: Path,
    make_shot: Callable[..., ShotRecord],
    make_provenance: Callable[..., Provenance],
    distortion: tuple[float, ...],
    model: str,
) -> None:
    provenance = make_provenance(2)
    camera = replace(provenance.camera, distortion=distortion)
    path = write(tmp_path / "d.h5", replace(provenance, camera=camera), make_shot(0), make_shot(1))
    out = exported(path, "colmap") / "sparse/0"
    ((_, name, width, height, fx, fy, cx, cy, *k),) = rows_of(out / "cameras.txt")
    assert (name, width, height) == (model, "64", "48")
    coefficients = [float(word) for word in k]
    lines = rows_of(out / "images.txt")
    assert lines[1::2] == [[], []]  # each image is followed by the line of its points
    with Dataset(path) as dataset:
        for i, (image_id, *pose, camera_id, image) in enumerate(lines[::2]):
            assert (image_id, camera_id, image) == (str(i + 1), "1", f"{i:06d}.png")
            numbers = [float(word) for word in pose]
            p_cam = P_TRS_M @ rotation_of(*numbers[:4]).T + numbers[4:]
            uv = projected(p_cam, coefficients, [float(fx), float(fy)], [float(cx), float(cy)])
            np.testing.assert_allclose(uv, seen(dataset, i) + 0.5, atol=1e-9)
            mask = read(path.parent / f"colmap/masks/{image}.png")
            np.testing.assert_array_equal(mask, 255 * dataset.mask(i))


def test_tum_has_the_camera_in_the_world_by_time(small_dataset: Path) -> None:
    out = exported(small_dataset, "tum")
    images, poses = rows_of(out / "rgb.txt"), rows_of(out / "groundtruth.txt")
    assert [row[0] for row in images] == [row[0] for row in poses]
    with Dataset(small_dataset) as dataset:
        for i, (row, (_, image)) in enumerate(zip(poses, images, strict=True)):
            time_s, *numbers = (float(word) for word in row)
            assert time_s == dataset.shot(i).frame.time_s
            np.testing.assert_array_equal(read(out / image), dataset.image(i))
            x, y, z, w = numbers[3:]
            p_cam = (P_TRS_M - numbers[:3]) @ rotation_of(w, x, y, z)
            np.testing.assert_allclose(dataset.camera.project(p_cam), seen(dataset, i), atol=1e-9)


@pytest.mark.parametrize(
    ("times_s", "message"),
    [
        ((5.0, 5.0000001), "shots 0 and 1 have the same time 5.000000 s"),
        ((5.0, np.nan), "shot 1: its time is not known"),
    ],
)
def test_tum_needs_a_time_for_each_shot(
    tmp_path: Path,
    make_shot: Callable[..., ShotRecord],
    make_provenance: Callable[..., Provenance],
    times_s: tuple[float, float],
    message: str,
) -> None:
    shots = [
        replace(shot, tracker=None, frame=replace(shot.frame, time_s=time_s))
        for shot, time_s in zip(map(make_shot, range(2)), times_s, strict=True)
    ]
    path = write(tmp_path / "d.h5", make_provenance(2), *shots)
    with pytest.raises(DatasetError, match=message):
        exported(path, "tum")
    assert not (tmp_path / "tum").exists()


def test_bop_is_in_millimetres_and_without_distortion(small_dataset: Path) -> None:
    scene = exported(small_dataset, "bop") / "test/000001"
    cameras, poses, infos = (
        json.loads((scene / f"scene_{name}.json").read_text())
        for name in ("camera", "gt", "gt_info")
    )
    targets = json.loads((scene.parents[1] / "test_targets_bop19.json").read_text())
    assert [target["im_id"] for target in targets] == [0, 1, 2, 3, 4]
    with Dataset(small_dataset) as dataset:
        pinhole = replace(dataset.camera, distortion=())
        for i in range(5):
            (pose,), (info,), camera = poses[str(i)], infos[str(i)], cameras[str(i)]
            assert pose["obj_id"] == 1
            assert pose["cam_R_m2c"] == camera["cam_R_w2c"]
            assert pose["cam_t_m2c"] == camera["cam_t_w2c"]
            p_cam_mm = 1000 * P_TRS_M @ np.reshape(pose["cam_R_m2c"], (3, 3)).T + pose["cam_t_m2c"]
            p_image = p_cam_mm @ np.reshape(camera["cam_K"], (3, 3)).T
            uv = pinhole.project(dataset.truth(i).trs_from_cam.inv().apply(P_TRS_M))
            np.testing.assert_allclose(p_image[:, :2] / p_image[:, 2:], uv, atol=1e-9)
            _check_info(info, read(scene / f"mask/{i:06d}_000000.png"))
    assert read(scene / "gray/000004.png").shape == (48, 64)


def _check_info(info: dict[str, Any], mask: np.ndarray) -> None:
    v, u = np.nonzero(mask)
    assert set(np.unique(mask)) == {0, 255}
    assert info["px_count_visib"] == len(u)
    expected = [u.min(), v.min(), u.max() - u.min(), v.max() - v.min()]
    assert info["bbox_obj"] == info["bbox_visib"] == expected


@pytest.mark.opencv
def test_bop_images_are_what_a_pinhole_sees(
    tmp_path: Path,
    make_shot: Callable[..., ShotRecord],
    make_provenance: Callable[..., Provenance],
) -> None:
    camera = CameraModel(64, 48, 48.0, 48.2, 31.4, 23.7, (-0.11, 0.03, 1e-4, -2e-4))
    shot = make_shot(0, dtype=np.uint16)
    rays = camera.ray_table()
    grey = np.rint(2000 + 1500 * rays[..., 0] + 700 * rays[..., 1]).astype(np.uint16)
    shot = replace(shot, frame=replace(shot.frame, image=grey), mask=rays[..., 0] > 0.1)
    path = write(tmp_path / "d.h5", replace(make_provenance(1), camera=camera), shot)
    scene = exported(path, "bop") / "test/000001"
    u, v = np.meshgrid(np.arange(64), np.arange(48))
    x, y = (u - 31.4) / 48.0, (v - 23.7) / 48.2
    image, mask = read(scene / "gray/000000.png"), read(scene / "mask/000000_000000.png") > 0
    assert image.dtype == np.uint16
    assert np.mean(image > 0) > 0.98
    within = (u > 0) & (v > 0) & (u < 63) & (v < 47)
    np.testing.assert_allclose(image[within], (2000 + 1500 * x + 700 * y)[within], atol=2.0)
    assert (mask == (x > 0.1))[within & (np.abs(x - 0.1) > 0.02)].all()


@pytest.mark.parametrize("is_seen", [True, False])
def test_bop_without_distortion_keeps_every_bit(
    tmp_path: Path,
    make_shot: Callable[..., ShotRecord],
    make_provenance: Callable[..., Provenance],
    is_seen: bool,
) -> None:
    provenance = make_provenance(1)
    shot = make_shot(0, dtype=np.uint16)
    shot = replace(shot, mask=shot.mask & is_seen)
    camera = replace(provenance.camera, distortion=())
    path = write(tmp_path / "d.h5", replace(provenance, camera=camera), shot)
    scene = exported(path, "bop") / "test/000001"
    np.testing.assert_array_equal(read(scene / "gray/000000.png"), shot.frame.image)
    np.testing.assert_array_equal(read(scene / "mask/000000_000000.png"), 255 * shot.mask)
    (info,) = json.loads((scene / "scene_gt_info.json").read_text())["0"]
    assert (info["bbox_obj"] == [-1, -1, -1, -1]) is not is_seen
    assert info["visib_fract"] == float(is_seen)


def test_a_shot_that_was_taken_again_counts_once_and_flags_are_told(
    tmp_path: Path,
    make_shot: Callable[..., ShotRecord],
    make_provenance: Callable[..., Provenance],
) -> None:
    blurred = replace(make_shot(0), quality=replace(GOOD, flags=("contrast", "blur")))
    again = make_shot(3, shot_id=1, attempt=2)
    path = write(tmp_path / "d.h5", make_provenance(2), blurred, make_shot(1), again)
    out = exported(path, "folder")
    manifest = json.loads((out / "tronlab.json").read_text())
    assert [shot["flags"] for shot in manifest["shots"]] == [["contrast", "blur"], []]
    np.testing.assert_array_equal(read(out / manifest["shots"][1]["image"]), again.frame.image)
    assert "shot 0 was flagged: contrast blur" in (out / "README.txt").read_text()
    assert "0-1 is unchecked" in (out / "README.txt").read_text()


def test_nothing_is_left_of_an_export_that_was_cut_short(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = small_dataset.parent / "out"
    before = sorted(small_dataset.parent.iterdir())

    def interrupt(n_done: int, n_all: int) -> None:
        if n_done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(small_dataset, "bop", out, on_shot=interrupt)
    assert sorted(small_dataset.parent.iterdir()) == before

    write_png = image_files.write_png

    def fill_the_disk(path: Path, image: np.ndarray) -> None:
        if path.name == "000002.png":
            raise OSError(errno.ENOSPC, "No space left on device")
        write_png(path, image)

    monkeypatch.setattr("tronlab.dataset.exchange.colmap.write_png", fill_the_disk)
    with pytest.raises(DatasetError, match="out: cannot be written: No space left on device"):
        export(small_dataset, "colmap", out)
    assert sorted(small_dataset.parent.iterdir()) == before

    with h5py.File(small_dataset, "r+") as file:
        file[schema.IMAGE][4, 3, 3] ^= 1
    with pytest.raises(IntegrityError, match="shot 4: image is damaged"):
        export(small_dataset, "folder", out)
    assert sorted(small_dataset.parent.iterdir()) == before


def test_what_cannot_be_exported_is_refused(
    small_dataset: Path, make_provenance: Callable[..., Provenance]
) -> None:
    folder = small_dataset.parent
    (folder / "there").mkdir()
    (folder / ".half.part").mkdir()
    cases = [
        ("kitti", folder / "out", r"no format 'kitti'; known are bop, speedplus, tum, colmap"),
        ("tum", folder / "there", "there: exists already and is never overwritten"),
        ("tum", folder / "no/out", "out: the folder .*no does not exist"),
        ("tum", folder / "half", r"one that was killed left \.half\.part; if none is running"),
    ]
    for format_name, out, message in cases:
        with pytest.raises(DatasetError, match=message):
            export(small_dataset, format_name, out)
    assert (folder / ".half.part").exists()
