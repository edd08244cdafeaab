"""Photographs of shots: which are chosen, and what is drawn over them."""

import numpy as np
import pytest
from matplotlib.contour import ContourSet

from tronlab.report.pictures import (
    ShotPicture,
    contact_sheet,
    shot_caption,
    shots_over_range,
    single_picture,
)

UV = np.array([[10.0, 5.0], [30.0, 20.0], [31.5, 40.25]])


@pytest.fixture
def picture(rng):
    mask = np.zeros((48, 64), dtype=np.bool_)
    mask[10:40, 8:50] = True
    image = rng.integers(0, 255, mask.shape, dtype=np.uint8)
    return ShotPicture(image, mask, UV, "shot 1")


def outlines(axes):
    return [artist for artist in axes.get_children() if isinstance(artist, ContourSet)]


def test_sheet_has_each_shot_with_its_outline_and_dots(picture):
    figure = contact_sheet([picture] * 4, "inliers of akaze")
    assert figure.get_suptitle() == "inliers of akaze"
    assert len(figure.axes) == 4
    for axes in figure.axes:
        (dots,) = axes.lines
        np.testing.assert_array_equal(dots.get_xydata(), UV)
        (outline,) = outlines(axes)
        low, high = outline.get_paths()[0].get_extents().get_points()
        np.testing.assert_allclose([low, high], [[7.5, 9.5], [49.5, 39.5]])
        np.testing.assert_array_equal(axes.images[0].get_array(), picture.image)
        assert axes.get_title() == "shot 1"


def test_first_image_row_is_on_top(picture):
    (axes,) = single_picture(picture, "worst").axes
    assert axes.get_ylim() == (47.5, -0.5)
    assert axes.get_xlim() == (-0.5, 63.5)


@pytest.mark.parametrize("is_seen", [True, False])
def test_mask_without_an_edge_has_no_outline(picture, is_seen):
    whole = ShotPicture(picture.image, np.full((48, 64), is_seen), np.empty((0, 2)), "")
    (axes,) = single_picture(whole, "").axes
    assert outlines(axes) == []


def test_black_image_is_drawn(picture):
    black = ShotPicture(np.zeros((48, 64), np.uint16), picture.mask, UV, "")
    single_picture(black, "").canvas.draw()


def test_caption_says_range_and_error_or_why_there_is_none(scores):
    brisk = scores[scores["core"] == "brisk"]
    assert shot_caption(brisk.iloc[0]) == "shot 0, 4.00 m, no_pose"
    text = f"shot 60, 1.00 m, error {brisk.iloc[60]['position_error_pct_los']:.2g} % of LOS"
    assert shot_caption(brisk.iloc[60]) == text


@pytest.mark.parametrize(("n_shots", "n_chosen"), [(1, 1), (5, 5), (12, 12), (61, 12)])
def test_shots_are_spread_over_the_range(scores_of, n_shots, n_chosen):
    rows = scores_of({"akaze": 0.5}, n_shots).sample(frac=1.0, random_state=3)
    chosen = shots_over_range(rows)
    assert len(set(chosen)) == len(chosen) == n_chosen
    assert chosen == sorted(chosen)  # the range falls with the shot id
    assert (chosen[0], chosen[-1]) == (0, n_shots - 1)
