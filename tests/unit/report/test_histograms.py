"""Histograms: nothing is lost, whatever the errors are."""

import numpy as np
import pytest
from matplotlib.colors import to_hex

from tronlab.report.histograms import bin_edges, error_histograms, fence, pose_count_text
from tronlab.report.style import AXIS_COLOURS

AXES = ("norm", "x", "y", "z", "axis x", "axis y", "axis z")
"""The panels in the order they are drawn."""
ONE_CORE = {"akaze": 0.5}


def panels(scores, core="akaze"):
    return dict(zip(AXES, error_histograms(scores, core).axes, strict=True))


def counts(panel):
    return [bar.get_height() for bar in panel.patches]


def hatched(panel):
    return [bar for bar in panel.patches if bar.get_hatch()]


def test_norm_is_grey_and_the_axes_red_green_blue(scores_of):
    colours = {
        name: {to_hex(bar.get_facecolor()) for bar in panel.patches}
        for name, panel in panels(scores_of(ONE_CORE)).items()
    }
    red, green, blue = ({colour} for colour in AXIS_COLOURS.values())
    assert list(colours.values()) == [{"#7f7f7f"}, red, green, blue, red, green, blue]
    assert (red, green, blue) == ({"#d62728"}, {"#2ca02c"}, {"#1f77b4"})


def test_bars_stand_where_the_errors_are(scores_of):
    scores = scores_of(ONE_CORE)
    percent = 100 * scores["error_trs_y_m"] / scores["range_los_m"]
    for bar in panels(scores)["y"].patches:
        low, high = bar.get_x(), bar.get_x() + bar.get_width()
        assert bar.get_height() == ((percent >= low) & (percent < high)).sum()


def test_bars_count_every_shot_with_a_pose(scores):
    for core, n in (("akaze", 61), ("brisk", 59)):
        for panel in panels(scores, core).values():
            assert sum(counts(panel)) == n
            assert f"n = {n}" in panel.get_title("left")
            assert not hatched(panel)


def test_panels_of_a_row_share_their_scales(scores_of):
    drawn = panels(scores_of(ONE_CORE))
    for row in (("x", "y", "z"), ("axis x", "axis y", "axis z")):
        assert len({drawn[name].get_xlim() for name in row}) == 1
        assert len({drawn[name].get_ylim() for name in row}) == 1


def test_without_a_pose_every_panel_says_so(scores_of, lose):
    scores = scores_of(ONE_CORE, 5)
    lose(scores, scores["core"] == "akaze", "timeout")
    for panel in panels(scores).values():
        assert counts(panel) == []
        assert [text.get_text() for text in panel.texts] == ["no shot with a pose"]


def test_title_says_why_shots_have_no_pose(scores_of, lose):
    scores = scores_of(ONE_CORE, 9)
    lose(scores, scores["shot_id"] < 3, "no_pose")
    lose(scores, scores["shot_id"] == 8, "error")
    text = "5 of 9 shots with a pose; without: 1 error, 3 no_pose"
    assert pose_count_text(scores) == text
    assert error_histograms(scores, "akaze").get_suptitle() == f"akaze: {text}"


@pytest.mark.parametrize("n_shots", [1, 2])
def test_few_shots(scores_of, n_shots):
    for panel in panels(scores_of(ONE_CORE, n_shots)).values():
        assert sum(counts(panel)) == n_shots


@pytest.mark.parametrize("error", [0.0, 0.02, 1e-12, 3e4])
def test_equal_errors_are_one_bar(scores_of, error):
    scores = scores_of(ONE_CORE, 6)
    scores[[name for name in scores.columns if "error" in name]] = error
    scores["range_los_m"] = 2.0
    for panel in panels(scores).values():
        assert sorted(counts(panel))[-2:] == [0, 6]
        assert not hatched(panel)


def test_missing_and_infinite_errors_are_left_out_and_n_says_so(scores_of):
    scores = scores_of(ONE_CORE, 8)
    scores.loc[1, ["position_error_pct_los", "error_trs_x_m", "axis_error_x_deg"]] = np.nan
    scores.loc[2, "position_error_pct_los"] = np.inf
    drawn = panels(scores)
    for name, n in (("norm", 6), ("x", 7), ("y", 8), ("axis x", 7), ("axis z", 8)):
        assert sum(counts(drawn[name])) == n
        assert f"n = {n}" in drawn[name].get_title("left")


def test_gross_errors_are_counted_in_one_hatched_bar_at_the_edge(scores_of):
    scores = scores_of(ONE_CORE)
    scores.loc[[3, 4], "position_error_pct_los"] = [90.0, 4000.0]
    scores.loc[3, "error_trs_x_m"] = -7.0
    drawn = panels(scores)
    norm, x, y = drawn["norm"], drawn["x"], drawn["y"]

    (bar,) = hatched(norm)
    edge = max(b.get_x() + b.get_width() for b in norm.patches if b is not bar)
    assert bar.get_height() == 2
    assert edge < bar.get_x() < bar.get_x() + bar.get_width() < norm.get_xlim()[1] < 10
    assert norm.get_title("left").endswith(f"n = 61, 2 beyond {edge:.3g}")
    assert sum(counts(norm)) == 61
    assert np.count_nonzero(counts(norm)) > 5
    assert [line.get_label() for line in norm.lines] == ["median"]  # the mean has left the scale

    (left,) = hatched(x)
    assert x.get_xlim()[0] < left.get_x() < 0 < x.get_xlim()[1]
    assert "n = 61, 1 outside -" in x.get_title("left")
    assert sum(counts(x)) == 61
    assert not hatched(y)
    assert max(norm.get_xticks()) <= edge * (1 + 1e-9)


def test_fence_follows_the_panel_that_scatters_most():
    narrow, wide = np.array([0.1, -0.1, 0.2]), np.array([-1.0, 1.0, 1.0])
    assert fence([narrow, wide]) == pytest.approx(8.0)
    assert fence([np.empty(0), np.zeros(3)]) == np.inf
    assert fence([np.empty(0)]) == np.inf


@pytest.mark.parametrize("values", [[0.2, 0.4, 1.0], [-3.0, 1.0], [5e-9], []])
def test_edges_hold_all_values_and_are_evenly_spaced(values):
    edges = bin_edges(np.array(values), is_signed=True)
    assert edges[0] <= min([0.0, *values])
    assert edges[-1] > max([0.0, *values])
    np.testing.assert_allclose(np.diff(edges), edges[1] - edges[0])
