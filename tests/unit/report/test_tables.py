"""Tables: the numbers are those of the scores, and text survives every format."""

import csv
import io

import numpy as np
import pandas as pd
import pytest

from tronlab.report.tables import (
    MISSING,
    Column,
    Table,
    effort_table,
    escape_latex,
    paper_table,
    shots_table,
    statistics_table,
    to_csv,
    to_latex,
    worst_shots_table,
)


def frame(table):
    return pd.read_csv(io.StringIO(to_csv(table)), index_col=0)


def test_statistics_are_those_of_pandas(scores):
    table = frame(statistics_table(scores))
    solved = scores[scores["status"] == "ok"].groupby("core")
    assert list(table.index) == ["akaze", "brisk", "akaze-refined", "brisk-refined"]
    assert table["n_shots"].tolist() == [61] * 4
    assert table["n_ok"].tolist() == [61, 59, 61, 61]
    for name in ("position_error_pct_los", "rotation_error_deg"):
        by_pandas = pd.DataFrame(
            {
                "mean": solved[name].mean(),
                "median": solved[name].median(),
                "rms": solved[name].apply(lambda e: np.sqrt((e**2).mean())),
                "p95": solved[name].quantile(0.95),
                "max": solved[name].max(),
            }
        ).loc[table.index]
        ours = table[[f"{name}_{s}" for s in by_pandas.columns]]
        np.testing.assert_allclose(ours, by_pandas, rtol=1e-12)


def test_headings_of_statistics_say_which_error(scores):
    headings = statistics_table(scores).headings
    assert len(set(headings)) == len(headings)
    assert "position mean [% LOS]" in headings
    assert "rotation max [deg]" in headings


def test_effort_is_the_median_of_all_shots(scores):
    table = frame(effort_table(scores))
    for name in ("n_features", "n_matches", "n_inliers", "time_detect_s", "time_pose_s"):
        by_pandas = scores.groupby("core")[name].median().loc[table.index]
        np.testing.assert_allclose(table[f"{name}_median"], by_pandas)


def test_core_without_a_pose_has_no_statistics(scores_of, lose):
    scores = scores_of({"akaze": 0.5}, 4)
    lose(scores, scores["core"] == "akaze", "no_pose")
    assert to_csv(statistics_table(scores)).splitlines()[1] == "akaze,4,0" + "," * 10
    assert statistics_table(scores).formatted[0] == ("akaze", "4", "0", *[MISSING] * 10)


@pytest.mark.parametrize(
    ("scale_pct", "n_lost", "within"), [(0.5, 0, "yes"), (0.5, 1, "no"), (9.0, 0, "no")]
)
def test_bounds_of_the_paper_hold_only_for_all_shots(scores_of, lose, scale_pct, n_lost, within):
    scores = scores_of({"akaze": scale_pct, "mine": 0.1})
    lose(scores, (scores["core"] == "akaze") & (scores["shot_id"] < n_lost), "timeout")
    ours, mine = paper_table(scores).formatted
    assert ours[-4:] == ("AKAZE", "< 1 %", "< 3 %", within)
    assert mine[-4:] == (MISSING, MISSING, MISSING, MISSING)


def test_worst_shots_begin_with_those_without_a_pose(scores):
    reasons = {("brisk", 0): "too few matches"}
    rows = [r for r in worst_shots_table(scores, reasons).rows if r[0] == "brisk"]
    assert [(r[1], r[2], r[-1]) for r in rows[:2]] == [
        (0, "no_pose", "too few matches"),
        (1, "no_pose", ""),
    ]
    brisk = scores[(scores["core"] == "brisk") & (scores["status"] == "ok")]
    largest = brisk.nlargest(3, "position_error_pct_los")
    assert [r[1] for r in rows[2:]] == largest["shot_id"].tolist()
    np.testing.assert_allclose([r[5] for r in rows[2:]], 1e3 * largest["position_error_m"])


def test_every_shot_is_listed(scores):
    table = shots_table(scores, "brisk", {})
    assert [row[0] for row in table.rows] == list(range(61))


def test_csv_keeps_every_digit_and_every_character():
    text = 'a "quoted", name\nof two lines'
    table = Table(
        "t", "", (Column("name", "name"), Column("x_m", "x", ".1f")), ((text, 0.1 + 0.2),)
    )
    rows = list(csv.reader(io.StringIO(to_csv(table))))
    assert rows == [["name", "x_m"], [text, repr(0.1 + 0.2)]]
    assert table.formatted == ((text, "0.3"),)


def test_latex_escapes_every_special_character():
    assert escape_latex(r"a_b & 50% #1 {x} ~ ^ $ \ < >") == (
        r"a\_b \& 50\% \#1 \{x\} \textasciitilde{} \textasciicircum{} \$ \textbackslash{}"
        r" \textless{} \textgreater{}"
    )


def test_latex_table():
    columns = (Column("core", "core"), Column("x", "mean [% LOS]", ".2g"))
    lines = to_latex(Table("t", "", columns, (("a_1", 0.123), ("[b]", np.nan)))).splitlines()
    assert lines == [
        r"\begin{tabular}{lr}",
        r"\toprule",
        r"core & mean {[}\% LOS] \\",
        r"\midrule",
        r"a\_1 & 0.12 \\",
        r"{[}b] & -- \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]
