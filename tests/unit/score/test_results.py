"""The files of a scoring: exact, whole or as they were."""

import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tronlab.errors import ScoreError
from tronlab.nav.core import NavigationResult
from tronlab.score import results as results_module
from tronlab.score.rescoring.shot import CoreScore
from tronlab.score.results import load_results, save_results
from tronlab.score.table import COLUMNS


def score_of(core: str, shot_id: int, value: float = 0.1) -> CoreScore:
    row = {name: value if kind == "float64" else 0 for name, kind in COLUMNS.items()}
    row |= {"core": core, "shot_id": shot_id, "status": "ok", "truth_state": "good"}
    uv = np.full((shot_id + 1, 2), 3.5)
    return CoreScore(core, shot_id, row, NavigationResult("no_pose", reason="dim", uv_inliers=uv))


def info_of(*cores: str) -> dict[str, object]:
    return {
        "dataset": "dataset.h5",
        "cores": list(cores),
        "scored_utc": "2026-01-01T00:00:00+00:00",
        "software": {"tronlab": "1"},
    }


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_no_digit_changes_on_the_way(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=300) * 10.0 ** rng.integers(-12, 6, 300)
    values[7] = np.nan
    save_results(tmp_path, [score_of("a", i, v) for i, v in enumerate(values)], info_of("a"))
    np.testing.assert_array_equal(load_results(tmp_path).scores["range_los_m"], values)


def test_inliers_of_a_core_that_stays_are_copied(tmp_path: Path) -> None:
    save_results(tmp_path, [score_of("a", 0), score_of("a", 1)], info_of("a"))
    earlier = load_results(tmp_path)
    save_results(tmp_path, [score_of("b", 0), score_of("b", 1)], info_of("b"), earlier=earlier)
    results = load_results(tmp_path)
    assert results.cores == ("a", "b")
    np.testing.assert_array_equal(results.uv_inliers("a", 1), np.full((2, 2), 3.5))
    assert results.reasons["a", 0, 1] == "dim"


def drop_column(folder: Path, name: str) -> None:
    """Leave a table as another version would have written it."""
    table, info_path = folder / "scores.csv", folder / "score.json"
    pd.read_csv(table).drop(columns=name).to_csv(table, index=False)
    info = json.loads(info_path.read_text())
    info_path.write_text(json.dumps({**info, "sha256": {}}))


def test_scores_from_before_there_were_drift_checks_have_an_unchecked_truth(tmp_path: Path) -> None:
    save_results(tmp_path, [score_of("a", 0)], info_of("a"))
    drop_column(tmp_path, "truth_state")
    earlier = load_results(tmp_path)
    save_results(tmp_path, [score_of("b", 0)], info_of("b"), earlier=earlier)
    assert load_results(tmp_path).scores["truth_state"].tolist() == ["unchecked", "good"]
    drop_column(tmp_path, "status")
    with pytest.raises(ScoreError, match="columns are missing: status"):
        load_results(tmp_path)


@pytest.mark.parametrize("step", ["copy_matches", "_sha256"])
def test_what_cannot_be_written_whole_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    save_results(tmp_path, [score_of("a", 0)], info_of("a"))
    earlier, before = load_results(tmp_path), contents(tmp_path)

    def disk_full(*_arguments: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(results_module, step, disk_full)
    with pytest.raises(ScoreError, match="the scores cannot be written: no space left"):
        save_results(tmp_path, [score_of("b", 0)], info_of("b"), earlier=earlier)
    assert contents(tmp_path) == before


def test_rows_of_a_scoring_cut_short_are_named_and_later_removed(tmp_path: Path) -> None:
    partial = results_module.save_partial(tmp_path, [score_of("a", 0)])
    with pytest.raises(ScoreError, match=r"no scores\.csv there, only scores\.partial\.csv of a"):
        load_results(tmp_path)
    save_results(tmp_path, [score_of("a", 0)], info_of("a"))
    assert not partial.exists()
    assert sorted(os.listdir(tmp_path)) == [
        "matches.h5",
        "score.json",
        "scores.csv",
        "summary.json",
    ]
