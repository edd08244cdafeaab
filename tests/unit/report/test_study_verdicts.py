"""What a study is said to have reached: by its tables, and by nothing else."""

import numpy as np
import pandas as pd
import pytest
from study_tables import (
    load_table,
    rank_table,
    scores_of,
    selection_table,
    write_scores,
)

from tronlab.errors import ScoreError
from tronlab.report.paper import DATASETS, TABLE_1, detector_of, is_refined
from tronlab.report.study.answers import (
    estimate_text,
    larger_terrain_answer,
    load_answer,
    perturbation_answer,
    selection_answer,
    selection_details,
)
from tronlab.report.study.comparisons import compare_terrains
from tronlab.report.study.requirements import requirements, verdict_sentence
from tronlab.report.study.results import StudyResults, read_study
from tronlab.report.study.shortfalls import bound_shortfalls
from tronlab.report.study.tables import (
    bound_table,
    counts_table,
    published_table,
    straight_line_table,
)

PCT = "position_error_pct_los"


@pytest.fixture
def results(tmp_path):
    datasets = {name: scores_of(name) for name in DATASETS}
    return StudyResults(tmp_path, {}, datasets, {}, {})


def verdicts(results):
    return {found.subject: found.verdict for found in requirements(results)}


def changed(results, dataset, core, **columns):
    scores = results.datasets[dataset].copy()
    for name, change in columns.items():
        which = scores["core"] == core
        scores.loc[which, name] = change(scores.loc[which, name])
    return StudyResults(
        results.folder, results.info, {**results.datasets, dataset: scores}, {}, results.tables
    )


def test_good_scores_meet_all_that_scores_can(results):
    found = verdicts(results)
    unknown = [subject for subject, verdict in found.items() if verdict == "not known"]
    assert all("study: " in subject for subject in unknown)
    assert {v for s, v in found.items() if s not in unknown} == {"met"}


@pytest.mark.parametrize(
    ("dataset", "core", "column", "change", "subject"),
    [
        ("dataset_0", "brisk", PCT, lambda v: v + 1.0, "Paper's estimator, dataset 0: mean"),
        ("dataset_1_nominal", "akaze", PCT, lambda v: v + 2.0, "Paper's estimator, Table 1: mean"),
        ("dataset_2_nominal", "brisk", PCT, lambda v: 2.81, "Paper's estimator, Table 1: max"),
        ("dataset_2_perturbed", "akaze", PCT, lambda v: v + 8.9, "Paper's estimator, Table 2: max"),
        ("dataset_1_perturbed", "akaze-refined", PCT, lambda v: 0.101, "Refined: mean position"),
        ("dataset_2_perturbed", "brisk-refined", PCT, lambda v: 0.51, "Refined: largest"),
        ("dataset_0", "brisk-refined", "status", lambda v: "no_pose", "Refined: shots without"),
        (
            "dataset_0",
            "akaze-refined",
            "bound_m",
            lambda v: v / 2,
            "Refined: median of error over the",
        ),
        ("dataset_0", "akaze-refined", "axis_error_y_deg", lambda v: 0.051, "Refined: mean error"),
    ],
)
def test_what_is_not_reached_is_said_with_its_dataset_and_core(
    results, dataset, core, column, change, subject
):
    worse = changed(results, dataset, core, **{column: change})
    failed = [r for r in requirements(worse) if r.subject.startswith(subject)]
    assert [r.verdict for r in failed] == ["not met"]
    assert failed[0].case == f"{DATASETS[dataset].title}, {core}"
    assert failed[0].subject in verdict_sentence(requirements(worse), n_datasets=5)


def test_time_and_memory_are_judged_by_all_steps(results):
    steps = [
        {"name": "a", "seconds": 2000.0, "peak_memory_mb": 6100.0},
        {"name": "b", "seconds": 1599.0, "peak_memory_mb": None},
    ]
    full = StudyResults(results.folder, {"steps": steps}, results.datasets, {}, {})
    quick = StudyResults(results.folder, {"steps": steps, "quick": True}, results.datasets, {}, {})
    assert verdicts(full)["Full study: time of all steps"] == "met"
    assert verdicts(full)["Full study: memory"] == "not met"
    assert verdicts(quick)["Quick study: time of all steps"] == "not met"


def test_published_table_has_the_papers_numbers_above_ours(results):
    table = published_table("table_1", "", results.datasets, TABLE_1)
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["Average, the paper's"] == (2.2, 2.4, 3.5, 2.1)
    assert rows["Maximum, the paper's"] == (6.1, 4.3, 13.8, 2.8)
    scores = results.datasets["dataset_2_nominal"]
    for whose, core in (("ours", "brisk"), ("ours, refined", "brisk-refined")):
        errors = scores.loc[scores["core"] == core, PCT]
        mean, largest = rows[f"Average, {whose}"][3], rows[f"Maximum, {whose}"][3]
        assert mean.value == pytest.approx(errors.mean())
        assert mean.interval.low < mean.value < mean.interval.high
        assert largest.value == errors.max()


def test_sets_that_were_not_taken_stay_empty(results):
    only = {"dataset_0": results.datasets["dataset_0"]}
    cells = [row[1:] for row in published_table("table_1", "", only, TABLE_1).formatted]
    assert {cell for row in cells[1:3] for cell in row} == {"\N{EN DASH}"}
    counts = counts_table(only, {"dataset_0": 61}, {"dataset_1_perturbed": 2})
    assert [row[1] for row in counts.rows] == [61, 12, 239, 11, 50]
    assert counts.formatted[0][2:5] == ("61", "61", "\N{EN DASH}")
    assert counts.formatted[2][2:5] == ("\N{EN DASH}", "\N{EN DASH}", "2")
    assert straight_line_table(only["dataset_0"]).rows[0][1:] == (1.0, 1.0)


def test_bound_table_is_of_error_over_bound(results):
    rows = {row[:2]: row for row in bound_table(results.datasets).rows}
    scores = results.datasets["dataset_0"]
    own = scores[scores["core"] == "akaze-refined"]
    row = rows["dataset 0, straight line", "akaze-refined"]
    assert row[3] == pytest.approx(np.median(own["position_error_m"] / own["bound_m"]))
    assert row[4] < row[3] < row[5]
    assert not any(core == "akaze" for _, core in rows)


def test_error_over_the_stated_sigma_stands_beside_that_over_the_bound(results):
    stated = changed(results, "dataset_0", "akaze-refined", sigma_core_m=lambda v: 1e-3)
    row = {row[:2]: row for row in bound_table(stated.datasets).rows}[
        "dataset 0, straight line", "akaze-refined"
    ]
    scores = stated.datasets["dataset_0"]
    error_m = scores.loc[scores["core"] == "akaze-refined", "position_error_m"]
    assert row[7] == pytest.approx(1e3 * error_m.median())


def test_every_miss_of_the_bound_is_said_with_the_dearest_source(results):
    missed = changed(results, "dataset_0", "akaze-refined", bound_m=lambda v: v / 3)
    missed = changed(missed, "dataset_1_nominal", "akaze-refined", bound_m=lambda v: v / 4)
    (found,) = (r for r in requirements(missed) if "pixel noise" in r.subject)
    assert len(found.others) == 1
    assert "dataset 0" in found.case + found.others[0]
    assert "dataset 1" in found.case + found.others[0]
    (sentence,) = bound_shortfalls(missed)
    assert sentence.startswith("akaze-refined misses")
    assert sentence.count("times bound, truth and registration together") == 2
    assert "no sources of error were switched off" in sentence
    ablation = pd.DataFrame(
        [
            ("all", "", 0.09, 0.0, np.nan, np.nan),
            ("without_photometry", "photometric function", 0.03, 0.06, 0.04, 0.08),
            ("without_psf", "point spread function", 0.02, 0.07, -0.01, 0.15),
        ],
        columns=["variant", "title", "mean_pct_los", "cost_pct_los", "cost_low", "cost_high"],
    ).assign(core="akaze-refined", dataset="together")
    limits = pd.DataFrame(
        [("dataset_0", "akaze-refined", np.nan), ("dataset_1_nominal", "akaze-refined", 0.9)],
        columns=["dataset", "core", "none_over_bound"],
    )
    tables = {"ablation": ablation, "limits": limits}
    told = StudyResults(missed.folder, {}, missed.datasets, {}, tables)
    (sentence,) = bound_shortfalls(told)
    assert sentence.count("0.9 without any source of error") == 1
    assert "photometric function +0.06 [+0.04, +0.08] %" in sentence
    assert "point spread" not in sentence
    assert bound_shortfalls(results) == ()


def test_refined_means_are_held_against_twenty_times_below_the_papers(results):
    worse = changed(results, "dataset_2_nominal", "akaze-refined", **{PCT: lambda v: 2.4 / 19})
    (found,) = (r for r in requirements(worse) if "below that of the paper" in r.subject)
    assert (found.verdict, found.reached) == ("not met", "19 times")
    assert found.case == "dataset 2, nominal, akaze-refined"


def test_refined_cores_are_told_from_the_papers():
    assert [is_refined(core) for core in ("akaze", "brisk-refined", "mine")] == [False, True, False]
    assert [detector_of(c) for c in ("akaze", "brisk-refined", "mine")] == ["AKAZE", "BRISK", ""]


@pytest.mark.parametrize(
    ("scale", "verdict"),
    [(0.4, "holds"), (3.0, "does not hold"), (1.0, "is not decided everywhere")],
)
def test_larger_terrain_answer_follows_the_intervals(results, scale, verdict):
    larger = {"dataset_1_nominal": scores_of("dataset_1_nominal", scale=scale)}
    comparisons = compare_terrains(results.datasets, larger)
    answer = larger_terrain_answer(results.datasets, larger, comparisons)
    assert f"its hypothesis {verdict}." in answer[0]
    assert len(answer) == 1 + 1 + 2  # the verdict, the dataset, and each detector


def test_shots_only_the_larger_terrain_has_are_not_compared(results):
    more = scores_of("dataset_1_nominal", n_shots=20)
    (comparison, *_) = compare_terrains(results.datasets, {"dataset_1_nominal": more})[
        "dataset_1_nominal"
    ]
    assert len(comparison.differences.values) == 12


def test_gains_are_claimed_only_outside_zero_and_after_holm():
    selection = selection_table()
    selection.loc[selection["variant"] == "mutual", "p_holm"] = 0.06
    lower, hint, none, *_ = selection_details(selection)
    assert "akaze, these lower the mean error" in lower
    assert "geometric verification 0.35 [0.28, 0.44], p 0.004" in lower
    assert "mutual check" not in lower
    assert "mutual check 0.09 [0.03, 0.15]" in hint
    assert "ratio test at 0.8 0.02 [-0.03, 0.07]" in none
    assert "includes zero" in none
    akaze, refined = selection_answer(selection)
    assert akaze.startswith("Against akaze, 2 of 4 choices lower the mean error for certain")
    assert "0 raise it for certain, 2 show no difference that is certain" in akaze
    assert "0 of 2 choices lower the mean error for certain; 1 raise it" in refined


def test_numbers_too_small_to_matter_are_zero_without_a_sign():
    assert estimate_text(-1.9e-8, -0.0, 6e-7) == "0 [0, 0]"
    assert estimate_text(0.25, float("nan"), float("nan")) == "0.25"


def test_load_answer_finds_the_power_of_growth():
    load = load_table()
    load["time_all_s"] = load["value"].astype(float) ** 1.5
    for sentence in load_answer(load):
        assert sentence.count("as its power 1.50") == 3
    assert load_answer(load.iloc[:0]) == ("The computational load was not measured.",)


def test_perturbation_answer_counts_what_is_significant():
    rank = rank_table()
    assert "0 differ from zero" in perturbation_answer(rank)[0]
    rank.loc[3, ["spearman_rho", "p"]] = [-0.6, 1e-6]
    answer = perturbation_answer(rank)[0]
    assert "1 differ from zero" in answer
    assert "the largest is -0.60 [-0.06, 0.20]" in answer
    rank[["low", "high"]] = np.nan
    assert "the largest is -0.60, of" in perturbation_answer(rank)[0]
    rank[["spearman_rho", "p"]] = np.nan
    assert perturbation_answer(rank) == (
        "There are too few perturbed shots for a rank correlation.",
    )


def test_reading_names_what_is_missing_and_leaves_out_what_is_not_asked_for(tmp_path):
    for name in ("dataset_0", "dataset_1_nominal"):
        write_scores(tmp_path / "datasets" / name, scores_of(name))
    (tmp_path / "load").mkdir()
    load_table().to_csv(tmp_path / "load" / "load.csv", index=False)
    results = read_study(tmp_path, datasets=["dataset_0"])
    assert list(results.datasets) == ["dataset_0"]
    assert "scores of dataset 2, perturbed" in results.missing
    assert "the table worst/worst.csv" in results.missing
    assert "the table load/load.csv" not in results.missing
    assert results.cores == ("akaze", "brisk", "akaze-refined", "brisk-refined")


@pytest.mark.parametrize(
    ("name", "text", "error"),
    [
        ("study.json", "{", "cannot be read"),
        ("study.json", "[]", "is not a JSON object"),
        ("datasets/dataset_0/scores.csv", "core,shot_id\nakaze,1\n", "columns are missing: status"),
        ("load/load.csv", "", "is not a table"),
    ],
)
def test_damaged_files_are_named(tmp_path, name, text, error):
    path = tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    with pytest.raises(ScoreError, match=error) as caught:
        read_study(tmp_path)
    assert path.name in str(caught.value)


def test_without_any_dataset_there_is_nothing_to_report(tmp_path):
    with pytest.raises(ScoreError, match="holds no scores of any dataset"):
        _ = StudyResults(tmp_path, {}, {}, {}, {"load": pd.DataFrame()}).scores
