"""Parts of the shots: each shot in exactly one, whatever its value."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tronlab.errors import ScoreError
from tronlab.score.evaluation.bins import make_bins, parse_edges, score_bins

values = st.one_of(st.floats(0.5, 5.0), st.sampled_from([1.0, 2.0, 4.0]), st.just(np.nan))


def rows_of(ranges_m):
    n = len(ranges_m)
    return pd.DataFrame(
        {
            "core": "akaze",
            "shot_id": np.arange(n),
            "status": ["no_pose" if i % 5 == 4 else "ok" for i in range(n)],
            "range_los_m": np.asarray(ranges_m, dtype=np.float64),
            "position_error_pct_los": np.arange(n, dtype=np.float64),
        }
    )


@settings(max_examples=20, deadline=None)
@given(
    st.lists(values, min_size=1, max_size=40),
    st.one_of(st.none(), st.sets(st.sampled_from([1.0, 2.0, 3.0, 4.0]), min_size=1).map(sorted)),
)
def test_each_shot_is_in_one_bin(ranges_m, edges):
    rows = rows_of(ranges_m)
    bins = make_bins(rows, "range_los_m", edges)
    n_held = sum(b.holds(rows["range_los_m"].to_numpy()).astype(int) for b in bins)
    assert (n_held == 1).all()
    found = score_bins(rows, "range_los_m", bins, "position_error_pct_los")
    assert sum(b.n_answers for b in found) == len(rows)
    assert sum(b.n_ok for b in found) == (rows["status"] == "ok").sum()
    assert min(b.n_shots for b in found) > 0


def test_quantiles_make_bins_of_as_many_shots_for_all_cores():
    rows = rows_of(np.linspace(4.0, 1.0, 40))
    both = pd.concat([rows, rows.assign(core="brisk")])
    bins = make_bins(both, "range_los_m")
    found = score_bins(rows, "range_los_m", bins, "position_error_pct_los")
    assert [b.n_shots for b in found] == [10, 10, 10, 10]
    assert [b.text for b in bins] == ["1 to 1.75", "1.75 to 2.5", "2.5 to 3.25", "3.25 to 4"]


def test_given_edges_lose_nothing_beyond_them():
    bins = make_bins(rows_of([0.5, 2.0, 9.0, np.nan]), "range_los_m", (1.0, 3.0))
    assert [b.text for b in bins] == ["below 1", "1 to 3", "3 and more", "not known"]


@pytest.mark.parametrize("ranges_m", [[2.0] * 6, [60.651, 60.652, 60.66, 60.67]])
def test_shots_much_alike_are_not_parted(ranges_m):
    assert len(make_bins(rows_of(ranges_m), "range_los_m")) == 1


def test_edges_are_read_or_refused():
    assert parse_edges("phase_deg=30,60") == ("phase_deg", (30.0, 60.0))
    for odd in ("range_los_m", "n_inliers=1", "range_los_m=", "range_los_m=2,1", "range_los_m=1,x"):
        with pytest.raises(ScoreError, match=f"bins '{odd}'"):
            parse_edges(odd)
