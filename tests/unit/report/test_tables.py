"""Tables of shots, and of what the paper states."""

import io

import numpy as np
import pandas as pd
import pytest

from tronlab.report.tables import effort_table, paper_table, shots_table, worst_shots_table
from tronlab.score.evaluation.export import MISSING, to_csv


def frame(table):
    return pd.read_csv(io.StringIO(to_csv(table)), index_col=0)


def test_effort_is_the_median_of_all_shots(scores):
    table = frame(effort_table(scores))
    for name in ("n_features", "n_matches", "n_inliers", "time_detect_s", "time_pose_s"):
        by_pandas = scores.groupby("core")[name].median().loc[table.index]
        np.testing.assert_allclose(table[f"{name}_median"], by_pandas)


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
    reasons = {("brisk", 0, 0): "too few matches"}
    rows = [r for r in worst_shots_table(scores, reasons).rows if r[0] == "brisk"]
    assert [(r[1], r[3], r[-1]) for r in rows[:2]] == [
        (0, "no_pose", "too few matches"),
        (1, "no_pose", ""),
    ]
    brisk = scores[(scores["core"] == "brisk") & (scores["status"] == "ok")]
    largest = brisk.nlargest(3, "position_error_pct_los")
    assert [r[1] for r in rows[2:]] == largest["shot_id"].tolist()
    np.testing.assert_allclose([r[6] for r in rows[2:]], 1e3 * largest["position_error_m"])


def test_every_shot_is_listed(scores):
    table = shots_table(scores, "brisk", {})
    assert [row[0] for row in table.rows] == list(range(61))
