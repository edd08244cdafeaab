"""A campaign from its YAML to a dataset, on a small simulated laboratory."""

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recorder import Recorder

from tronlab.campaign.run import CampaignInterrupted, run_campaign
from tronlab.campaign.stop import StopRequest
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import ShotRecord
from tronlab.dataset.validate import validate
from tronlab.errors import (
    CalibrationError,
    ConfigError,
    DatasetError,
    DeviceFaultError,
    PlanError,
    TrackingLostError,
)

MAIN = "from tronlab.cli import main; main()"
EditYaml = Callable[..., None]


def test_complete_run_is_valid_and_its_truth_is_right(campaign_path: Path, tmp_path: Path) -> None:
    live = Recorder()
    path = run_campaign(campaign_path, out_dir=tmp_path / "out", live=live)
    assert path == tmp_path / "out" / "dataset.h5"
    assert validate(path) == []
    with Dataset(path) as dataset:
        assert dataset.status == "complete"
        assert list(dataset.shot_ids) == [1, 2, 3, 4, 5]
        assert [view.view_id for view in dataset.references()] == [1, 2]
        provenance = dataset.provenance
        assert provenance.campaign_yaml == campaign_path.read_text()
        assert provenance.seed == 3
        assert {"tronlab", "python", "numpy", "opencv"} <= set(provenance.software)
        assert provenance.devices["robot"].startswith("KUKA KR 16")
        heights = [dataset.truth(i).trs_from_cam.translation[2] for i in range(5)]
        np.testing.assert_allclose(heights, [3.0, 2.75, 2.5, 2.25, 2.0], atol=0.03)
        for i in range(5):
            truth = dataset.truth(i)
            assert truth.range_los_m == pytest.approx(truth.trs_from_cam.translation[2], abs=0.2)
            assert truth.usable_fraction == dataset.mask(i).mean()
            assert dataset.image(i)[dataset.mask(i)].mean() > 20
    assert ("shots", 5, 5) in live.progress
    assert ("reference views", 2, 2) in live.progress
    assert live.texts[-2] == f"5 of 5 shots are in {path}"
    assert re.fullmatch(
        r"truth, one sigma: 0\.0\d\d mm and 0\.01\d\d deg at 1\.9\d m in the nearest shot,"
        r" 0\.0\d\d mm and 0\.01\d\d deg at 2\.9\d m in the farthest",
        live.texts[-1],
    )


def test_same_seed_gives_same_images_and_another_seed_others(
    campaign_path: Path, tmp_path: Path
) -> None:
    paths = [
        run_campaign(campaign_path, out_dir=tmp_path / name, seed=seed)
        for name, seed in (("a", 7), ("b", 7), ("c", 8))
    ]
    images = []
    for path in paths:
        with Dataset(path) as dataset:
            images.append(np.stack([dataset.image(i) for i in range(dataset.n_shots)]))
    np.testing.assert_array_equal(images[0], images[1])
    assert (images[0] != images[2]).any()


def test_runs_outside_the_main_thread(campaign_path: Path, tmp_path: Path) -> None:
    results: list[Path] = []
    thread = threading.Thread(
        target=lambda: results.append(run_campaign(campaign_path, out_dir=tmp_path / "out"))
    )
    thread.start()
    thread.join(timeout=120)
    with Dataset(results[0]) as dataset:
        assert dataset.status == "complete"


def test_second_run_into_the_same_folder_is_refused(campaign_path: Path, tmp_path: Path) -> None:
    path = run_campaign(campaign_path, out_dir=tmp_path / "out")
    before = path.read_bytes()
    with pytest.raises(ConfigError, match=r"out: exists and is not empty.*another folder.*--out"):
        run_campaign(campaign_path, out_dir=tmp_path / "out")
    assert path.read_bytes() == before


def test_out_must_not_be_a_file(campaign_path: Path) -> None:
    with pytest.raises(ConfigError, match="is a file, expected a folder"):
        run_campaign(campaign_path, out_dir=campaign_path)


def test_lost_tracking_is_retried_and_the_attempt_is_recorded(
    campaign_path: Path,
    rig_path: Path,
    make_record: Callable[[Path], Path],
    edit_yaml: EditYaml,
    tmp_path: Path,
) -> None:
    fault = {"device": "tracker", "call": "measure_pose", "at": 7, "error": "tracking_lost"}
    edit_yaml(rig_path, "world.faults", [fault])
    make_record(rig_path)
    live = Recorder()
    path = run_campaign(campaign_path, out_dir=tmp_path / "out", live=live)
    with Dataset(path) as dataset:
        assert dataset.status == "complete"
        assert [dataset.shot(i).attempt for i in range(5)] == [1, 2, 1, 1, 1]
    assert any(text.startswith("shot 2, attempt 1: tracker: ") for text in live.texts)


def test_tracking_lost_for_good_fails_the_run_but_keeps_its_shots(
    campaign_path: Path, rig_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    fault = {
        "device": "tracker",
        "call": "measure_pose",
        "at": 9,
        "times": 1000,
        "error": "tracking_lost",
    }
    edit_yaml(rig_path, "world.faults", [fault])
    edit_yaml(campaign_path, "retry", {"on_failure": "stop"})
    edit_yaml(campaign_path, "suspend", {"timeout_s": 60.0})
    with pytest.raises(TrackingLostError, match="tracker"):
        run_campaign(campaign_path, out_dir=tmp_path / "out")
    with Dataset(tmp_path / "out" / "dataset.h5") as dataset:
        assert dataset.status == "failed"
        assert list(dataset.shot_ids) == [1, 2]


def test_device_fault_stops_the_run_without_retry(
    campaign_path: Path,
    rig_path: Path,
    edit_yaml: EditYaml,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    fault = {"device": "robot", "call": "move", "at": 4, "error": "fault"}
    edit_yaml(rig_path, "world.faults", [fault])
    live = Recorder()
    with pytest.raises(DeviceFaultError, match="robot"):
        run_campaign(campaign_path, out_dir=tmp_path / "out", live=live)
    path = tmp_path / "out" / "dataset.h5"
    with Dataset(path) as dataset:
        assert dataset.status == "failed"
        assert list(dataset.shot_ids) == [1, 2, 3]
        assert dataset.reason.startswith("shot 4, attempt 1: robot: ")
    assert live.texts[-1].startswith(
        f"the run failed at shot 4, attempt 1; 3 of 5 shots are in {path}; when the cause is"
    )
    assert "Traceback" not in capfd.readouterr().err


def test_calibration_of_another_rig_is_refused(
    campaign_path: Path, rig_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    edit_yaml(rig_path, "name", "other")
    with pytest.raises(CalibrationError, match=r"another rig: it was made on 'twin'.*'other'"):
        run_campaign(campaign_path, out_dir=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_calibration_of_other_devices_is_refused(
    campaign_path: Path, rig_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    edit_yaml(rig_path, "world.seed", 99)
    with pytest.raises(CalibrationError, match="other devices"):
        run_campaign(campaign_path, out_dir=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_calibration_of_another_image_size_is_refused(
    campaign_path: Path, rig_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    edit_yaml(rig_path, "laboratory.camera.width_px", 62)
    with pytest.raises(CalibrationError, match=r"images of 64 x 64 pixels.*reads out 62 x 64"):
        run_campaign(campaign_path, out_dir=tmp_path / "out")


def test_unreachable_shots_are_all_listed_before_anything_moves(
    campaign_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    edit_yaml(campaign_path, "trajectory.start_trs_m", [1.08, 2.08, 6.0])
    edit_yaml(campaign_path, "trajectory.n_points", 3)
    with pytest.raises(PlanError, match=r"1 of 3 shots cannot be taken:\n  shot 1: robot: "):
        run_campaign(campaign_path, out_dir=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_more_views_than_poses_are_refused(
    campaign_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    edit_yaml(campaign_path, "database.n_views", 6)
    with pytest.raises(ConfigError, match=r"campaign.yaml:\d+: database.n_views: .* only 5 poses"):
        run_campaign(campaign_path, out_dir=tmp_path / "out")


def test_overriding_files_need_not_be_named_rightly_in_the_campaign(
    campaign_path: Path, rig_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    edit_yaml(campaign_path, "rig", "gone.yaml")
    edit_yaml(campaign_path, "calibration", "gone.json")
    path = run_campaign(
        campaign_path,
        rig_path=rig_path,
        calibration_path=tmp_path / "record.json",
        out_dir=tmp_path / "out",
    )
    assert path.is_file()


def test_write_error_stops_the_run(
    campaign_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tronlab.dataset.writer import DatasetWriter

    commit = DatasetWriter.commit

    def commit_or_fail(self: DatasetWriter, shot: ShotRecord, replaces: bool = False) -> None:
        if self.n_committed == 2:
            raise DatasetError("disk full")
        commit(self, shot, replaces)

    monkeypatch.setattr(DatasetWriter, "commit", commit_or_fail)
    with pytest.raises(DatasetError, match="disk full"):
        run_campaign(campaign_path, out_dir=tmp_path / "out")
    with Dataset(tmp_path / "out" / "dataset.h5") as dataset:
        assert dataset.status == "failed"
        assert dataset.n_shots == 2


def test_stop_request_ends_the_run_after_the_shot(campaign_path: Path, tmp_path: Path) -> None:
    stop = StopRequest()

    def ask_at_shot_2(stage: str, n_done: int) -> None:
        if (stage, n_done) == ("shots", 2):
            stop.ask()

    with pytest.raises(CampaignInterrupted, match="2 of 5 shots are in"):
        run_campaign(
            campaign_path, out_dir=tmp_path / "out", live=Recorder(ask_at_shot_2), stop=stop
        )
    with Dataset(tmp_path / "out" / "dataset.h5") as dataset:
        assert dataset.status == "aborted"
        assert dataset.n_shots == 2


def _start(campaign_path: Path, out: Path) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-c", MAIN, "run", str(campaign_path), "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )


def _wait_for_line(process: "subprocess.Popen[str]", start: str) -> list[str]:
    assert process.stderr is not None
    lines: list[str] = []
    for line in process.stderr:
        lines.append(line)
        if line.startswith(start):
            return lines
    raise AssertionError(f"no line '{start}' in {lines}")


def test_ctrl_c_stops_in_good_order_with_exit_code_130(
    campaign_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    edit_yaml(campaign_path, "trajectory.n_points", 120)
    process = _start(campaign_path, tmp_path / "out")
    _wait_for_line(process, "shots: ")
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130, stderr
    path = tmp_path / "out" / "dataset.h5"
    with Dataset(path) as dataset:
        assert dataset.status == "aborted"
        assert 12 <= dataset.n_shots < 120
        assert f"stopped: {dataset.n_shots} of 120 shots are in {path}" in stderr
    assert "Traceback" not in stderr
