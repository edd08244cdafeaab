"""Pictures of a terrain show the numbers they are made of."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from tronlab.report.style import new_figure
from tronlab.report.terrain import TerrainSubject, save_sheet, terrain_sheet
from tronlab.report.terrain_charts import crater_verdict, draw_crater_counts, draw_deviograms
from tronlab.report.terrain_maps import (
    TerrainMap,
    relief_picture,
    round_length,
    shading,
)
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.crater_counts import CraterCounts
from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.lengths import length_text
from tronlab.terrain.procedural import make_terrain
from tronlab.terrain.statistics import Deviogram, SelfAffine, hurst_fit

FAR = 1e6


def cone(shape=(41, 61)):
    """A cone in the middle of level ground, 10 mm high, 45 degrees steep, every millimetre."""
    i, j = np.indices(shape)
    distance = np.hypot(i - shape[0] // 2, j - shape[1] // 2)
    return TerrainMap(0.001 * np.maximum(10.0 - distance, 0.0), (0.001, 0.001), (2.0, 3.0))


def test_the_map_lies_where_the_model_does_with_x_down_and_y_right():
    assert cone().extent_m == pytest.approx((3.0, 3.061, 2.041, 2.0))


def test_slopes_that_face_the_light_are_brighter_by_lamberts_law():
    """Light from -X, 45 degrees high: on a slope of 45 degrees it falls straight down."""
    brightness = shading(cone(), np.array([-FAR, 3.03, FAR]))
    assert brightness[2, 2] == pytest.approx(1.0, abs=1e-3), "level ground"
    assert brightness[15, 30] == pytest.approx(np.sqrt(2), rel=0.01), "the side up the map"
    assert brightness[25, 30] == pytest.approx(0.0, abs=0.01), "the side down the map"
    # On the flanks the normal is (0, +-1, 1) / sqrt(2), the light (-1, 0, 1) / sqrt(2).
    assert brightness[20, 25] == pytest.approx(0.5 * np.sqrt(2), rel=0.01)
    assert brightness[20, 35] == pytest.approx(0.5 * np.sqrt(2), rel=0.01)


def test_a_lamp_near_by_lights_from_its_side():
    level = TerrainMap(np.zeros((11, 11)), (0.1, 0.1), (0.0, 0.0))
    brightness = shading(level, np.array([0.0, 0.55, 0.5]))
    assert np.all(np.diff(brightness[:, 5]) < 0), "the light falls off from the top down"
    # Cosine of incidence at 0.55 m below the light, whose foot lies 0.05 m from the first row.
    expected = np.cos(np.arctan2(0.55, 0.5))
    assert brightness[5, 5] / np.linalg.norm([0.55, 0.5]) * 0.5 == pytest.approx(expected, rel=1e-6)


def test_a_hole_has_a_colour_of_its_own():
    terrain = cone()
    terrain.height_m[5, 6] = np.nan
    picture = relief_picture(terrain, np.array([-FAR, 3.03, FAR]))
    red, green, blue = picture[5, 6]
    assert red > 0.8
    assert max(green, blue) < 0.2
    assert np.isfinite(picture).all()


@pytest.mark.parametrize(
    ("length_m", "text"),
    [(0.0005, "0.5 mm"), (0.05, "50 mm"), (2.2, "2.2 m"), (38250.0, "38.25 km"), (5e-6, "5 um")],
)
def test_lengths_are_told_in_a_fitting_unit(length_m, text):
    assert length_text(length_m) == text


@pytest.mark.parametrize(("most", "length"), [(1.05, 1.0), (0.2, 0.2), (0.049, 0.02), (790, 500)])
def test_scale_bars_have_round_lengths(most, length):
    assert round_length(most) == pytest.approx(length)


def test_craters_are_drawn_with_their_errors_on_the_law():
    config = ProceduralTerrain(crater_density_per_m2=0.1, crater_exponent=2, crater_smallest_m=0.01)
    counts = CraterCounts(np.array([0.01, 0.1]), np.array([9000, 16]), area_m2=8.0)
    axes = new_figure(4, 3).add_subplot()
    draw_crater_counts(axes, counts, config)
    points, _, bars = axes.containers[0]
    np.testing.assert_allclose(points.get_ydata(), [9000 / 8, 2.0])
    np.testing.assert_allclose(bars[0].get_segments()[1][:, 1], [1.5, 2.5])
    cut_off = next(line for line in axes.lines if "cut off" in str(line.get_label()))
    diameter, density = np.asarray(cut_off.get_xdata()), np.asarray(cut_off.get_ydata())
    assert (diameter[0], density[0]) == pytest.approx((0.01, 0.1 * (1e4 - 0.8**-2)))
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    n_law = 0.1 * (1e4 - 0.8**-2) * 8
    sigmas = (9000 - n_law) / np.sqrt(n_law)
    assert (
        crater_verdict(counts, config) == f"9000 craters, law: 7999, difference {sigmas:+.1f} sigma"
    )


def test_the_fit_and_what_was_asked_for_are_in_the_deviogram():
    step_m = np.geomspace(0.001, 0.1, 9)
    asked = SelfAffine(0.7, slope=0.1, base_m=0.01)
    exact = Deviogram(step_m, asked.deviation_m(step_m))
    axes = new_figure(4, 3).add_subplot()
    fit = hurst_fit([exact, exact], 0.0005)
    draw_deviograms(axes, [("X", exact), ("Y", exact)], fit, asked)
    labels = [str(line.get_label()) for line in axes.lines]
    assert labels == ["along X", "along Y", "fit: H = 0.70", "roughness asked for: H = 0.7"]
    np.testing.assert_allclose(axes.lines[2].get_ydata(), axes.lines[3].get_ydata(), rtol=1e-9)


def panels(figure: Figure) -> dict[str, str]:
    """Give the title of each panel, or the note that stands in it, by what it shows."""
    return {
        axes.get_xlabel() or axes.get_ylabel(): axes.get_title(loc="left")
        or "".join(text.get_text() for text in axes.texts)
        for axes in figure.axes
    }


def test_a_sheet_of_a_procedural_terrain_has_every_panel():
    config = ProceduralTerrain(size_m=(0.1, 0.15), spacing_m=0.002, relief_m=0.02)
    steps: list[tuple[int, int]] = []
    figure = terrain_sheet(
        TerrainSubject(
            "test", make_terrain(config), (0.002, 0.002), np.array(config.origin_trs_m), config
        ),
        on_progress=lambda *step: steps.append(step),
    )
    shown = panels(figure)
    assert steps[-1] == (51, 51)
    assert any("craters, law:" in title for title in shown.values())
    assert "slope over 4 mm [deg]" in shown
    assert "profile at X = 0.03 m" in shown["Y [m]"]


def test_a_picture_appears_when_it_is_complete(tmp_path):
    for name, begins in (("a.png", b"\x89PNG"), ("a.jpg", b"\xff\xd8"), ("a.pdf", b"%PDF")):
        save_sheet(new_figure(1, 1), tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(begins)
    assert len(list(tmp_path.iterdir())) == 3


def test_a_sheet_of_anything_else_says_what_it_lacks():
    heights = np.full((30, 40), 5.0)
    heights[3:5, 7] = np.nan
    figure = terrain_sheet(TerrainSubject("flat", heights, (0.01, 0.02), np.zeros(3)))
    notes = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert "no law of craters is known" in notes
    assert "too small or too flat\nfor a power law" in notes


def test_what_cannot_be_drawn_is_said(tmp_path):
    holes = TerrainSubject("holes", np.full((9, 9), np.nan), (0.1, 0.1), np.zeros(3))
    with pytest.raises(TerrainError, match="holes: has no heights to draw"):
        terrain_sheet(holes)
    below = TerrainSubject(
        "low", np.eye(9), (0.1, 0.1), np.zeros(3), p_lamp_trs_m=np.array([0.0, 0.0, 0.5])
    )
    with pytest.raises(TerrainError, match=r"lamp at \[0.0, 0.0, 0.5\] m is not above"):
        terrain_sheet(below)
    with pytest.raises(TerrainError, match=r"ends in one of \.png, \.jpg, \.pdf"):
        save_sheet(new_figure(1, 1), tmp_path / "a.gif")
    with pytest.raises(TerrainError, match="cannot be written: No such file"):
        save_sheet(new_figure(1, 1), tmp_path / "nowhere" / "a.png")
