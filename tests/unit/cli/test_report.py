"""The command ``tronlab report``."""

import pytest
import typer
from scipy.spatial.transform import RigidTransform
from typer.testing import CliRunner

from tronlab.cli.report import report
from tronlab.dataset.reader import Dataset
from tronlab.errors import ScoreError
from tronlab.nav.core import NavigationResult
from tronlab.report.build import ReportSettings
from tronlab.report.evaluation import EvaluationSettings
from tronlab.score.evaluation.recall import Threshold
from tronlab.score.rescoring.shot import CoreScore
from tronlab.score.results import save_results
from tronlab.score.table import score_row, shot_facts


def run(*arguments):
    app = typer.Typer()
    app.command()(report)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def scored(small_dataset):
    """A folder with the scores of a core that has a pose for the first shots, then none."""
    scores = []
    with Dataset(small_dataset) as dataset:
        for facts in (shot_facts(dataset, i) for i in range(dataset.n_shots)):
            if facts.shot_id < 3:
                result = NavigationResult("ok", RigidTransform.from_translation([1.1, 2.1, 4.01]))
            else:
                result = NavigationResult("no_pose", reason="too dark")
            row = score_row("fixed", 0, facts, result)
            scores.append(CoreScore("fixed", facts.shot_id, row, result))
    info = {"dataset": "dataset.h5", "cores": ["fixed"], "software": {}, "scored_utc": ""}
    save_results(small_dataset.parent, scores, info)
    return small_dataset.parent


def test_prints_the_table_and_where_the_page_is(scored, monkeypatch):
    chosen = []

    def build(directory, *, settings, announce):
        chosen.append(settings)
        announce("report without pictures: no such file")
        return directory / "report.html"

    monkeypatch.setattr("tronlab.report.build.build_report", build)
    options = ("--tables", "json", "--recall", "1,2", "--bins", "range_los_m=1,2")
    result = run(scored, *options)
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert (lines[1].split()[0], lines[1].split()[-1]) == ("fixed", "3/5")
    assert lines[-1] == f"report: {scored / 'report.html'}"
    assert result.stderr == "report without pictures: no such file\n"
    evaluation = EvaluationSettings((Threshold(1.0, 2.0),), {"range_los_m": (1.0, 2.0)})
    assert chosen == [ReportSettings(("json",), evaluation)]


def test_folder_without_scores(tmp_path):
    result = run(tmp_path)
    assert isinstance(result.exception, ScoreError)
    assert "tronlab score" in str(result.exception)


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--tables", "csv,doc", "'doc': is not known"),
        ("--recall", "1", "recall threshold '1': must be two numbers"),
        ("--recall", "0,1", "recall threshold '0,1': must be two numbers"),
        ("--bins", "height=1,2", "must be COLUMN=EDGE,EDGE"),
        ("--bins", "phase_deg=2,1", "the edges must be numbers that rise"),
    ],
)
def test_odd_options_are_refused_before_anything_is_read(tmp_path, option, value, message):
    assert message in str(run(tmp_path / "none", option, value).exception)
