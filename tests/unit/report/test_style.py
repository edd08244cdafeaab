"""The look all figures share."""

import pytest

from tronlab.report.curves import error_distribution
from tronlab.report.style import core_styles, save_chart


def test_same_scores_make_the_same_bytes(scores_of, tmp_path):
    scores, saved = scores_of({"akaze": 0.5}), []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        figure = error_distribution(scores, core_styles(["akaze"]))
        png = save_chart(figure, tmp_path / name, "h")
        saved.append((png.read_bytes(), png.with_suffix(".pdf").read_bytes()))
    assert saved[0] == saved[1]
    assert saved[0][0].startswith(b"\x89PNG")
    assert saved[0][1].startswith(b"%PDF")


def test_a_core_looks_alike_in_every_report():
    alone = core_styles(["brisk"])["brisk"]
    assert core_styles(["mine", "akaze", "brisk"])["brisk"] == alone
    styles = core_styles(["akaze", "brisk", "akaze-refined", "brisk-refined", "mine"])
    assert len({style.colour for style in styles.values()}) == 5
    assert len({style.marker for style in styles.values()}) == 5


def test_cores_of_the_same_colour_have_other_lines():
    styles = core_styles([str(i) for i in range(17)]).values()
    assert len({(style.colour, style.line) for style in styles}) == 17


def test_many_names_and_long_ones_take_no_room_from_the_panel(scores_of):
    names = [f"akaze-refined@gate_px={i},robust=ransac,max_ratio=0.8" for i in range(12)]
    scores = scores_of(dict.fromkeys(names, 0.5), n_shots=2)
    figures = [error_distribution(scores, core_styles(some)) for some in (names[:1], names)]
    for figure in figures:
        figure.draw_without_rendering()
    alone, many = (
        figure.axes[0].get_position().transformed(figure.transFigure).size for figure in figures
    )
    assert many == pytest.approx(alone, rel=0.05)
    assert len(figures[1].legends[0].get_texts()) == 12


def test_every_core_has_a_file_name_of_its_own():
    slugs = [style.slug for style in core_styles(["a b", "a/b", "a.b", "é", ""]).values()]
    assert slugs == ["a_b", "a_b_", "a_b__", "_", "__"]
