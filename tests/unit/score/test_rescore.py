"""Scoring a whole dataset: order, files, plug-ins that fail, interruption, bad input."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import h5py
import numpy as np
import pandas as pd
import pytest
from plane_dataset import N_SHOTS

from tronlab.dataset import schema
from tronlab.dataset.records import DriftRecord, Provenance, ReferenceView, ShotRecord
from tronlab.dataset.writer import DatasetWriter
from tronlab.errors import DatasetError, ScoreError
from tronlab.nav.cores import BUILT_IN_CORES
from tronlab.score.rescore import campaign_cores, score_dataset
from tronlab.score.rescoring.cache import AnswerCache
from tronlab.score.results import load_results
from tronlab.score.table import COLUMNS


@pytest.fixture
def scored(small_dataset: Path, fakes: ModuleType) -> Path:
    score_dataset(small_dataset, cores=["shift"], workers=1)
    return small_dataset.parent


def test_shots_whose_truth_is_in_doubt_are_told_and_flagged(
    tmp_path: Path,
    fakes: ModuleType,
    make_shot: Callable[..., ShotRecord],
    make_drift: Callable[..., DriftRecord],
    make_provenance: Callable[..., Provenance],
    make_view: Callable[[int], ReferenceView],
) -> None:
    path = tmp_path / "drift.h5"
    with DatasetWriter(path, make_provenance(5)) as writer:
        writer.add_references([make_view(0)])
        writer.plan_drift_checks(tuple(make_drift(0).readings), 3)
        writer.commit_drift(make_drift(0))
        for i in range(5):
            writer.commit(make_shot(i))
            if i in {1, 3}:
                writer.commit_drift(make_drift(i + 1, is_within=i == 1))
        writer.finish("complete")
    said: list[str] = []
    table = score_dataset(path, cores=["shift"], workers=1, announce=said.append)
    assert table["truth_state"].tolist() == ["good", "good", *["suspect"] * 3]
    assert any("truth of shots 2-4 is suspect" in text for text in said)


def test_every_shot_keeps_its_row(scored: Path) -> None:
    table = pd.read_csv(scored / "scores.csv")
    assert table["status"].tolist() == ["ok", "error", "no_pose", "error", "error"]
    assert table["shot_id"].tolist() == [0, 1, 2, 3, 4]
    assert table.loc[1:, "position_error_m"].isna().all()
    assert table["range_los_m"].notna().all()
    assert table.loc[2, "n_features"] == 7
    row = table.iloc[0]
    assert row["error_trs_z_m"] == pytest.approx(-0.01)
    assert row["position_error_pct_los"] == pytest.approx(100 * row["position_error_m"] / 4.0)


def test_summary_counts_all_and_knows_the_reasons(scored: Path) -> None:
    summary = json.loads((scored / "summary.json").read_text())
    assert list(summary) == ["shift"]
    assert (summary["shift"]["n_shots"], summary["shift"]["n_ok"]) == (5, 1)
    results = load_results(scored)
    assert results.reasons["shift", 0, 1] == "LinAlgError: Singular matrix"
    assert results.reasons["shift", 0, 2] == "too dark"
    assert "without a pose" in results.reasons["shift", 0, 3]
    assert "NoneType" in results.reasons["shift", 0, 4]
    np.testing.assert_array_equal(results.uv_inliers("shift", 0), [[1, 2], [3, 4]])
    assert results.uv_inliers("shift", 1).shape == (0, 2)
    assert results.dataset_path == (scored / "dataset.h5").resolve()
    assert results.scores["status"].tolist()[0] == "ok"


def test_interruption_keeps_rows_and_the_old_scores(scored: Path, fakes: ModuleType) -> None:
    before = (scored / "scores.csv").read_bytes()
    with pytest.raises(KeyboardInterrupt, match=r"1 of 5 answers.*scores\.partial\.csv"):
        score_dataset(scored / "dataset.h5", cores=["interrupted"], workers=1)
    assert (scored / "scores.csv").read_bytes() == before
    partial = pd.read_csv(scored / "scores.partial.csv")
    assert partial["shot_id"].tolist() == [0]
    said: list[str] = []
    score_dataset(scored / "dataset.h5", cores=["shift"], workers=1, announce=said.append)
    assert not (scored / "scores.partial.csv").exists()
    assert any("replaced" in text for text in said)
    assert not [p for p in scored.iterdir() if p.name.startswith(".score")]


def lines_of(folder: Path, core: str) -> list[str]:
    lines = (folder / "scores.csv").read_text().splitlines()
    return [line for line in lines if line.startswith(f"{core},")]


def test_cores_that_are_not_scored_anew_stay(scored: Path) -> None:
    said: list[str] = []

    def score(*cores: str) -> pd.DataFrame:
        return score_dataset(scored / "dataset.h5", cores=cores, workers=1, announce=said.append)

    first, before = load_results(scored), lines_of(scored, "shift")
    table = score("too-dark")
    assert table["core"].tolist() == ["shift"] * 5 + ["too-dark"] * 5
    assert lines_of(scored, "shift") == before
    results = load_results(scored)
    assert results.cores == tuple(results.summary) == ("shift", "too-dark")
    assert results.summary["shift"] == first.summary["shift"]
    assert results.reasons["shift", 0, 1] == "LinAlgError: Singular matrix"
    np.testing.assert_array_equal(results.uv_inliers("shift", 0), [[1, 2], [3, 4]])
    assert results.kept == {"shift": {"scored_utc": first.scored_utc, "software": first.software}}
    with h5py.File(scored / "matches.h5") as file:
        assert dict(file["shift/0/0/trs_from_cam"].attrs)["parent"] == "trs"
    assert said.pop() == f"{scored / 'scores.csv'}: of the earlier scoring: kept shift"

    kept = lines_of(scored, "too-dark")
    table = score("third", "shift")
    assert table["core"].tolist() == ["shift"] * 5 + ["too-dark"] * 5 + ["third"] * 5
    assert lines_of(scored, "too-dark") == kept
    assert said.pop().endswith(": kept too-dark; replaced shift")
    results = load_results(scored)
    assert list(results.kept) == ["too-dark"]
    assert results.kept["too-dark"]["software"] == results.software
    pd.testing.assert_frame_equal(results.scores, table, check_exact=True)


def test_another_core_scored_meanwhile_stays(scored: Path) -> None:
    dataset = scored / "dataset.h5"

    def score_another(n_done: int, _n_all: int) -> None:
        if n_done == 2:
            score_dataset(dataset, cores=["third"], workers=1)

    table = score_dataset(dataset, cores=["too-dark"], workers=1, progress=score_another)
    assert table["core"].unique().tolist() == ["shift", "third", "too-dark"]


def test_results_of_another_dataset_are_not_overwritten(scored: Path, tmp_path: Path) -> None:
    dataset, before = scored / "dataset.h5", (scored / "scores.csv").read_bytes()
    other = tmp_path / "other.h5"
    shutil.copy(dataset, other)
    with pytest.raises(ScoreError, match=r"another dataset, .*dataset\.h5; .*other\.h5 with --out"):
        score_dataset(other, cores=["shift"], workers=1, out_dir=scored)
    with h5py.File(dataset, "a") as file:
        ranges_m = file[f"{schema.TRUTH}/range_los_m"]
        assert isinstance(ranges_m, h5py.Dataset)
        ranges_m[2] = ranges_m[2] + 1e-6
    with pytest.raises(ScoreError, match=r"holds scores of .* when it had other shots; .*--out"):
        score_dataset(dataset, cores=["shift"], workers=1)
    (scored / "score.json").unlink()
    with pytest.raises(ScoreError, match=r"score\.json does not say of which dataset; .*--out"):
        score_dataset(dataset, cores=["shift"], workers=1)
    assert (scored / "scores.csv").read_bytes() == before


def test_damaged_results_are_replaced_only_if_nothing_is_lost(scored: Path) -> None:
    said: list[str] = []
    (scored / "matches.h5").write_bytes(b"")
    with pytest.raises(ScoreError, match=r"damaged, those of shift would be lost.*matches\.h5"):
        score_dataset(scored / "dataset.h5", cores=["too-dark"], workers=1)
    score_dataset(scored / "dataset.h5", cores=["shift"], workers=1, announce=said.append)
    assert "are damaged and will be replaced" in said[0]
    assert load_results(scored).cores == ("shift",)


def test_results_beyond_a_link_are_those_of_the_same_dataset(scored: Path, tmp_path: Path) -> None:
    (tmp_path / "far" / "away").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "far" / "away")
    for core in ("shift", "third"):
        score_dataset(scored / "dataset.h5", cores=[core], workers=1, out_dir=tmp_path / "link")
    results = load_results(tmp_path / "link")
    assert results.cores == ("shift", "third")
    assert results.dataset_path == (scored / "dataset.h5").resolve()


def test_an_error_is_told_even_if_its_rows_cannot_be_written(
    small_dataset: Path, fakes: ModuleType
) -> None:
    (small_dataset.parent / "scores.partial.csv").mkdir()
    expected = r"interrupted: 1 of 5 answers .*; their rows cannot be written: "
    with pytest.raises(KeyboardInterrupt, match=expected):
        score_dataset(small_dataset, cores=["interrupted"], workers=1)


def test_results_of_two_scorings_are_refused(scored: Path) -> None:
    table = scored / "scores.csv"
    table.write_text(table.read_text().replace("ok", "no_pose"))
    with pytest.raises(ScoreError, match=r"scores.csv: missing, changed or of another scoring"):
        load_results(scored)
    with pytest.raises(ScoreError, match=r"no scores.csv there; make it with: tronlab score"):
        load_results(scored / "nowhere")


def test_an_unknown_core_is_answered_with_the_known_ones(small_dataset: Path) -> None:
    with pytest.raises(ScoreError, match=r"no navigation core 'sift'; known cores: akaze, "):
        score_dataset(small_dataset, cores=["sift"])


def test_bad_input_is_one_clear_error(
    small_dataset: Path, empty_dataset: Path, tmp_path: Path, fakes: ModuleType
) -> None:
    with pytest.raises(ScoreError, match="'my/core': its results cannot be filed"):
        score_dataset(small_dataset, cores=["my/core"])
    with pytest.raises(ScoreError, match="workers is 0, must be 1 or more"):
        score_dataset(small_dataset, cores=["shift"], workers=0)
    with pytest.raises(ScoreError, match="core 'broken' has no licence"):
        score_dataset(small_dataset, cores=["broken"], workers=1)
    with pytest.raises(DatasetError, match=r"missing\.h5"):
        score_dataset(tmp_path / "missing.h5")
    with pytest.raises(ScoreError, match="the results cannot go there"):
        score_dataset(small_dataset, cores=["shift"], out_dir=small_dataset / "out")
    cut = tmp_path / "cut.h5"
    cut.write_bytes(small_dataset.read_bytes()[:30_000])
    with pytest.raises(DatasetError, match=r"cut\.h5"):
        score_dataset(cut)
    with pytest.raises(ScoreError, match="holds no shots: there is nothing to score"):
        score_dataset(empty_dataset)
    assert not (small_dataset.parent / "scores.csv").exists()


def test_cores_of_the_campaign_are_the_default() -> None:
    assert campaign_cores("score:\n  cores: [akaze, mine]\n") == ("akaze", "mine")
    for text in ("name: x\n", "score: {}\n", "a: [\n", ""):
        assert campaign_cores(text) == BUILT_IN_CORES


@pytest.mark.opencv
def test_workers_and_caches_do_not_change_a_number(plane_dataset: Path, tmp_path: Path) -> None:
    def scored(name: str, n_workers: int, cache_dir: Path | None) -> pd.DataFrame:
        return score_dataset(
            plane_dataset,
            cores=["akaze-refined", "akaze"],
            out_dir=tmp_path / name,
            workers=n_workers,
            cache_dir=cache_dir,
            progress=lambda *counts: progress.append(counts),
        )

    progress: list[tuple[int, int]] = []
    cache_dir = tmp_path / "cache"
    two = scored("two", 2, cache_dir)
    assert progress == [(k, 2 * N_SHOTS) for k in range(2 * N_SHOTS + 1)]
    assert two["core"].tolist() == ["akaze-refined"] * N_SHOTS + ["akaze"] * N_SHOTS
    assert two["shot_id"].tolist() == [*range(N_SHOTS)] * 2
    refined = two[:N_SHOTS]
    assert (refined["status"] == "ok").all()
    assert refined["position_error_pct_los"].max() < 1.0

    one = scored("one", 1, None)
    timeless = [name for name in COLUMNS if not name.startswith("time_")]
    pd.testing.assert_frame_equal(one[timeless], two[timeless], check_exact=True)
    (answers,) = cache_dir.glob("answers-*.sqlite")
    answers.unlink()
    stages = scored("stages", 1, cache_dir)
    # Features came from the store, with the time it took when they were found.
    found = [*timeless, "time_detect_s"]
    pd.testing.assert_frame_equal(stages[found], two[found], check_exact=True)


def is_gone(group: int, *, within_s: float) -> bool:
    """Tell whether every process of the group ended; Python's own helpers take a moment."""
    end_s = time.monotonic() + within_s
    while time.monotonic() < end_s:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def test_ctrl_c_ends_workers_without_a_traceback_and_keeps_what_is_done(
    small_dataset: Path, tmp_path: Path
) -> None:
    program = (
        f"import sys, typer; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "import fake_cores; from tronlab.score.rescoring import job\n"
        "from tronlab.cli.score import score\n"
        "job.describe_cores = fake_cores.describe_fakes\n"
        "if __name__ == '__main__': typer.run(score)"
    )
    script = tmp_path / "score.py"
    script.write_text(program)
    cores = ["--core", "slow", "--core", "third=slow"]
    command = [sys.executable, str(script), str(small_dataset), *cores, "--workers", "2"]
    child = subprocess.Popen(
        command,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")},
    )
    assert child.stderr is not None
    first = child.stderr.readline()
    os.killpg(child.pid, signal.SIGINT)
    _, said = child.communicate(timeout=30)
    assert "score: 1 of 10" in first, first + said
    assert "Traceback" not in said
    assert child.returncode == 130, said
    assert "the same command goes on from there" in said
    folder = small_dataset.parent
    n = len(pd.read_csv(folder / "scores.partial.csv"))
    assert 1 <= n < 10
    assert not (folder / "scores.csv").exists()
    assert is_gone(child.pid, within_s=10.0)
    caches = [*(tmp_path / "cache").rglob("answers-*.sqlite")]
    with AnswerCache(caches[0].parent, say=print) as cache:
        assert cache.count() == n
