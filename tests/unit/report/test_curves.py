"""Curves: every shot counts, every core keeps its colour."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_hex

from tronlab.report.curves import (
    N_RANGE_BINS,
    SMALLEST_ERROR_PCT_LOS,
    error_against_range,
    error_distribution,
    range_medians,
)
from tronlab.report.style import core_styles

TWO_CORES = {"akaze": 0.5, "brisk": 0.4}
CORE_SCALES = {**TWO_CORES, "akaze-refined": 0.03}
BOTH = pytest.mark.parametrize("draw", [error_against_range, error_distribution])


def axes_of(draw, scores):
    figure = draw(scores, core_styles(list(scores["core"].unique())))
    figure.canvas.draw()
    return figure.axes[0]


def legend(axes):
    return [text.get_text() for text in axes.figure.legends[0].get_texts()]


def drawn(axes, i):
    return np.array(axes.lines[i].get_xydata())


def test_cores_have_the_same_colours_in_both_plots(scores):
    expected = [style.colour for style in core_styles(list(scores["core"].unique())).values()]
    for draw in (error_against_range, error_distribution):
        lines = axes_of(draw, scores).figure.legends[0].get_lines()
        assert [to_hex(line.get_color()) for line in lines] == expected


def test_every_shot_with_a_pose_is_a_point_over_its_range(scores):
    axes = axes_of(error_against_range, scores)
    brisk = scores[(scores["core"] == "brisk") & (scores["status"] == "ok")]
    expected = brisk[["range_los_m", "position_error_pct_los"]].to_numpy()
    np.testing.assert_array_equal(drawn(axes, 2), expected)
    assert axes.get_yscale() == "log"


def test_shots_without_a_pose_are_marked_at_their_range(scores):
    axes = axes_of(error_against_range, scores)
    np.testing.assert_allclose(drawn(axes, 2 * 4)[:, 0], [4.0, 3.95])
    assert axes.get_xlabel().endswith("crosses: no pose")


def test_crosses_of_two_cores_hide_neither_each_other_nor_an_error(scores_of, lose):
    scores = scores_of(CORE_SCALES)
    is_lost = scores["core"].isin(["akaze", "brisk"]) & (scores["shot_id"] < 30)
    lose(scores, is_lost, "no_pose")
    axes = axes_of(error_against_range, scores)
    heights = [set(drawn(axes, i)[:, 1]) for i in (6, 7)]
    assert all(len(rows) == 1 for rows in heights)
    assert not heights[0] & heights[1]
    lowest = scores["position_error_pct_los"].min()
    lowest_on_axes = axes.transAxes.inverted().transform(axes.transData.transform((1.0, lowest)))
    assert lowest_on_axes[1] > max(*heights[0], *heights[1])


def test_without_missed_shots_there_are_no_crosses(scores_of):
    axes = axes_of(error_against_range, scores_of(TWO_CORES))
    assert len(axes.lines) == 4
    assert "crosses" not in axes.get_xlabel()


def test_distribution_is_over_all_shots(scores):
    axes = axes_of(error_distribution, scores)
    assert drawn(axes, 0)[-1, 1] == pytest.approx(100.0)
    brisk = drawn(axes, 1)
    assert brisk[-1, 1] == pytest.approx(100.0 * 59 / 61)
    errors = scores[scores["core"] == "brisk"]["position_error_pct_los"]
    for error, share in brisk[1:]:
        assert share == pytest.approx(100.0 * (errors <= error).sum() / 61)


@BOTH
def test_legend_says_how_many_shots_have_no_pose(scores, draw):
    assert legend(axes_of(draw, scores))[:2] == ["akaze", "brisk (2 of 61 without pose)"]


@BOTH
def test_no_core_with_a_pose(scores_of, lose, draw):
    scores = scores_of(TWO_CORES)
    lose(scores, scores["status"] == "ok", "timeout")
    axes = axes_of(draw, scores)
    assert "no shot with a pose" in [text.get_text() for text in axes.texts]
    assert legend(axes)[0] == "akaze (61 of 61 without pose)"


@BOTH
def test_one_core_without_a_pose_beside_another(scores_of, lose, draw):
    scores = scores_of(TWO_CORES)
    lose(scores, scores["core"] == "akaze", "no_pose")
    assert not axes_of(draw, scores).texts


@BOTH
@pytest.mark.parametrize("error_pct", [0.0, 0.02])
def test_one_shot_and_equal_errors(scores_of, draw, error_pct):
    scores = scores_of(TWO_CORES, 1)
    scores["position_error_pct_los"] = error_pct
    on_axis = 1 if draw is error_against_range else 0
    axes = axes_of(draw, scores)
    low, high = axes.get_ylim() if on_axis else axes.get_xlim()
    assert 0.0 < low < max(error_pct, SMALLEST_ERROR_PCT_LOS) < high
    assert len(axes.figure.legends[0].get_texts()) == 2


@BOTH
@pytest.mark.parametrize("column", ["range_los_m", "position_error_pct_los"])
def test_missing_numbers_are_left_out(scores_of, draw, column):
    scores = scores_of({"akaze": 0.5})
    scores.loc[[3, 7], column] = np.nan
    shown = drawn(axes_of(draw, scores), 0)
    assert np.isfinite(shown).all()
    if draw is error_against_range:
        assert len(shown) == 59
        assert np.isfinite(drawn(axes_of(draw, scores), 1)).all()


@BOTH
def test_dollar_signs_are_no_formula(scores_of, draw):
    assert legend(axes_of(draw, scores_of({r"$\frac$": 0.5}))) == [r"$\frac$"]


def test_medians_of_parts_of_the_range():
    range_m, median = range_medians(
        np.array([1.0, 1.01, 1.02, 3.0]), np.array([5.0, 1.0, 2.0, 9.0])
    )
    np.testing.assert_allclose(range_m, [1.01, 3.0])
    np.testing.assert_array_equal(median, [2.0, 9.0])


@given(st.lists(st.floats(0.5, 5.0), max_size=40))
def test_medians_lie_within_the_ranges(ranges_m):
    range_m, median = range_medians(np.array(ranges_m), np.array(ranges_m))
    assert range_m.size == median.size <= N_RANGE_BINS
    assert (range_m.size > 0) == bool(ranges_m)
    assert (np.diff(range_m) > 0).all()
    if ranges_m:
        slack = 1e-12
        assert min(ranges_m) - slack <= range_m.min() <= range_m.max() <= max(ranges_m) + slack
