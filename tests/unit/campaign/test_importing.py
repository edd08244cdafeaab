"""Sets of others become datasets that can be validated and scored."""

import io
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import RigidTransform, Rotation
from wire_laboratory import write_twin_rig

from tronlab.campaign.importing import import_folder, import_tum
from tronlab.campaign.live import PlainLive
from tronlab.campaign.rig import load_rig
from tronlab.dataset.exchange.export import export
from tronlab.dataset.journal import read_journal
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Provenance, ReferenceView, ShotRecord
from tronlab.dataset.validate import validate
from tronlab.dataset.writer import DatasetWriter
from tronlab.errors import CalibrationError, DatasetError
from tronlab.geometry.camera import CameraModel
from tronlab.planning.shots import range_los_m
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.mask import model_mask
from tronlab.score.rescore import score_dataset

LOOKING_DOWN = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@pytest.fixture
def folder(small_dataset: Path) -> Path:
    """The small dataset, exported."""
    out = small_dataset.parent / "folder"
    export(small_dataset, "folder", out)
    return out


def without_columns(csv_path: Path, *names: str) -> None:
    rows = [line.split(",") for line in csv_path.read_text().splitlines()]
    kept = [i for i, name in enumerate(rows[0]) if not name.startswith(names)]
    csv_path.write_text("\n".join(",".join(row[i] for i in kept) for row in rows))


def is_equal(a: object, b: object) -> bool:
    return bool(np.array_equal(np.asarray(a), np.asarray(b), equal_nan=True))


def same_pose(a: RigidTransform, b: RigidTransform) -> bool:
    return bool(np.allclose(a.as_matrix(), b.as_matrix(), atol=1e-12))


def test_what_was_exported_comes_back(
    tmp_path: Path,
    make_shot: Callable[..., ShotRecord],
    make_provenance: Callable[..., Provenance],
    make_view: Callable[[int], ReferenceView],
) -> None:
    with DatasetWriter(tmp_path / "d.h5", make_provenance(2)) as writer:
        writer.add_references([make_view(0), make_view(1)])
        for i in range(2):
            writer.commit(make_shot(i, shot_id=7 * i, dtype=np.uint16))
        writer.finish("complete")
    export(tmp_path / "d.h5", "folder", tmp_path / "folder")
    path = import_folder(tmp_path / "folder/shots.csv", tmp_path / "again", name="of others")
    assert path == tmp_path / "again/dataset.h5"
    assert validate(path) == validate(tmp_path / "d.h5")
    with Dataset(tmp_path / "d.h5") as before, Dataset(path) as after:
        assert after.camera == before.camera
        assert after.provenance.campaign_name == "of others"
        assert [session.kind for session in after.sessions] == ["import"]
        for i in range(2):
            old, new = before.shot(i), after.shot(i)
            assert (new.robot, new.tracker, new.room, new.shot_id) == (None, None, None, 7 * i)
            assert is_equal(new.frame.image, old.frame.image)
            assert is_equal(new.mask, old.mask)
            assert same_pose(new.truth.trs_from_cam, old.truth.trs_from_cam)
            assert same_pose(new.trs_from_cam_nominal, old.trs_from_cam_nominal)
            np.testing.assert_allclose(
                new.truth.covariance, old.truth.covariance, rtol=1e-9, atol=1e-20
            )
            assert new.truth.range_los_m == old.truth.range_los_m
            assert new.truth.usable_fraction == old.truth.usable_fraction
            kept = ("pixel_format", "exposure_s", "gain_db", "time_s")
            assert [getattr(new.frame, k) for k in kept] == [getattr(old.frame, k) for k in kept]
        for old_view, new_view in zip(before.references(), after.references(), strict=True):
            assert same_pose(new_view.trs_from_cam, old_view.trs_from_cam)
            for name in ("view_id", "image", "mask", "depth_m"):
                assert is_equal(getattr(new_view, name), getattr(old_view, name))


@pytest.mark.opencv
def test_scores_are_those_of_the_dataset_it_came_from(
    tmp_path: Path,
    make_shot: Callable[..., ShotRecord],
    make_provenance: Callable[..., Provenance],
) -> None:
    _write_textured(tmp_path / "textured.h5", make_shot, make_provenance)
    export(tmp_path / "textured.h5", "folder", tmp_path / "folder")
    again = import_folder(tmp_path / "folder/shots.csv", tmp_path / "again")
    before, after = (
        score_dataset(path, cores=["akaze"], out_dir=tmp_path / out, workers=1).iloc[0].to_dict()
        for path, out in ((tmp_path / "textured.h5", "before"), (again, "after"))
    )
    assert before["status"] == "ok"
    for name, value in before.items():
        if isinstance(value, str):
            assert after[name] == value
        elif not name.startswith("time_"):
            assert after[name] == pytest.approx(value, abs=1e-9, nan_ok=True), name


def _write_textured(
    path: Path,
    make_shot: Callable[..., ShotRecord],
    make_provenance: Callable[..., Provenance],
) -> None:
    """One shot and one reference view of blurred noise on a plane, seen without distortion."""
    camera = CameraModel(256, 224, 220.0, 221.0, 127.2, 111.9)
    noise = np.random.default_rng(8).normal(size=(700, 700)).astype(np.float32)
    texture = cv2.GaussianBlur(noise, (0, 0), 3)
    grey = np.clip(120 + 40 * texture / texture.std(), 0, 255).astype(np.uint8)
    reference = RigidTransform.from_components([1.0, 1.0, 2.0], LOOKING_DOWN)
    turned = Rotation.from_euler("z", 0.1) * LOOKING_DOWN
    shot = make_shot(0, trs_from_cam=RigidTransform.from_components([1.05, 1.0, 1.9], turned))
    mask = np.ones(camera.shape, dtype=np.bool_)
    view = ReferenceView(
        0, reference, _seen(grey, camera, reference), np.full(camera.shape, 2.0, np.float32), mask
    )
    image = _seen(grey, camera, shot.truth.trs_from_cam)
    shot = replace(
        shot,
        frame=replace(shot.frame, image=image),
        mask=mask,
        truth=replace(shot.truth, usable_fraction=1.0),
    )
    with DatasetWriter(path, replace(make_provenance(1), camera=camera)) as writer:
        writer.add_references([view])
        writer.commit(shot)
        writer.finish("complete")


def _seen(
    texture: NDArray[np.uint8], camera: CameraModel, trs_from_cam: RigidTransform
) -> NDArray[np.uint8]:
    """What the camera sees of a texture of 300 pixels a metre on the plane z = 0."""
    rays = np.concatenate([camera.ray_table(), np.ones((*camera.shape, 1))], axis=-1)
    directions = rays @ trs_from_cam.rotation.as_matrix().T
    eye = trs_from_cam.translation
    p_trs = eye - directions * (eye[2] / directions[..., 2:])
    texel = (p_trs[..., :2] * 300).astype(np.float32)
    return cv2.remap(texture, texel[..., 0], texel[..., 1], cv2.INTER_CUBIC)


def test_what_a_set_does_not_say_is_not_made_up(folder: Path) -> None:
    csv_path = folder / "shots.csv"
    without_columns(
        csv_path, "mask", "cov_", "time_s", "exposure_s", "gain_db", "nominal", "pixel_format"
    )
    (folder / "references.csv").unlink()
    said = io.StringIO()
    path = import_folder(csv_path, folder.parent / "again", live=PlainLive(said))
    assert "no reference views: cores that need them cannot be scored" in said.getvalue()
    assert validate(path) == []
    assert read_journal(path)[0].text == f"imported from {csv_path}"
    with Dataset(path) as dataset:
        shot = dataset.shot(2)
        assert shot.mask.all()
        assert shot.truth.usable_fraction == 1.0
        assert np.isnan(shot.truth.covariance).all()
        assert np.isnan([shot.frame.time_s, shot.frame.exposure_s, shot.frame.gain_db]).all()
        assert dataset.n_references == 0
    with pytest.raises(DatasetError, match="shot 0: its time is not known"):
        export(path, "tum", folder.parent / "tum")


def test_a_recording_still_has_to_know_what_it_measures(
    tmp_path: Path,
    make_shot: Callable[..., ShotRecord],
    make_provenance: Callable[..., Provenance],
) -> None:
    shot = make_shot(0)
    unknown = replace(shot, frame=replace(shot.frame, exposure_s=np.nan))
    with (
        DatasetWriter(tmp_path / "d.h5", make_provenance(1)) as writer,
        pytest.raises(DatasetError, match="exposure_s: is not finite"),
    ):
        writer.commit(unknown)


def test_what_cannot_be_imported_leaves_nothing(folder: Path) -> None:
    csv_path, out = folder / "shots.csv", folder.parent / "again"
    text = csv_path.read_text()
    before = sorted(folder.parent.iterdir())
    shutil.copy(folder / "references/000000_depth.npy", folder / "images/000003.png")
    with pytest.raises(DatasetError, match=r"shots\.csv:5: .*000003\.png: is no image"):
        import_folder(csv_path, out)
    shutil.copy(folder / "images/000002.png", folder / "images/000003.png")
    csv_path.write_text(text.replace("Mono8", "M" * 17, 4).replace("M" * 17, "Mono8", 3))
    with pytest.raises(DatasetError, match=r"^\S+shots\.csv:5: shot 3: instrument/camera/pixel_fo"):
        import_folder(csv_path, out)
    csv_path.write_text(text)
    without_columns(csv_path, "range_los_m")
    with pytest.raises(DatasetError, match=r"csv:2: shot 0: no range_los_m, and errors are per"):
        import_folder(csv_path, out)
    csv_path.write_text(text)
    (folder / "camera.json").rename(folder / "lens.json")
    with pytest.raises(DatasetError, match=r"there is no camera\.json beside it; name the camera"):
        import_folder(csv_path, out)
    assert sorted(folder.parent.iterdir()) == before
    import_folder(csv_path, out, camera_path=folder / "lens.json")
    with pytest.raises(DatasetError, match="again: exists already"):
        import_folder(csv_path, out, camera_path=folder / "lens.json")


def test_a_camera_that_cannot_be_is_refused(folder: Path) -> None:
    path = folder / "camera.json"
    camera = path.read_text()
    cases = {
        "{": r"camera\.json:1: not JSON",
        "[1]": "is no camera: expected a JSON object",
        '{"width_px": 64}': r"camera\.json: .*missing or unknown: cx_px, cy_px, distortion",
        camera.replace("48.2", "0"): "focal lengths and image size must be above 0",
        camera.replace("48.2", "NaN"): "a number is not finite",
        '{"fx": 64}': "is no camera: expected width_px, height_px, .* or a calibration record",
    }
    for text, message in cases.items():
        path.write_text(text)
        with pytest.raises(CalibrationError, match=message):
            import_folder(folder / "shots.csv", folder.parent / "again")


def test_a_rig_gives_ranges_masks_and_reference_views(tmp_path: Path) -> None:
    rig_path = write_twin_rig(tmp_path)
    rig = load_rig(rig_path)
    camera = CameraModel(32, 24, 30.0, 30.0, 15.5, 11.5)
    poses = [RigidTransform.from_components([0.4, 2.0, z_m], LOOKING_DOWN) for z_m in (3.0, 2.5)]
    _write_tum(tmp_path, camera, poses)
    arguments = tmp_path / "rgb.txt", tmp_path / "groundtruth.txt", tmp_path / "camera.json"
    path = import_tum(*arguments, tmp_path / "out", rig_path=rig_path, max_difference_s=0.01)
    heightmap = rig.load_heightmap()
    finder = HeightfieldRenderer(heightmap)
    with Dataset(path) as dataset:
        assert dataset.provenance.rig_name == rig.name
        assert dataset.n_references == 2
        assert np.nanmin(dataset.reference(1).depth_m) > 2.0
        for i, pose in enumerate(poses):
            shot = dataset.shot(i)
            range_m = range_los_m(finder, pose, ground_trs_m=heightmap.mean_height_trs_m)
            assert shot.truth.range_los_m == pytest.approx(range_m)
            assert is_equal(shot.mask, model_mask(heightmap, camera, pose))
            assert 0.1 < shot.truth.usable_fraction < 1.0
    assert "2 of 2 images have a pose" in read_journal(path)[1].text
    away = [pose * RigidTransform.from_matrix(np.diag([1.0, -1, -1, 1])) for pose in poses]
    _write_tum(tmp_path, camera, away)
    with pytest.raises(DatasetError, match=r"rgb\.txt:1: shot 1: its optical axis does not"):
        import_tum(*arguments, tmp_path / "other", rig_path=rig_path)


def _write_tum(folder: Path, camera: CameraModel, poses: list[RigidTransform]) -> None:
    rng = np.random.default_rng(4)
    trajectory: list[str] = []
    for i, pose in enumerate(poses):
        grey = rng.integers(1, 255, camera.shape, dtype=np.uint8)
        Image.fromarray(grey).save(folder / f"{i}.png")
        numbers = [*pose.translation, *pose.rotation.as_quat()]
        trajectory.append(" ".join(map(str, [i + 0.004, *numbers])))
    images = [f"{i}.0 {i}.png" for i in range(len(poses))]
    (folder / "rgb.txt").write_text("\n".join(images))
    (folder / "groundtruth.txt").write_text("\n".join(trajectory))
    (folder / "camera.json").write_text(json.dumps(camera.to_dict()))
