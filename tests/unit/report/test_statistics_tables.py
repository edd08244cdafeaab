"""Statistics with intervals, recall, bins and consistency as tables and pictures."""

import io

import numpy as np
import pandas as pd
import pytest

from tronlab.report.page import _interval_below
from tronlab.report.statistics_charts import consistency_chart, error_boxes, recall_curve
from tronlab.report.statistics_tables import (
    bins_table,
    consistency_table,
    recall_table,
    seeds_table,
    statistics_table,
)
from tronlab.report.style import core_styles
from tronlab.score.evaluation.bins import make_bins
from tronlab.score.evaluation.export import MISSING, to_csv
from tronlab.score.evaluation.recall import THRESHOLDS, Threshold

ERROR = "position_error_pct_los"


def frame(table):
    return pd.read_csv(io.StringIO(to_csv(table)), index_col=0)


def test_statistics_are_those_of_pandas_within_their_intervals(scores):
    table = frame(statistics_table(scores))
    solved = scores[scores["status"] == "ok"].groupby("core")
    for label, name in (("position [% LOS]", ERROR), ("rotation [deg]", "rotation_error_deg")):
        ours = table[table["error"] == label]
        assert list(ours.index) == ["akaze", "brisk", "akaze-refined", "brisk-refined"]
        assert ours["n_shots"].tolist() == ours["n_answers"].tolist() == [61] * 4
        assert ours["n_ok"].tolist() == [61, 59, 61, 61]
        by_pandas = pd.DataFrame(
            {
                "mean": solved[name].mean(),
                "median": solved[name].median(),
                "rms": solved[name].apply(lambda e: np.sqrt((e**2).mean())),
                "p95": solved[name].quantile(0.95),
                "max": solved[name].max(),
            }
        ).loc[ours.index]
        np.testing.assert_allclose(ours[list(by_pandas.columns)], by_pandas, rtol=1e-12)
        assert (ours["mean_low"] < ours["mean"]).all()
        assert (ours["mean"] < ours["mean_high"]).all()
        assert ours["p99_high"].isna().all()


def test_a_core_without_a_pose_has_no_statistics(scores_of, lose):
    scores = scores_of({"akaze": 0.5}, 4)
    lose(scores, scores["core"] == "akaze", "no_pose")
    assert statistics_table(scores).formatted[0] == (
        "akaze", "position [% LOS]", "4", "4", "0", *[MISSING] * 8
    )  # fmt: skip
    shares = recall_table(scores, THRESHOLDS).rows[0][4:]
    assert [share.value for share in shares] == [0.0] * 4
    assert consistency_table(scores).rows[0][-1] == "not known"


def test_seeds_are_answers_to_the_same_shots(scores):
    repeated = pd.concat([scores, scores.assign(seed=1)])
    table = frame(statistics_table(repeated))
    assert (table["n_answers"] == 2 * table["n_shots"]).all()
    once = frame(statistics_table(scores))
    np.testing.assert_allclose(table["mean"], once["mean"])
    # Repeats that say the same do not make the intervals any narrower.
    np.testing.assert_allclose(table["mean_low"], once["mean_low"], rtol=1e-9)
    spread = frame(seeds_table(repeated))
    assert (spread["n_seeds"] == 2).all()
    assert (spread["mean_sd"] == 0.0).all()
    assert seeds_table(scores).formatted[0][3:] == tuple([MISSING] * 8)


def test_bins_of_all_cores_hold_all_shots(scores):
    bins = make_bins(scores, "range_los_m", (2.0, 3.0))
    table = frame(bins_table(scores, "range_los_m", bins))
    assert table.loc["akaze", "bin"].tolist() == ["below 2", "2 to 3", "3 and more"]
    assert (table.groupby(level=0)["n_shots"].sum() == 61).all()
    near = scores[(scores["core"] == "brisk") & (scores["range_los_m"] < 2.0)]
    assert table.loc["brisk", f"{ERROR}_mean"].iloc[0] == pytest.approx(near[ERROR].mean())


def test_consistency_reads_what_the_core_and_the_truth_say(scores):
    honest = scores.assign(
        sigma_truth_m=scores["position_error_m"] / 1.5,
        bound_m=scores["position_error_m"] / 2.0,
        nees=np.random.default_rng(2).chisquare(3, len(scores)),
    )
    row = frame(consistency_table(honest)).loc["brisk"]
    assert row[["n_truth", "n_bound", "n_nees"]].tolist() == [59, 59, 59]
    assert row["within_truth_pct"] == 100.0
    assert row["error_over_bound_rms"] == pytest.approx(2.0)
    assert row["verdict"] == "consistent"
    assert frame(consistency_table(honest.assign(nees=9.0)))["verdict"].unique() == ["too sure"]


def test_pictures_of_cores_with_and_without_what_they_draw(scores, lose):
    styles = core_styles(["akaze", "brisk", "akaze-refined", "brisk-refined"])
    bins = make_bins(scores, "range_los_m")
    axes = error_boxes(scores, styles, "range_los_m", bins).axes[0]
    assert [text.get_text().splitlines()[1] for text in axes.get_xticklabels()] == [
        "15 shots", "15 shots", "15 shots", "16 shots"
    ]  # fmt: skip
    answers = scores.assign(shot_id=np.arange(len(scores)))
    axes = error_boxes(answers, styles, "range_los_m", bins, counted="answer").axes[0]
    assert axes.get_xticklabels()[0].get_text().endswith("\n60 answers")
    lines = {
        line.get_label(): line for line in recall_curve(scores, styles, THRESHOLDS).axes[0].lines
    }
    assert lines["akaze"].get_ydata()[-1] == 100.0
    assert lines["brisk"].get_ydata()[-1] == pytest.approx(100.0 * 59 / 61)
    known = scores.assign(nees=scores["position_error_pct_los"])
    panels = consistency_chart(known, styles).axes
    assert [text.get_text() for text in panels[1].texts] == ["no core gives a bound"]
    assert not panels[2].texts
    lose(scores, scores["core"] != "", "no_pose")
    axes = error_boxes(scores, styles, "range_los_m", bins).axes[0]
    assert [text.get_text() for text in axes.texts] == ["no shot with a pose"]
    recall_curve(scores, styles, (Threshold(1.0, 0.2),))


def test_the_interval_stands_below_its_value():
    assert _interval_below("1.2 [1, <b>") == "1.2<br><small>[1, &lt;b&gt;</small>"
    assert _interval_below("<b>") == "&lt;b&gt;"
