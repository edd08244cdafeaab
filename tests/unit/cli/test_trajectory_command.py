"""``tronlab trajectory`` as a person meets it, on a small terrain."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import typer
from ruamel.yaml import YAML
from typer.testing import CliRunner, Result

from tronlab.cli.trajectory import trajectory
from tronlab.trajectory.poses import read_poses

RIG = Path(__file__).parents[3] / "campaigns/rigs/twin.yaml"
LINE = "{kind: straight_line, start_trs_m: [1, 2, 4], end_trs_m: [1, 2, 1], n_points: 61}"
DESCENT = (
    "{kind: powered_descent, landing_point_trs_m: [0.95, 2.3, 0], perturbed: {n: 1, seed: 1},"
    " sampling: {spacing_m: 0.42, height_m: [0.5, 5.4]}}"
)

app = typer.Typer()
app.command()(trajectory)


@pytest.fixture
def campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """The factory ``campaign(trajectory)`` of campaign files, in a folder of their own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    yaml = YAML()
    rig: dict[str, Any] = yaml.load(RIG.read_text(encoding="utf-8"))
    rig["terrain"].update(spacing_m=0.01)
    with (tmp_path / "rig.yaml").open("w", encoding="utf-8") as file:
        yaml.dump(rig, file)

    def make(section: str) -> Path:
        path = tmp_path / "campaign.yaml"
        path.write_text(
            "name: small\nrig: rig.yaml\ncalibration: not_needed.json\n"
            f"trajectory: {section}\ncamera: {{exposure_s: 0.02}}\n",
            encoding="utf-8",
        )
        return path

    return make


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_line_is_told_written_and_drawn(campaign: Callable[[str], Path], tmp_path: Path) -> None:
    result = run(campaign(LINE), "--out", "poses.csv", "--plot")
    assert result.exit_code == 0, result.output
    assert "61 points, X 1.000 to 1.000, Y 2.000 to 2.000, Z 1.000 to 4.000 m of trs" in (
        result.stdout
    )
    assert len(read_poses(tmp_path / "poses.csv")) == 61
    assert {path.name for path in tmp_path.glob("poses-*")} == {
        "poses-trajectory.png",
        "poses-trajectory.pdf",
    }


def test_descents_are_told_written_and_drawn(
    campaign: Callable[[str], Path], tmp_path: Path
) -> None:
    pytest.importorskip("clarabel")
    result = run(campaign(DESCENT), "--out", "flown.h5", "--plot")
    assert result.exit_code == 0, result.output
    table = [line.split() for line in result.stdout.splitlines()[:3]]
    assert [row[0] for row in table] == ["trajectory", "nominal", "1"]
    n_points = int(table[2][-2])
    assert f"{n_points} points of 1 trajectory; the nominal one is not flown" in result.stdout
    with h5py.File("flown.h5") as file:
        flown: Any = file["trajectory_1"]
        assert flown["trs_from_cam"].shape == (n_points, 7)
        np.testing.assert_allclose(flown["position_m"][-1], 0.0, atol=1e-3)
        assert flown.attrs["flight_time_s"] == pytest.approx(float(table[2][1]), abs=0.05)
    for picture in ("flown-trajectory.png", "flown-states.png", "flown-states.pdf"):
        assert (tmp_path / picture).stat().st_size > 5000


def test_nothing_is_written_over(campaign: Callable[[str], Path], tmp_path: Path) -> None:
    (tmp_path / "poses.csv").write_text("mine")
    result = run(campaign(LINE), "--out", "poses.csv")
    assert "exists already, nothing is overwritten" in str(result.exception)
    assert (tmp_path / "poses.csv").read_text() == "mine"


def test_interrupt_is_told_and_leaves_nothing(
    campaign: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tronlab.trajectory.descent.land", interrupted)
    result = run(campaign(DESCENT), "--out", "poses.csv")
    assert result.exit_code == 130
    assert "interrupted: no poses were written" in result.output
    assert not list(tmp_path.glob("poses*"))
