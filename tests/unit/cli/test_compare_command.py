"""The command ``tronlab compare``."""

import numpy as np
import pandas as pd
import pytest
import typer
from scipy.spatial.transform import RigidTransform
from typer.testing import CliRunner

from tronlab.cli.compare import compare
from tronlab.cli.exit_codes import REGRESSION
from tronlab.dataset.records import Truth
from tronlab.errors import ScoreError
from tronlab.nav.core import NavigationResult
from tronlab.report import comparison as comparison_module
from tronlab.score.rescoring.shot import CoreScore
from tronlab.score.results import save_results
from tronlab.score.table import ShotFacts, score_row


def run(*arguments):
    app = typer.Typer()
    app.command()(compare)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def scored(tmp_path):
    """The factory ``scored(name, {core: factor}, n_lost=0)``: a folder with errors times factor."""

    def score(name, cores, n_lost=0):
        folder = tmp_path / name
        folder.mkdir()
        scores = []
        errors_m = np.random.default_rng(6).lognormal(-7.0, 0.4, 30)
        for core, factor in cores.items():
            for shot_id, error_m in enumerate(errors_m):
                pose = RigidTransform.from_translation([0.0, 0.0, 4.0 - 0.1 * shot_id])
                truth = Truth(pose, np.eye(6) * 1e-9, 4.0 - 0.1 * shot_id, 0.9)
                shift = RigidTransform.from_translation([factor * error_m, 0.0, 0.0])
                result = NavigationResult("ok", shift * pose)
                if shot_id < n_lost:
                    result = NavigationResult("no_pose", reason="dim")
                row = score_row(core, 0, ShotFacts(shot_id, truth, "good"), result)
                scores.append(CoreScore(core, shot_id, row, result))
        info = {"dataset": "x.h5", "cores": list(cores), "software": {}, "scored_utc": ""}
        save_results(folder, scores, info)
        return folder

    return score


def test_a_regression_has_exit_code_1_and_says_what_is_worse(scored):
    before, after = (
        scored("before", {"akaze": 1.0, "brisk": 1.0}),
        scored("after", {"akaze": 1.0, "brisk": 1.3}),
    )
    result = run(before, after, "--tolerance", "10%")
    assert result.exit_code == REGRESSION, result.output
    worse = [line for line in result.stdout.splitlines() if line.startswith("worse: ")]
    assert [line.split(": ")[1] for line in worse] == ["brisk"] * 2
    assert "of 30 shots 0 better, 30 same, 0 worse" in result.stdout
    assert run(before, after, "--tolerance", "60%").exit_code == 0
    assert run(after, before).exit_code == 0
    assert run(before, after, "--core", "akaze").exit_code == 0
    alone = run(before, scored("alone", {"akaze": 1.0}))
    assert alone.exit_code == 0
    assert alone.stderr == (f"not compared, there is nothing to pair it with: brisk of {before}\n")


def test_a_lost_pose_is_a_regression(scored):
    result = run(scored("before", {"a": 1.0}), scored("after", {"a": 0.5}, n_lost=2))
    assert result.exit_code == REGRESSION
    assert "poses: 28 of 30, were 30" in result.stdout
    assert "solved by the base only 2" in result.stdout


def test_cores_of_one_folder(scored):
    result = run(scored("one", {"akaze": 2.0, "brisk": 1.0, "mine": 1.0}))
    assert result.exit_code == 0, result.output
    assert "akaze to brisk: position_error_pct_los" in result.stdout
    assert "Holm" in result.stdout
    assert "nothing is worse than the base" in result.stdout


def test_tables_and_a_picture_a_pair_go_to_a_folder(scored, tmp_path):
    folder, out = scored("one", {"akaze": 2.0, "<b>": 1.0}), tmp_path / "new" / "out"
    result = run(folder, "--out", out, "--tables", "csv,json")
    assert result.exit_code == 0, result.output
    stem = "difference_01_position_error_pct_los_akaze__b_"
    assert {path.name for path in out.iterdir()} == {
        *(f"{name}.{kind}" for name in ("comparison", "differences") for kind in ("csv", "json")),
        f"{stem}.png",
        f"{stem}.pdf",
    }
    row = pd.read_csv(out / "comparison.csv").iloc[0]
    differences = pd.read_csv(out / "differences.csv")
    assert row["mean_difference"] == pytest.approx(differences["difference"].mean())
    assert row["mean_difference_low"] < row["mean_difference"] < row["mean_difference_high"] < 0
    assert (row["n_better"], row["worse_than_allowed"]) == (30, "no")
    assert len(differences) == 30


def test_the_picture_of_runs_with_nothing_in_common_says_so(scored, tmp_path, monkeypatch):
    folder = scored("one", {"akaze": 1.0})
    drawn = []
    monkeypatch.setattr(comparison_module, "save_chart", lambda figure, *_: drawn.append(figure))
    blind = scored("blind", {"akaze": 1.0}, n_lost=30)
    result = run(blind, folder, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "no shot was solved by both" in result.stdout
    assert [text.get_text() for text in drawn[0].axes[0].texts] == ["no shot was solved by both"]


def test_mistakes_are_told_before_anything_is_written(scored, tmp_path):
    folder = scored("one", {"akaze": 1.0})
    for arguments, message in (
        ([folder, folder, "--tolerance", "much"], "tolerance 'much'"),
        ([folder, folder, "--metric", "n_inliers"], "metric 'n_inliers'"),
        ([folder, folder, "--core", "x"], "no scores of x"),
        ([folder], "nothing to compare"),
        ([folder, tmp_path / "none"], "no scores.csv there"),
    ):
        result = run(*arguments, "--out", tmp_path / "out")
        assert isinstance(result.exception, ScoreError)
        assert message in str(result.exception)
    assert not (tmp_path / "out").exists()
