"""The computational load is measured case by case, each in a process of its own."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from plane_dataset import write_plane_dataset
from scipy.spatial.transform import RigidTransform
from small_study import write_small_study

from tronlab.campaign.live import SilentLive
from tronlab.dataset.reader import Dataset
from tronlab.errors import ConfigError, ScoreError
from tronlab.nav.database import Landmarks, landmarks_of_view
from tronlab.nav.database_writer import new_database
from tronlab.nav.features import make_detector
from tronlab.nav.settings import DetectorSettings
from tronlab.study import load, load_landmarks
from tronlab.study.config import LoadConfig
from tronlab.study.load import LoadCase, cases_of, job_of, load_steps, measured
from tronlab.study.load_landmarks import Part
from tronlab.study.load_process import LoadFigures, LoadJob, measure
from tronlab.study.steps import Desk
from tronlab.study.study import Study, load_study

CONFIG = LoadConfig.model_validate(
    {"cores": ["brisk"], "image_px": [160], "n_features": [60], "n_landmarks": [300, 700]}
    | {"n_images": 2}
)


def study_in(folder: Path) -> Study:
    """Give a study of which nothing but the calibration record is there yet."""
    study = load_study(write_small_study(folder))
    study = replace(study, config=study.config.model_copy(update={"load": CONFIG}))
    record = study.record_path("dataset_1_nominal", folder / "out")
    record.parent.mkdir(parents=True)
    record.write_text((folder / "record.json").read_text())
    return study


def test_all_cases_are_measured_and_one_that_was_killed_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study, out = study_in(tmp_path), tmp_path / "out"
    jobs: list[LoadJob] = []

    def pretend(job: LoadJob) -> LoadFigures:
        assert job.database.is_file()
        with np.load(job.frames) as frames:
            shapes = {frames[f"{what}_{i}"].shape for what in ("image", "mask") for i in range(2)}
            assert len(shapes) == 1
            assert json.loads(str(frames["camera"]))["width_px"] == shapes.pop()[1]
            assert frames["image_1"].max() > 150
        if len(jobs) == 2:
            raise KeyboardInterrupt
        jobs.append(job)
        return LoadFigures(
            start_s=1, time_detect_s=2, time_match_s=3, time_pose_s=4, time_all_s=10,
            peak_memory_mb=None, start_memory_mb=None, n_features=5, n_landmarks=6,
            error_pct_los=None, n_solved=0,
        )  # fmt: skip

    monkeypatch.setattr(load, "measured", pretend)
    monkeypatch.setattr(load_landmarks, "LANDMARKS_A_VIEW", 300)
    (step,) = load_steps(study)
    with pytest.raises(KeyboardInterrupt):
        step.run(Desk(out, 1, SilentLive()))
    assert not (out / "load/load.csv").exists()
    jobs.append(jobs[-1])
    step.run(Desk(out, 1, SilentLive(), is_begun=True))
    assert len(jobs) == 5  # two before, one of no meaning, two after
    table = pd.read_csv(out / "load/load.csv")
    cases = list(cases_of(CONFIG, image_px=64))
    assert table["varied"].tolist() == [case.varied for case in cases]
    assert table["value"].tolist() == [160, 60, 300, 700]
    assert table["time_all_s"].tolist() == [10] * 4
    assert table["peak_memory_mb"].isna().all()
    assert json.loads((out / "load/machine.json").read_text())["threads"] == 1
    assert sorted(path.name for path in (out / "load").iterdir()) == ["load.csv", "machine.json"]


def test_one_quantity_is_varied_at_a_time() -> None:
    cases = list(cases_of(CONFIG, image_px=1024))
    assert cases == [
        LoadCase("image", 160, "brisk", 160),
        LoadCase("features", 60, "brisk", 1024, n_features=60),
        LoadCase("landmarks", 300, "brisk", 1024, n_landmarks=300),
        LoadCase("landmarks", 700, "brisk", 1024, n_landmarks=700),
    ]
    jobs = [job_of(case, Path("scene"), n_images=1) for case in cases]
    assert len({job.database.name for job in jobs}) == 4
    assert jobs[1].settings["detector"]["n_max"] == 60


@pytest.mark.parametrize("n", [10, 100, 250, 900])
def test_every_view_of_the_approach_serves_small_databases_too(n: int) -> None:
    def parts(*sizes: int) -> list[Part]:
        return [
            (
                RigidTransform.identity(),
                Landmarks(np.zeros((m, 3)), np.arange(m, dtype=float), np.zeros((m, 2), np.uint8)),
            )
            for m in sizes
        ]

    chosen = load_landmarks.so_many(parts(100, 50), parts(300, 900), n)
    total = sum(len(found) for _, found in chosen)
    assert n <= total <= n + 1
    assert all(len(found) for _, found in chosen)
    shares = [len(found) / size for (_, found), size in zip(chosen, (100, 50), strict=False)]
    assert len(shares) == 2
    assert shares == pytest.approx([min(1.0, n / 150)] * 2, abs=0.02)
    assert all((np.diff(found.size_m) == 1).all() and found.size_m[0] == 0 for _, found in chosen)


def test_a_process_that_fails_says_why(tmp_path: Path) -> None:
    job = LoadJob(
        core="brisk", database=tmp_path / "none.h5", settings={}, frames=tmp_path / "none.npz",
        n_images=1,
    )  # fmt: skip
    with pytest.raises(ScoreError, match=r"load of brisk.*code 1.*none\.npz"):
        measured(job)


def test_cores_of_others_have_no_stages_to_measure(tmp_path: Path) -> None:
    study = load_study(write_small_study(tmp_path, with_record=False))
    config = CONFIG.model_copy(update={"cores": ("brisk", "cmd:./mine")})
    study = replace(study, config=study.config.model_copy(update={"load": config}))
    with pytest.raises(ConfigError, match=r"load\.cores.*no built-in core 'cmd:\./mine'"):
        load_steps(study)


def test_a_core_is_measured_on_images_whose_pose_is_known(tmp_path: Path) -> None:
    write_plane_dataset(tmp_path / "dataset.h5")
    settings = DetectorSettings(features="brisk")
    shots = (2, 5)
    with Dataset(tmp_path / "dataset.h5") as dataset:
        frames: dict[str, Any] = {"camera": json.dumps(dataset.camera.to_dict())}
        for i, shot in enumerate(shots):
            frames |= {f"image_{i}": dataset.image(shot), f"mask_{i}": dataset.mask(shot)}
            frames[f"pose_{i}"] = dataset.truth(shot).trs_from_cam.as_matrix()
            frames[f"range_m_{i}"] = dataset.truth(shot).range_los_m
        np.savez(tmp_path / "frames.npz", **frames)
        with new_database(tmp_path / "landmarks.h5", settings) as writer:
            for i in range(dataset.n_references):
                view = dataset.reference(i)
                found = landmarks_of_view(view, dataset.camera, make_detector(settings))
                writer.add(view.trs_from_cam, found, source=0)
    job = LoadJob(
        core="brisk-refined",
        database=tmp_path / "landmarks.h5",
        settings={"detector": {"n_max": 300}},
        frames=tmp_path / "frames.npz",
        n_images=2,
    )
    figures = measure(job)
    assert figures.n_solved == 2
    assert figures.error_pct_los is not None
    assert figures.error_pct_los < 0.3
    assert figures.n_features == 300
    assert figures.n_landmarks == writer.n_landmarks
    stages_s = figures.time_detect_s + figures.time_match_s + figures.time_pose_s
    assert 0 < stages_s <= 2 * figures.time_all_s
    if figures.peak_memory_mb is not None and figures.start_memory_mb is not None:
        assert figures.peak_memory_mb >= figures.start_memory_mb > 10
