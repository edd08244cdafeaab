"""The command ``tronlab report``."""

from importlib.metadata import EntryPoint

import numpy as np
import pytest
import typer
from scipy.spatial.transform import RigidTransform
from typer.testing import CliRunner

from tronlab.cli.report import report
from tronlab.errors import ScoreError
from tronlab.nav import cores as nav_cores
from tronlab.nav.core import NavigationResult
from tronlab.score.rescore import score_dataset


def run(*arguments):
    app = typer.Typer()
    app.command()(report)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


class FixedCore:
    """Has a pose for the first shots, then none."""

    name = "fixed"

    def __init__(self, context):
        self.n_left = 3

    def locate(self, image, mask):
        self.n_left -= 1
        if self.n_left < 0:
            return NavigationResult("no_pose", reason="too dark")
        pose = RigidTransform.from_translation([1.1, 2.1, 4.01])
        return NavigationResult("ok", pose, uv_inliers=np.array([[20.0, 12.0]]))


class FixedCorePoint(EntryPoint):
    def load(self):
        return FixedCore


@pytest.fixture
def scored(small_dataset, monkeypatch):
    point = FixedCorePoint("fixed", "here:FixedCore", nav_cores.ENTRY_POINT_GROUP)
    monkeypatch.setattr(nav_cores, "entry_points", lambda group: [point])
    score_dataset(small_dataset, cores=["fixed"], workers=1)
    return small_dataset.parent


@pytest.mark.opencv
def test_prints_the_table_and_where_the_page_is(scored):
    result = run(scored)
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert (lines[1].split()[0], lines[1].split()[-1]) == ("fixed", "3/5")
    assert lines[-1] == f"report: {scored / 'report.html'}"
    assert result.stderr == ""
    page = (scored / "report.html").read_text(encoding="utf-8")
    assert "too dark" in page
    assert (scored / "figures" / "contact_sheet.jpg").is_file()


@pytest.mark.opencv
def test_announcements_go_to_stderr(scored, monkeypatch):
    def build(directory, *, announce):
        announce("report without pictures: no such file")
        return directory / "report.html"

    monkeypatch.setattr("tronlab.report.build.build_report", build)
    result = run(scored)
    assert result.stderr == "report without pictures: no such file\n"
    assert "without pictures" not in result.stdout


def test_folder_without_scores(tmp_path):
    result = run(tmp_path)
    assert isinstance(result.exception, ScoreError)
    assert "tronlab score" in str(result.exception)
