"""The page of a study: everything is found from its top, and what is missing is said."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex
from study_tables import rank_table, scores_of, write_scores, write_study

from tronlab.errors import ScoreError
from tronlab.geometry.poses import pose_along_boresight
from tronlab.report.study import gallery, sections
from tronlab.report.study.build import build_study_report
from tronlab.report.study.charts import Measure, error_over_perturbation
from tronlab.report.study.gallery import MaskedView, Scenery, mask_figure
from tronlab.report.study.results import read_study
from tronlab.report.style import AXIS_COLOURS, core_styles
from tronlab.report.trajectory_scene import (
    NOMINAL_COLOUR,
    PERTURBED_COLOUR,
    TRS_COLOURS,
    ModelOutline,
    Points,
    PointsPanel,
    trajectory_figure,
)

MODEL = ModelOutline((0.0, 0.0, 0.1), (2.2, 4.2))
LINE = np.linspace([1.08, 2.08, 4.0], [1.08, 2.08, 1.0], 61)
LOOKING_DOWN = pose_along_boresight(LINE[0], boresight=(0, 0, -1), right=(0, 1, 0))
MASK = np.zeros((40, 50), dtype=bool)
MASK[10:14, 5:30] = True
VIEW = MaskedView(np.full(MASK.shape, 90, np.uint8), MASK, "from <somewhere>")
SCENERY = Scenery(
    MODEL, flown={"dataset_0": LINE}, taken={"dataset_1_nominal": LINE[:12]},
    first_pose=LOOKING_DOWN, first_view=VIEW, rejected={"dataset_1_perturbed": 3},
)  # fmt: skip


@pytest.fixture
def quickly_saved(monkeypatch):
    """Figures are made but not drawn, which takes most of the time; the names of their files."""
    saved = []

    def save(_figure, folder, stem):
        saved.append(stem)
        path = folder / f"{stem}.png"
        path.write_bytes(stem.encode())
        return path

    for module in (gallery, sections):
        monkeypatch.setattr(module, "save_chart", save)
    monkeypatch.setattr(gallery, "save_picture", save)
    return saved


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("written")
    write_study(folder, datasets=("dataset_0", "dataset_1_nominal"))
    return folder


@pytest.fixture
def out(tmp_path, written):
    return Path(shutil.copytree(written, tmp_path / "study"))


def page_of(out: Path) -> str:
    return build_study_report(read_study(out), SCENERY).read_text(encoding="utf-8")


def test_page_has_every_figure_answer_and_link(out, quickly_saved):
    (out / "datasets" / "dataset_0" / "report.html").write_text("")
    (out / "figures").mkdir()
    (out / "figures" / "fig_99.png").write_bytes(b"of an earlier report")
    page = page_of(out)
    numbers = {re.match(r"fig_(\d+)", stem)[1] for stem in quickly_saved if "fig" in stem}
    assert numbers == {"05", "06", "07", "08", "09", "10", "11", "18", "19"}
    assert {"fig_08r", "fig_11r", "fig_19r", "load", "selection", "ablation", "limits"} <= set(
        quickly_saved
    )
    anchors = set(re.findall(r'id="([^"]+)"', page))
    inner = set(re.findall(r'href="#([^"]+)"', page))
    assert {"verdict", "questions", "worst", "larger", "load", "selection", "limits"} <= inner
    assert inner <= anchors
    # From the top to the worst shots is a click, from there to the picture and the reason another.
    assert 'href="worst/dataset_0_akaze.jpg"' in page
    assert 'href="datasets/dataset_0/report.html#worst-akaze"' in page
    assert page.count("the view: 8 inliers within 4 deg") == 20
    for link in re.findall(r'href="([^"#][^"#]*)', page):
        assert (out / link).is_file()
    assert "http" not in page
    assert all(alt for alt in re.findall(r'<img [^>]*alt="([^"]*)"', page))
    assert "from &lt;somewhere&gt;" in page
    figure_19 = re.search(r"Figure 19: norm[^<]*once range and usable fraction are held", page)
    assert figure_19
    assert not (out / "figures" / "fig_99.png").exists()
    assert (out / "tables" / "table_1.tex").is_file()
    assert (out / "tables" / "requirements.csv").is_file()


@pytest.mark.usefixtures("quickly_saved")
def test_page_that_cannot_be_written_leaves_the_old_one(out, monkeypatch):
    (out / "report.html").write_text("the old one")
    monkeypatch.setattr(gallery, "error_histograms", _fails)
    with pytest.raises(ScoreError, match="the report cannot be written: no space left"):
        page_of(out)
    assert (out / "report.html").read_text() == "the old one"
    assert not list(out.glob(".report-*"))


def _fails(*_args, **_options):
    raise OSError("no space left")


def test_trajectories_have_the_papers_colours():
    panel = PointsPanel(
        "both", [Points(LINE + 0.1, is_perturbed=True), Points(LINE)], first_pose=LOOKING_DOWN
    )
    (axes,) = trajectory_figure([panel], MODEL).axes
    dots = {
        line.get_marker(): to_hex(line.get_color())
        for line in axes.get_lines()
        if line.get_linestyle() == "None"
    }
    assert dots == {"x": PERTURBED_COLOUR, "o": NOMINAL_COLOUR}
    lines = [
        to_hex(line.get_color()) for line in axes.get_lines() if len(line.get_data_3d()[0]) == 2
    ]
    assert lines == [*TRS_COLOURS.values(), *AXIS_COLOURS.values()]
    # Plotted as (Z, Y, X): the camera looks along minus Z of trs.
    z_axis = axes.get_lines()[-1].get_data_3d()
    assert np.diff(z_axis[0])[0] < 0
    assert np.diff(z_axis[1:], axis=1) == pytest.approx(0.0, abs=1e-12)


def test_mask_figure_says_what_part_is_usable():
    mask, overlay = mask_figure(VIEW).axes
    assert "5.0 % of the image is usable" in mask.get_title("left")
    tinted = np.ptp(overlay.images[0].get_array(), axis=2) > 0
    assert (tinted == MASK).all()


def test_figure_19_has_the_correlation_of_each_dataset_and_core(out):
    perturbation = read_study(out).tables["perturbation"]
    measures = [
        Measure("plane_distance_pct_los", "plane"),
        Measure("horizontal_distance_pct_los", ""),
    ]
    figure = error_over_perturbation(perturbation, rank_table(), core_styles(["akaze"]), measures)
    for axes in figure.axes:
        texts = [text.get_text() for text in axes.get_legend().get_texts()]
        assert len(texts) == 2
        assert all("rho 0.07 [-0.06, 0.20], p 0.27" in text for text in texts)
    n_drawn = [sum(len(line.get_xdata()) for line in axes.get_lines()) for axes in figure.axes]
    assert n_drawn == [239 + 50] * 2


def test_scores_of_one_dataset_alone_make_a_page_that_says_what_is_missing(tmp_path, quickly_saved):
    write_scores(tmp_path / "datasets" / "dataset_2_nominal", scores_of("dataset_2_nominal"))
    page = build_study_report(read_study(tmp_path), Scenery(MODEL)).read_text(encoding="utf-8")
    assert not {"fig_05", "fig_06", "fig_07", "fig_19"} & set(quickly_saved)
    assert "by 1 of 5 datasets only" in page
    assert "Not part of this study: scores of dataset 0, straight line" in page
    assert "They were not looked for." in page
    for text in (
        "The computational load was not measured.",
        "This study was not taken with the larger terrain.",
        "No way of choosing features and matches was tried.",
        "No sources of error were switched off.",
    ):
        assert page.count(text) == 2  # at the top, and in full
