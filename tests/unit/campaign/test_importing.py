"""Sets of others become datasets that can be validated and scored."""

import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from wire_laboratory import write_twin_rig

from tronlab.campaign.importing import import_folder, import_tum
from tronlab.campaign.live import PlainLive
from tronlab.campaign.recompute import recompute_truth
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
from tronlab.score.shot import ShotScorer

SCORE_TESTS = Path(__file__).parents[1] / "score"


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


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_what_was_exported_comes_back(
    tmp_path: Path,
    make_shot: Callable[..., ShotRecord],
    make_provenance: Callable[..., Provenance],
    make_view: Callable[[int], ReferenceView],
    dtype: type[np.uint8] | type[np.uint16],
) -> None:
    with DatasetWriter(tmp_path / "d.h5", make_provenance(2)) as writer:
        writer.add_references([make_view(0), make_view(1)])
        for i in range(2):
            writer.commit(make_shot(i, shot_id=7 * i, dtype=dtype))
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
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(SCORE_TESTS))
    from make_textured_dataset import write  # pyright: ignore[reportMissingImports]

    monkeypatch.delitem(sys.modules, "make_textured_dataset")
    write(tmp_path / "textured.h5")
    export(tmp_path / "textured.h5", "folder", tmp_path / "folder")
    again = import_folder(tmp_path / "folder/shots.csv", tmp_path / "again")
    rows = []
    for path in (tmp_path / "textured.h5", again):
        with ShotScorer(path, ("akaze",)) as scorer:
            rows.append([scorer.score(i)[0].row for i in (0, 3)])
    for before, after in zip(*rows, strict=True):
        assert before["status"] == "ok"
        for name, value in before.items():
            if isinstance(value, str):
                assert after[name] == value
            elif not name.startswith("time_"):
                assert after[name] == pytest.approx(value, abs=1e-9), name


def test_what_a_set_does_not_say_is_not_made_up(folder: Path) -> None:
    csv_path = folder / "shots.csv"
    without_columns(
        csv_path, "mask", "cov_", "time_s", "exposure_s", "gain_db", "nominal", "pixel_format"
    )
    (folder / "references.csv").unlink()
    told: list[str] = []
    live = PlainLive(sys.stderr)
    live.announce = told.append  # pyright: ignore[reportAttributeAccessIssue]
    path = import_folder(csv_path, folder.parent / "again", live=live)
    assert told[0].startswith("no reference views: cores that need them cannot be scored")
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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", r"camera\.json:1: not JSON"),
        ("[1]", "is no camera: expected an object of width_px"),
        ('{"width_px": 64}', "missing or unknown: cx_px, cy_px, distortion"),
        ("ZERO", "focal lengths and image size must be above 0"),
        ("NAN", "a number is not finite"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(folder: Path, text: str, message: str) -> None:
    camera = (folder / "camera.json").read_text()
    made = {"ZERO": camera.replace("48.2", "0"), "NAN": camera.replace("48.2", "NaN")}
    (folder / "camera.json").write_text(made.get(text, text))
    with pytest.raises(CalibrationError, match=message):
        import_folder(folder / "shots.csv", folder.parent / "again")


def test_truth_of_an_import_cannot_be_computed_again(folder: Path) -> None:
    path = import_folder(folder / "shots.csv", folder.parent / "again")
    with Dataset(path) as dataset:
        assert dataset.provenance.calibration_json == "{}"
    assert callable(recompute_truth)


def test_a_rig_gives_ranges_masks_and_reference_views(tmp_path: Path) -> None:
    rig_path = write_twin_rig(tmp_path)
    rig = load_rig(rig_path)
    camera = CameraModel(32, 24, 30.0, 30.0, 15.5, 11.5)
    down = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    poses = [
        RigidTransform.from_matrix(np.block([[down, np.c_[[1.0, 2.0, z_m]]], [np.eye(4)[3:]]]))
        for z_m in (3.0, 2.5)
    ]
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
            assert shot.truth.range_los_m == pytest.approx(range_los_m(finder, pose))
            assert is_equal(shot.mask, model_mask(heightmap, camera, pose))
            assert 0.1 < shot.truth.usable_fraction < 1.0
    assert "2 of 2 images have a pose" in read_journal(path)[1].text
    away = [pose * RigidTransform.from_matrix(np.diag([1.0, -1, -1, 1])) for pose in poses]
    _write_tum(tmp_path, camera, away)
    with pytest.raises(DatasetError, match=r"rgb\.txt:1: shot 1: its optical axis misses the terr"):
        import_tum(*arguments, tmp_path / "other", rig_path=rig_path)


def _write_tum(folder: Path, camera: CameraModel, poses: list[RigidTransform]) -> None:
    import json

    from PIL import Image

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
