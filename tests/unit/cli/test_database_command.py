"""``tronlab database`` as a person meets it."""

import json
import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.campaign.reference import render_references
from tronlab.campaign.rendering import Scene
from tronlab.cli.app import main
from tronlab.cli.database_views import N_SAMPLED, render_views
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Provenance, ReferenceView, ShotRecord
from tronlab.dataset.writer import DatasetWriter
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_from_xyz_quat, xyz_quat_from_pose
from tronlab.nav.core import NavigationResult
from tronlab.nav.database import Landmarks, find_landmarks
from tronlab.nav.database_file import Source, open_database, read_database_file
from tronlab.nav.database_writer import new_database
from tronlab.nav.settings import DetectorSettings
from tronlab.render.renderer import Lamp, Rendering
from tronlab.render.settings import RenderedImages
from tronlab.score.rescoring.shot import CoreScore
from tronlab.score.results import save_results
from tronlab.score.table import score_row, shot_facts
from tronlab.terrain.heightmap import HeightMap

Tronlab = Callable[..., tuple[int, str, str]]
CAMERA = CameraModel(240, 200, 180.0, 180.0, 119.0, 99.0)
DOWN = np.diag([1.0, -1.0, -1.0])
N_GOOD, N_IDLE, N_AWAY = 60, 30, 10


@pytest.fixture
def tronlab(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Tronlab:
    """``tronlab(*arguments)`` gives exit code, stdout and stderr of ``tronlab database``."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["tronlab", "database", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        return int(ended.value.code or 0), captured.out, captured.err

    return run


def looking_down(x_m: float, y_m: float, z_m: float) -> RigidTransform:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = DOWN, (x_m, y_m, z_m)
    return RigidTransform.from_matrix(matrix)


def textured_view(i: int) -> ReferenceView:
    noise = np.random.default_rng([3, i]).normal(size=CAMERA.shape).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 3.0)
    image = np.clip(120 + 300 * smooth, 0, 255).astype(np.uint8)
    depth = np.full(CAMERA.shape, 2.0, np.float32)
    return ReferenceView(i, looking_down(0.1 * i, 0, 2), image, depth, np.ones(CAMERA.shape, bool))


@pytest.fixture
def write_dataset(
    make_provenance: Callable[..., Provenance], make_shot: Callable[..., ShotRecord]
) -> Callable[..., Path]:
    """``write_dataset(path, view numbers)``: reference views, and a shot because it needs one."""

    def write(path: Path, views: Sequence[int]) -> Path:
        with DatasetWriter(path, replace(make_provenance(5), camera=CAMERA)) as writer:
            writer.add_references([textured_view(i) for i in views])
            shot = make_shot(0)
            image = np.zeros(CAMERA.shape, np.uint8)
            writer.commit(
                replace(
                    shot,
                    frame=replace(shot.frame, image=image),
                    mask=image == 0,
                    truth=replace(shot.truth, usable_fraction=1.0),
                )
            )
            writer.finish("aborted", "for the test")
        return path

    return write


@pytest.mark.opencv
def test_a_file_built_from_datasets_has_the_landmarks_of_their_views(
    tronlab: Tronlab, write_dataset: Callable[..., Path]
) -> None:
    first, second = write_dataset(Path("a.h5"), [0, 1]), write_dataset(Path("b.h5"), [2])
    options = ("--features", "brisk", "--threshold", "20", "--n-max", "150")
    code, out, err = tronlab("build", first, second, *options, "--out", "db.h5")
    assert code == 0, err
    settings = DetectorSettings(features="brisk", threshold=20, n_max=150)
    expected = find_landmarks([textured_view(i) for i in range(3)], CAMERA, settings)
    assert len(expected) > 100
    assert open_database(Path("db.h5")).digest == expected.digest
    assert f"db.h5: {len(expected)} landmarks from 3 views" in out
    assert "views: 3 of 3" in err
    file = read_database_file(Path("db.h5"))
    assert [source.name for source in file.about.sources] == ["a.h5", "b.h5"]
    assert file.view_sources.tolist() == [0, 0, 1]


def test_what_cannot_be_built_is_one_clear_error_and_leaves_nothing(
    tronlab: Tronlab, write_dataset: Callable[..., Path], empty_dataset: Path
) -> None:
    dataset = write_dataset(Path("a.h5"), [0])
    Path("there.h5").write_text("mine")
    before = {path: path.stat().st_size for path in Path().iterdir()}
    for arguments, text in (
        ((dataset, "--out", "there.h5"), "there.h5: exists already"),
        ((dataset, "--views", 5), "no CAMPAIGN.yaml is named"),
        (("c.yaml", "--views", 5, "--poses", "p.csv"), "--poses and --views: say one of the two"),
        (("c.yaml", "--views", 5, "--range", "1-5"), "--range 1-5: must be NEAREST:FARTHEST"),
        (("c.yaml",), "c.yaml: no such file"),
        ((empty_dataset,), "has no reference views to find landmarks in; name its campaign"),
        ((dataset, "--threshold", -1), "detector.threshold: must be greater than 0, got -1"),
        ((dataset, "--threshold", 100), "akaze: 1 reference views give 0 landmarks"),
        (("nothing.h5",), "nothing.h5: no such file"),
    ):
        has_out = "--out" in arguments
        code, _, err = tronlab("build", *arguments, *(() if has_out else ("--out", "db.h5")))
        assert (code, text in err) == (2, True), err
        assert "Traceback" not in err
    assert {path: path.stat().st_size for path in Path().iterdir()} == before


def test_ctrl_c_leaves_nothing(
    tronlab: Tronlab, write_dataset: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> Landmarks:
        raise KeyboardInterrupt

    dataset = write_dataset(Path("a.h5"), [0])
    monkeypatch.setattr("tronlab.nav.database.landmarks_of_view", interrupt)
    before = set(Path().iterdir())
    code, _, err = tronlab("build", dataset, "--out", "db.h5")
    assert code == 130
    assert "interrupted: nothing is left of db.h5" in err
    assert set(Path().iterdir()) == before


class FakeRenderer:
    """Counts what it renders; each view is as bright as it is high."""

    def __init__(self) -> None:
        self.n_rendered = 0

    def render(self, *_: Any) -> Rendering:
        raise NotImplementedError

    def render_batch(
        self, camera: CameraModel, poses: Sequence[RigidTransform], *_: Any
    ) -> Iterator[Rendering]:
        for pose in poses:
            self.n_rendered += 1
            bright = np.linspace(0.5, 1.0, camera.width_px * camera.height_px)
            radiance = (bright.reshape(camera.shape) * pose.translation[2]).astype(np.float32)
            depth_m = np.full(camera.shape, pose.translation[2], np.float32)
            yield Rendering(radiance, depth_m, np.zeros((1, 1, 3), np.float32), radiance > 0)


@pytest.mark.parametrize("n_views", [3, N_SAMPLED + 5])
def test_views_are_rendered_once_each_as_a_run_renders_them(n_views: int) -> None:
    heightmap = HeightMap(np.zeros((3, 3), np.float32), 1.0, np.zeros(3))
    poses = {i: looking_down(1, 1, 1 + 0.1 * i) for i in range(1, n_views + 1)}
    renderer, camera = FakeRenderer(), CAMERA.scaled(24)
    lamp, config = Lamp(np.array([0.0, 0.0, 3.0]), 1.0), RenderedImages(rays_per_pixel=4)
    scene = Scene("database", renderer, "fake", camera, poses, lamp, config)
    told: list[tuple[int, int]] = []
    views = list(render_views(scene, heightmap, on_sample=lambda *done: told.append(done)))
    assert renderer.n_rendered == n_views
    assert told[-1] == (min(n_views, N_SAMPLED),) * 2
    asked = render_references(
        list(poses.values()),
        heightmap=heightmap, renderer=renderer, camera=camera, lamp=lamp, config=config,
    )  # fmt: skip
    for view, expected in zip(views, asked, strict=True):
        assert view.view_id == expected.view_id
        as_stored = pose_from_xyz_quat(xyz_quat_from_pose(expected.trs_from_cam))
        np.testing.assert_array_equal(view.trs_from_cam.as_matrix(), as_stored.as_matrix())
        np.testing.assert_array_equal(view.depth_m, expected.depth_m)
        np.testing.assert_array_equal(view.mask, expected.mask)
        # The grey scale is the same if all views are in the sample, and nearly so otherwise.
        np.testing.assert_allclose(
            view.image, expected.image, atol=0 if n_views <= N_SAMPLED else 12
        )


@pytest.fixture
def database_path(tmp_path: Path) -> Path:
    """100 landmarks seen from 4 m: 60 that verify, 30 that never do, 10 beside every image."""
    rng = np.random.default_rng(8)
    n = N_GOOD + N_IDLE + N_AWAY
    places = np.column_stack([rng.uniform([0.6, 1.4], [1.6, 2.8], (n, 2)), np.zeros(n)])
    places[-N_AWAY:, 0] += 4.0
    path = tmp_path / "db.h5"
    with new_database(path, DetectorSettings()) as writer:
        writer.sources.append(
            Source(kind="campaign", name="c.yaml", identity="c", camera=CAMERA.to_dict(), rig="r")
        )
        writer.add(
            looking_down(1.1, 2.1, 4.0),
            Landmarks(places, np.full(n, 0.5), rng.integers(0, 256, (n, 61), np.uint8)),
            source=0,
        )
    return path


def save_scores(folder: Path, dataset_path: Path, answers: Sequence[NavigationResult]) -> Path:
    """A core called ``a`` answered so to each shot."""
    folder.mkdir()
    with Dataset(dataset_path) as dataset:
        scores = [
            CoreScore("a", i, score_row("a", 0, shot_facts(dataset, i), result), result)
            for i, result in enumerate(answers)
        ]
    info = {
        "dataset": os.path.relpath(dataset_path, folder),
        "cores": ["a"],
        "software": {},
        "scored_utc": "2026-01-01T00:00:00+00:00",
    }
    save_results(folder, scores, info)
    return folder


@pytest.fixture
def answers(
    small_dataset: Path, database_path: Path, make_shot: Callable[..., ShotRecord]
) -> list[NavigationResult]:
    """Right poses but for shot 3, each on another ten of those that verify."""
    digest = open_database(database_path).digest
    results: list[NavigationResult] = []
    for i in range(5):
        truth = make_shot(i).truth.trs_from_cam
        wrong = RigidTransform.from_translation([0.5 if i == 3 else 0.0, 0, 0]) * truth
        inliers = np.arange(N_GOOD) if i < 3 else np.arange(len(open_database(database_path)))
        if i == 4:
            inliers = np.arange(5)
        results.append(
            NavigationResult(
                "ok",
                wrong,
                n_inliers=len(inliers),
                uv_inliers=np.zeros((len(inliers), 2)),
                landmark_inliers=inliers,
                database=digest,
            )
        )
    return results


def test_pruning_keeps_what_verified_in_right_poses_and_what_nobody_could_see(
    tronlab: Tronlab, small_dataset: Path, database_path: Path, answers: list[NavigationResult]
) -> None:
    folder = save_scores(Path("scores"), small_dataset, answers)
    code, out, err = tronlab("prune", "db.h5", "--verified-by", folder, "--out", "less.h5")
    assert code == 0, err
    assert "less.h5: 70 of 100 landmarks; left out: 30 never or seldom verified, 0 there" in out
    assert "4 shots with a right pose" in err
    before, after = read_database_file(database_path), read_database_file(Path("less.h5"))
    chosen = [*range(N_GOOD), *range(N_GOOD + N_IDLE, 100)]
    np.testing.assert_array_equal(after.database.p_trs_m, before.database.p_trs_m[chosen])
    assert after.counts is not None
    assert after.counts.n_verified.tolist() == [4] * 5 + [3] * (N_GOOD - 5) + [0] * N_AWAY
    assert after.counts.n_offered.tolist() == [4] * N_GOOD + [0] * N_AWAY
    with Dataset(small_dataset) as dataset:
        assert after.database.pruned_by == (dataset.uuid,)
    assert after.about.prunings[0].from_digest == before.database.digest
    code, out, _ = tronlab("info", "less.h5")
    assert re.search("verified +60 of 60 that were offered, 60 more than once", out)
    assert re.search("pruning 1 +100 to 70 landmarks by 1 datasets", out)


def test_scores_that_say_nothing_of_the_database_are_refused(
    tronlab: Tronlab, small_dataset: Path, database_path: Path, answers: list[NavigationResult]
) -> None:
    for name, changes, text in (
        ("others", {"database": "0123456789abcdef"}, "the cores used 0123456789ab: score again"),
        ("poseless", {"status": "no_pose", "trs_from_cam": None}, "no pose there is right"),
        ("beyond", {"landmark_inliers": np.array([100])}, "names landmarks that the database"),
    ):
        folder = save_scores(
            Path(name), small_dataset, [replace(answer, **changes) for answer in answers]
        )
        code, _, err = tronlab("prune", "db.h5", "--verified-by", folder, "--out", "less.h5")
        assert (code, text in err) == (2, True), err
    code, _, err = tronlab("prune", "db.h5", "--verified-by", "nowhere", "--out", "less.h5")
    assert (code, "no scores.csv there" in err) == (2, True), err
    assert not Path("less.h5").exists()


def test_info_tells_numbers_as_text_and_json_and_draws_them(
    tronlab: Tronlab, database_path: Path
) -> None:
    code, out, err = tronlab("info", "db.h5", "--plot", "db.png")
    assert code == 0, err
    assert re.search("landmarks +100 in 1 views", out)
    assert re.search(r"source 1 +campaign c.yaml \(rig r\)", out)
    picture = cv2.imread("db.png")
    assert picture is not None
    assert picture.std() > 10
    code, out, _ = tronlab("info", "db.h5", "--json")
    measured = json.loads(out)
    places = open_database(database_path).p_trs_m
    np.testing.assert_allclose(measured["high_trs_m"], places.max(axis=0))
    assert measured["descriptor_bits"] == 488
    assert measured["verified"] is None
    code, _, err = tronlab("info", "db.h5", "--plot", "db.gif")
    assert (code, "the picture is a PNG" in err) == (2, True), err
    content = bytearray(database_path.read_bytes())
    content[5000] ^= 1
    database_path.write_bytes(content)
    code, _, err = tronlab("info", "db.h5")
    assert (code, "is damaged" in err) == (2, True), err
