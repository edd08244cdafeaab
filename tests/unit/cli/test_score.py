"""The command ``tronlab score``."""

from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from tronlab.cli.score import score
from tronlab.nav import cores as nav_cores
from tronlab.nav.core import NavigationResult


class RaisingCore:
    name = "raiser"

    def __init__(self, context: object) -> None:
        pass

    def locate(self, image: np.ndarray, mask: np.ndarray) -> NavigationResult:
        raise ValueError("boom")


class RaisingCorePoint(EntryPoint):
    def load(self) -> type[RaisingCore]:
        return RaisingCore


@pytest.mark.opencv
def test_says_which_cores_stay_and_why_one_has_no_pose(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = [RaisingCorePoint(n, "here:x", nav_cores.ENTRY_POINT_GROUP) for n in ("raiser", "b")]
    monkeypatch.setattr(nav_cores, "entry_points", lambda group: points)
    app = typer.Typer()
    app.command()(score)
    arguments = [str(small_dataset), "--workers", "1", "--core"]
    CliRunner().invoke(app, [*arguments, "b"])
    result = CliRunner().invoke(app, [*arguments, "raiser"])
    assert result.exit_code == 0, result.output
    table = result.stdout.splitlines()
    assert [line.split()[-1] for line in table[1:3]] == ["0/5", "0/5"]
    assert table[4:6] == [
        f"{core}: 5 of 5 shots without a pose; first: shot 0, error: ValueError: boom"
        for core in ("b", "raiser")
    ]
    assert "scores.csv: of the earlier scoring: kept b\n" in result.stderr
