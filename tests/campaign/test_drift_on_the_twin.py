"""Trackers that are pushed, records that are too old: what a campaign does, and what it says."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from recorder import Recorder
from typer.testing import CliRunner

from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.run import run_campaign
from tronlab.cli.app import app
from tronlab.dataset.reader import Dataset
from tronlab.dataset.validate import examine, validate
from tronlab.errors import CalibrationError

EditYaml = Callable[..., None]
N_REFLECTORS = 3


def push_tracker(edit_yaml: EditYaml, rig_path: Path, *, at_check: int) -> None:
    """Move the tracker by 3 mm while it measures the first reflector of a drift check, from 1."""
    fault: dict[str, Any] = {
        "device": "tracker",
        "call": "measure_point",
        "at": 1 + N_REFLECTORS * (at_check - 1),
        "error": "moved",
        "moved_m": [0.002, -0.001, 0.002],
    }
    edit_yaml(rig_path, "world.faults", [fault])


def test_a_tracker_moved_before_the_run_is_found_before_anything_moves(
    campaign_path: Path, rig_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    push_tracker(edit_yaml, rig_path, at_check=1)
    with pytest.raises(
        CalibrationError,
        match=r"drift check at the start: the tracker moved .*\n"
        r"measure the frame anew: tronlab calibrate frame --rig \S+rig.yaml --record \S+.json\n"
        r".*--accept-calibration",
    ):
        run_campaign(campaign_path, out_dir=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_drift_within_the_run_stops_it_and_flags_its_shots(
    campaign_path: Path, rig_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    edit_yaml(campaign_path, "drift", {"every_n_shots": 2})
    push_tracker(edit_yaml, rig_path, at_check=3)
    with pytest.raises(CalibrationError, match=r"after 4 shots: the tracker moved .* suspect;\n"):
        run_campaign(campaign_path, out_dir=tmp_path / "out")
    path = tmp_path / "out" / "dataset.h5"
    with Dataset(path) as dataset:
        assert (dataset.status, dataset.n_shots) == ("failed", 4)
        assert dataset.reason.startswith("drift check after 4 shots, attempt 1: drift check after")
        assert dataset.truth_states == ("good", "good", "suspect", "suspect")
        last = dataset.drift_checks[-1]
        assert last.max_shift_m == pytest.approx(0.003, abs=3e-4)
    assert any(
        finding.startswith("truth of shots 3-4 is suspect") for finding in examine(path).notes
    )


def test_a_campaign_may_go_on_when_something_moves(
    campaign_path: Path, rig_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    edit_yaml(campaign_path, "drift", {"every_n_shots": 2, "on_drift": "continue"})
    push_tracker(edit_yaml, rig_path, at_check=3)
    live = Recorder()
    path = run_campaign(campaign_path, out_dir=tmp_path / "out", live=live)
    with Dataset(path) as dataset:
        assert dataset.status == "complete"
        assert [check.n_shots_before for check in dataset.drift_checks] == [0, 2, 4, 5]
        assert dataset.truth_states == ("good", "good", "suspect", "suspect", "suspect")
    assert sum("shots since the last good check are suspect" in text for text in live.texts) == 2


def test_drift_at_the_end_is_told_and_leaves_the_recording_complete(
    campaign_path: Path, rig_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    push_tracker(edit_yaml, rig_path, at_check=2)
    live = Recorder()
    path = run_campaign(campaign_path, out_dir=tmp_path / "out", live=live)
    with Dataset(path) as dataset:
        assert dataset.status == "complete"
        assert set(dataset.truth_states) == {"suspect"}
    assert any(text.startswith("drift check after 5 shots: the tracker") for text in live.texts)


def test_an_expired_record_of_another_rig_serves_only_if_accepted_and_the_dataset_says_so(
    campaign_path: Path, rig_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    path = tmp_path / "record.json"
    record = CalibrationRecord.load(path)
    camera = replace(record.devices["camera"], serial="other")
    replace(record, valid_days=1.0, devices={**record.devices, "camera": camera}).save(path)
    with pytest.raises(CalibrationError, match=r"expired at 2026-01-03 .*\n.*\n.*--accept-calib"):
        run_campaign(campaign_path, out_dir=tmp_path / "out")
    edit_yaml(rig_path, "name", "other")
    push_tracker(edit_yaml, rig_path, at_check=1)
    arguments = ["run", str(campaign_path), "--out", str(tmp_path / "out"), "--accept-calibration"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    with Dataset(tmp_path / "out" / "dataset.h5") as dataset:
        accepted = dataset.provenance.accepted
        assert set(dataset.truth_states) == {"suspect"}
    expected = ("of another rig", "expired at", "of other devices", "drift check at the start")
    assert len(accepted) == len(expected)
    for part, line in zip(expected, accepted, strict=True):
        assert part in line
        assert f"accepted: {line}" in result.stderr.splitlines()


def test_a_campaign_without_drift_checks_vouches_for_nothing(
    campaign_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    edit_yaml(campaign_path, "drift", None)
    live = Recorder()
    path = run_campaign(campaign_path, out_dir=tmp_path / "out", live=live)
    assert "drift checks: none, so the truth of no shot is vouched for" in live.texts
    with Dataset(path) as dataset:
        assert set(dataset.truth_states) == {"unchecked"}
    assert validate(path) == []
