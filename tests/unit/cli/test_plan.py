"""``tronlab plan`` as a person meets it, on a small twin."""

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from perfect_record import save_perfect_record
from planned import planned, small_stage
from ruamel.yaml import YAML

from tronlab.campaign.foresight import Foresight
from tronlab.cli.app import main

RIGS = Path(__file__).parents[3] / "campaigns/rigs"
HEADER = "x,y,z,qx,qy,qz,qw\n"
LOOKING_IN = "0.70710678,0.70710678,0,0\n"


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the twin's rig file in few pixels, and a record without errors."""
    folder = tmp_path_factory.mktemp("laboratory")
    yaml = YAML()
    rig: dict[str, Any] = yaml.load((RIGS / "twin.yaml").read_text(encoding="utf-8"))
    few = {"sensor_width_px": 64, "sensor_height_px": 64, "left_px": 0, "pixel_pitch_m": 1e-4}
    rig["laboratory"]["camera"].update(few, width_px=64, height_px=64)
    rig["terrain"].update(spacing_m=0.01)
    rig["world"]["lens"]["principal_point_sigma_px"] = 1.0
    with (folder / "rig.yaml").open("w", encoding="utf-8") as file:
        yaml.dump(rig, file)
    save_perfect_record(folder / "record.json", rig_path=folder / "rig.yaml")
    return folder


@pytest.fixture
def campaign(laboratory: Path, tmp_path: Path) -> Callable[..., Path]:
    """The factory ``campaign(*heights_m, more="...")`` of campaign files."""

    def make(*heights_m: float, more: str = "", y_m: float = 2.08) -> Path:
        lines = (f"1.08,{y_m},{height_m},{LOOKING_IN}" for height_m in heights_m)
        (tmp_path / "poses.csv").write_text(HEADER + "".join(lines), encoding="utf-8")
        path = tmp_path / "campaign.yaml"
        path.write_text(
            f"name: small\nrig: {laboratory}/rig.yaml\ncalibration: {laboratory}/record.json\n"
            "trajectory: {kind: file, path: poses.csv}\ncamera: {exposure_s: 0.02}\n"
            f"database: {{n_views: 1}}\n{more}",
            encoding="utf-8",
        )
        return path

    return make


@pytest.fixture
def tronlab(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """``tronlab(*arguments)`` gives exit code, stdout and stderr of the command line."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["tronlab", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        return int(ended.value.code or 0), captured.out, captured.err

    return run


def test_a_plan_without_fault_can_run(campaign, tronlab, tmp_path):
    out = tmp_path / "report"
    code, printed, told = tronlab("plan", campaign(3.0, 2.0), "--out", out, "--no-pictures")
    assert code == 0, told
    assert printed.startswith("plan: 2 shots, none refused\n")
    assert "The campaign can run.\n" in printed
    assert printed.endswith(f"report: {out / 'index.html'}\n")
    assert "no device is connected, nothing moves" in told
    assert "plan: 2 of 2" in told
    document = json.loads((out / "plan.json").read_text(encoding="utf-8"))
    assert document["can_run"] is True
    assert document["facts"]["rig"].startswith("twin (")
    assert [shot["is_refused"] for shot in document["shots"]] == [False, False]


def test_out_of_reach_is_refused_with_reason_and_what_could_be_done(campaign, tronlab, tmp_path):
    arguments = ("--out", tmp_path / "report", "--no-pictures")
    code, printed, told = tronlab("plan", campaign(3.0, 7.0), *arguments)
    assert code == 1, told
    assert "1 refused" in printed
    assert re.search(r"refused: shot 2: robot: .*rail", printed)
    assert "nearest pose that can be taken: " in printed
    assert "The campaign cannot run: change the refused shots" in printed


@pytest.fixture
def foreseen(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is foreseen is the hand-made plan of 6 shots, 2 of them refused."""
    context = small_stage().context
    monkeypatch.setattr(
        "tronlab.campaign.foresight.foresee",
        lambda *_args, **_kwargs: Foresight(planned(), context),
    )


@pytest.mark.usefixtures("foreseen")
def test_refused_shots_are_left_out_if_the_campaign_wants_it(campaign, tronlab, tmp_path):
    path = campaign(3.0, more="plan: {on_refused: skip}\n")
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "plan.json").touch()
    code, printed, _ = tronlab("plan", path, "--out", tmp_path / "report", "--no-pictures")
    assert code == 0
    assert printed.endswith(f"report: {tmp_path}/report/index.html, the earlier one was replaced\n")
    assert "can run without the 2 refused shots, 4 are left (plan.on_refused: skip)" in printed


@pytest.mark.usefixtures("foreseen")
def test_json_alone_goes_to_stdout(campaign, tronlab, tmp_path):
    out = tmp_path / "report"
    code, printed, _ = tronlab("plan", campaign(3.0), "--out", out, "--json", "--no-pictures")
    assert code == 1
    assert json.loads(printed)["n_refused"] == 2
    assert printed == (out / "plan.json").read_text(encoding="utf-8")


def test_a_typo_is_told_with_line_and_key(campaign, tronlab, tmp_path):
    path = campaign(3.0, more="plan: {min_usable_fracton: 0.3}\n")
    code, printed, told = tronlab("plan", path, "--out", tmp_path / "report")
    assert (code, printed) == (2, "")
    assert f"{path}:7: plan.min_usable_fracton" in told
    assert "min_usable_fraction" in told.partition("plan.min_usable_fracton")[2]
    assert not (tmp_path / "report").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--rig", "nowhere.yaml"], "nowhere.yaml: no such file"),
        (["--calibration", "nowhere.json"], "nowhere.json: no such file"),
        (["--out", "taken"], "--out taken: holds other files than a plan's"),
        (["--out", "taken/dataset.h5"], "is a file, expected a folder"),
        (["--out", "taken/dataset.h5/deeper"], "is no folder that can be written to"),
    ],
)
def test_mistakes_are_told_before_anything_is_done(
    campaign, tronlab, tmp_path, monkeypatch, arguments, says
):
    path = campaign(3.0)
    monkeypatch.chdir(tmp_path)
    Path("taken").mkdir()
    Path("taken/dataset.h5").touch()
    code, printed, told = tronlab("plan", path, *arguments)
    assert (code, printed) == (2, "")
    assert told.startswith("error: ")
    assert says in told


def test_a_folder_that_cannot_be_written_is_told(campaign, tronlab, tmp_path, monkeypatch):
    path = campaign(3.0)
    # By its permissions root could write anywhere.
    monkeypatch.setattr("os.access", lambda _path, mode, **_kwargs: mode != os.W_OK)
    code, _, told = tronlab("plan", path, "--out", tmp_path / "report")
    assert code == 2
    assert "is no folder that can be written to; name another folder with --out" in told


def test_ctrl_c_leaves_no_report(campaign, tronlab, tmp_path, monkeypatch):
    def interrupted(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("tronlab.campaign.foresight.foresee", interrupted)
    code, printed, told = tronlab("plan", campaign(3.0), "--out", tmp_path / "report")
    assert (code, printed) == (130, "")
    assert told.endswith("interrupted: no report was written\n")
    assert not (tmp_path / "report").exists()
