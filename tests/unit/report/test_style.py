"""The look all figures share."""

from tronlab.report.histograms import error_histograms
from tronlab.report.style import core_styles, save_chart


def test_same_scores_make_the_same_bytes(scores_of, tmp_path):
    saved = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        png = save_chart(error_histograms(scores_of({"akaze": 0.5}), "akaze"), tmp_path / name, "h")
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


def test_every_core_has_a_file_name_of_its_own():
    slugs = [style.slug for style in core_styles(["a b", "a/b", "a.b", "é", ""]).values()]
    assert slugs == ["a_b", "a_b_", "a_b__", "_", "__"]
