"""The commands as a person types them: exit codes, and what goes to stdout and stderr."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from command import tronlab

EditYaml = Callable[..., None]


def test_run_prints_the_dataset_and_a_second_run_changes_nothing(
    campaign_path: Path, tmp_path: Path
) -> None:
    first = tronlab("run", campaign_path, cwd=tmp_path)
    assert (first.returncode, first.stdout) == (0, "out/small/dataset.h5\n"), first.stderr
    assert "shots: 5 of 5" in first.stderr
    dataset = tmp_path / "out/small/dataset.h5"
    before = dataset.read_bytes()
    second = tronlab("run", campaign_path, cwd=tmp_path)
    assert second.returncode == 2
    assert second.stderr.startswith("error: --out out/small: exists and is not empty")
    assert dataset.read_bytes() == before


def test_bad_campaign_is_one_message_and_exit_code_2(campaign_path: Path, tmp_path: Path) -> None:
    text = campaign_path.read_text()
    campaign_path.write_text(text.replace("exposure_s", "exposure_ms"))
    line = text[: text.index("exposure_s")].count("\n") + 1
    answer = tronlab("run", campaign_path, cwd=tmp_path)
    assert answer.returncode == 2
    assert answer.stdout == ""
    assert answer.stderr.splitlines() == [
        f"error: {campaign_path}:{line - 1}: camera.exposure_s: required key is missing",
        f"{campaign_path}:{line}: camera.exposure_ms: unknown key, did you mean exposure_s"
        " (in seconds)?",
    ]


@pytest.mark.opencv
def test_demo_runs_scores_and_reports(
    campaign_path: Path,
    rig_path: Path,
    make_record: Callable[[Path], Path],
    edit_yaml: EditYaml,
    tmp_path: Path,
) -> None:
    for key, value in {
        "sensor_width_px": 384,
        "sensor_height_px": 256,
        "left_px": 64,
        "width_px": 256,
        "height_px": 256,
        "pixel_pitch_m": 2.5e-5,
    }.items():
        edit_yaml(rig_path, f"laboratory.camera.{key}", value)
    edit_yaml(rig_path, "terrain.spacing_m", 0.005)
    make_record(rig_path)
    (tmp_path / "campaigns").mkdir()
    for path in (campaign_path, rig_path, tmp_path / "record.json"):
        shutil.copy(path, tmp_path / "campaigns" / path.name)
    (tmp_path / "campaigns/campaign.yaml").rename(tmp_path / "campaigns/straight_line.yaml")
    answer = tronlab("demo", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    for name in ("dataset.h5", "scores.csv", "summary.json", "report.html", "figures", "tables"):
        assert (tmp_path / "out/demo" / name).exists(), name
    lines = answer.stdout.splitlines()
    assert [line.split()[0] for line in lines[1:5]] == [
        "akaze",
        "brisk",
        "akaze-refined",
        "brisk-refined",
    ]
    assert all(line.endswith("/5") for line in lines[1:5])
    assert lines[-1] == "report: out/demo/report.html"
