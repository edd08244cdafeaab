"""The report end to end, on a small dataset with hand-made scores."""

import re
import shutil
from html import escape
from html.parser import HTMLParser
from pathlib import Path

import h5py
import pandas as pd
import pytest

from tronlab.dataset.schema import TRUTH
from tronlab.errors import ScoreError
from tronlab.report import build, evaluation
from tronlab.report.build import ReportSettings, build_report
from tronlab.report.evaluation import EvaluationSettings
from tronlab.report.worst import reasons_of, worst_answers
from tronlab.score.evaluation.recall import Threshold
from tronlab.score.results import load_results

CORES = {"akaze": 0.004, "akaze-refined": 0.0005, "blind": None}
HOSTILE = "<b>&'\""
PARTED_BY = ("range_los_m", "usable_fraction")
"""What the shots of the small dataset differ in; its record knows no lamp."""


class Parsed(HTMLParser):
    """Links, sources, ids, tag names and text of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.ids: list[str] = []
        self.tags: set[str] = set()
        self.words = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.links += [value for name, value in attrs if name in ("src", "href")]
        self.ids += [value for name, value in attrs if name == "id"]

    def handle_data(self, data):
        self.words += data


@pytest.fixture
def _blank_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Empty files for figures, for what does not depend on them."""
    for name in (
        "error_histograms",
        "error_against_range",
        "error_distribution",
        "contact_sheet",
        "single_picture",
    ):
        monkeypatch.setattr(build, name, lambda *_: None)
    for name in ("consistency_chart", "error_boxes", "recall_curve"):
        monkeypatch.setattr(evaluation, name, lambda *_: None)
    for module in (build, evaluation):
        monkeypatch.setattr(module, "save_chart", empty_chart)
    monkeypatch.setattr(build, "save_picture", empty_picture)


blank_figures = pytest.mark.usefixtures("_blank_figures")


def empty_chart(_figure, folder, stem):
    path = folder / f"{stem}.png"
    path.touch()
    return path


def empty_picture(_figure, folder, stem):
    path = folder / f"{stem}.jpg"
    path.touch()
    return path


def files(directory):
    return {
        str(path.relative_to(directory)): path.read_bytes()
        for name in ("figures", "tables", "report.html")
        for path in [directory / name, *(directory / name).glob("*")]
        if path.is_file()
    }


def test_report_has_all_files(score_by_hand):
    directory = score_by_hand(cores := {"akaze": 0.004})
    page = build_report(directory)
    assert page == directory / "report.html"
    charts = {
        "error_against_range",
        "error_distribution",
        "recall",
        "consistency",
        *(f"boxes_{name}" for name in PARTED_BY),
        *(f"histograms_{core}" for core in cores),
    }
    pictures = {"contact_sheet", *(f"worst_{core}" for core in cores)}
    tables = ("effort", "paper", "statistics", "recall", "consistency", "worst_shots")
    tables += tuple(f"bins_{name}" for name in PARTED_BY)
    assert set(files(directory)) == {
        "report.html",
        *(f"figures/{name}.{ending}" for name in charts for ending in ("png", "pdf")),
        *(f"figures/{name}.jpg" for name in pictures),
        *(f"tables/{name}.{ending}" for name in tables for ending in ("csv", "tex")),
    }
    assert sum(map(len, files(directory).values())) < 3e6
    left_over = {path.name for path in directory.iterdir() if path.name.startswith(".")}
    assert not left_over


@blank_figures
def test_page_needs_nothing_beside_itself(score_by_hand):
    path = build_report(score_by_hand(CORES))
    page = Parsed(path)
    assert all(re.match(r"data:image/(png|jpeg);base64,|#", link) for link in page.links)
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    assert len(page.ids) == len(set(page.ids))
    assert not {"script", "link", "iframe"} & page.tags
    assert not re.search(r"url\(|@import", path.read_text(encoding="utf-8"))
    assert sum(link.startswith("data:") for link in page.links) == 2 * len(CORES) + 7


@blank_figures
def test_page_says_why_beside_picture_and_in_table(score_by_hand):
    directory = score_by_hand({"fine": 0.0005, "blind": None})
    page = build_report(directory).read_text(encoding="utf-8")
    results = load_results(directory)
    keys = [answer.key for answer in worst_answers(results.scores)]
    sentences = {key[0]: reason.sentence for key, reason in reasons_of(results, keys).items()}
    assert sentences["blind"].startswith("No pose: ")
    table = pd.read_csv(directory / "tables" / "worst_shots.csv").groupby("core").first()
    for core, sentence in sentences.items():
        assert page.count(f'<figcaption class="note">{escape(sentence)}</figcaption>') == 1
        assert table.loc[core, "reason"] == sentence


@blank_figures
def test_page_says_whether_truth_can_be_trusted(score_by_hand, small_dataset):
    words = build_report(score_by_hand({"a": 0.001})).read_text()
    assert "2; the model seemed to move by 0.100 mm at most, allowed are 0.5 mm" in words
    assert "no shot is in doubt" in words
    with h5py.File(small_dataset, "r+") as file:
        del file["entry/drift"]
        file["entry/calibration"].attrs["accepted"] = ["it had expired"]
    words = build_report(score_by_hand({"a": 0.001})).read_text()
    assert "none: the truth of no shot is vouched for" in words
    assert "<dt>accepted</dt><dd>it had expired</dd>" in words


@blank_figures
def test_page_says_what_was_measured_and_how(score_by_hand):
    directory = score_by_hand(CORES)
    page = build_report(directory)
    words, html = Parsed(page).words, page.read_text(encoding="utf-8")
    for text in ("straight line", "5 of 5 planned", "Leica T-MAC 1 2", "too few <matches>", "42"):
        assert text in words
    assert "name: straight line\nn: 5  # µ" in words
    # Pictures are of the core with the smallest median.
    assert "5 shots over the range with the inliers of akaze-refined" in html
    # Units of headings are kept whole, but in no file.
    assert "mean [%\N{NO-BREAK SPACE}LOS]" in html
    assert not re.search(r"<th[^>]*>[^<]*\[% LOS\]", html)
    assert r"{[}\% LOS]" in (directory / "tables" / "statistics.tex").read_text(encoding="utf-8")


@blank_figures
def test_hostile_core_name_is_text_everywhere(score_by_hand):
    directory = score_by_hand({HOSTILE: 0.001, "a..b": 0.002, "$x$": 0.003})
    path = build_report(directory)
    page = Parsed(path)
    assert "b" not in page.tags
    assert HOSTILE in page.words
    assert HOSTILE not in path.read_text(encoding="utf-8")
    names = {file.name for file in (directory / "figures").iterdir()}
    assert {"worst__b_.jpg", "worst_a_b.jpg", "worst__x_.jpg"} <= names
    latex = (directory / "tables" / "paper.tex").read_text(encoding="utf-8")
    assert r"\textless{}b\textgreater{}\&" in latex


@blank_figures
def test_second_report_replaces_the_first(score_by_hand):
    directory = score_by_hand({"akaze": 0.004, "blind": None})
    build_report(directory)
    kept = directory / "figures" / "mine.txt"
    kept.write_text("mine")
    first = files(directory)
    score_by_hand({"akaze": 0.008})
    build_report(directory)
    second = files(directory)
    assert not [name for name in second if "blind" in name]
    assert second["tables/statistics.csv"] != first["tables/statistics.csv"]
    assert kept.read_text() == "mine"


@blank_figures
def test_only_core_without_a_pose(score_by_hand):
    page = build_report(score_by_hand({"blind": None}))
    assert "no_pose" in Parsed(page).words
    assert "5 shots over the range with the inliers of blind" in page.read_text(encoding="utf-8")


@blank_figures
def test_without_the_dataset_the_page_says_so(score_by_hand, small_dataset):
    directory = score_by_hand({"akaze": 0.004})
    build_report(directory)
    small_dataset.unlink()
    announced: list[str] = []
    page = Parsed(build_report(directory, announce=announced.append))
    assert announced == [f"report without pictures: {small_dataset}: no such file"]
    assert f"There are none: {small_dataset}: no such file" in page.words
    assert not list((directory / "figures").glob("*.jpg"))
    assert (directory / "figures" / "histograms_akaze.png").is_file()


@blank_figures
def test_dataset_moved_together_with_the_scores_is_found(score_by_hand, small_dataset):
    directory = score_by_hand({"akaze": 0.004})
    shutil.move(small_dataset, directory / "dataset.h5")
    announced: list[str] = []
    build_report(directory, announce=announced.append)
    assert announced == []


@blank_figures
def test_another_dataset_in_its_place_is_stated(score_by_hand, small_dataset):
    directory = score_by_hand({"akaze": 0.004})
    with h5py.File(small_dataset, "r+") as file:
        file[f"{TRUTH}/range_los_m"][2] += 0.01
    announced: list[str] = []
    page = Parsed(build_report(directory, announce=announced.append))
    stated = "is not the dataset that was scored: shot 2 has another range; run tronlab score again"
    assert stated in announced[0]
    assert stated in page.words


@blank_figures
def test_without_scores_the_error_says_what_to_run(tmp_path):
    with pytest.raises(ScoreError, match=r"no scores\.csv there; make it with: tronlab score"):
        build_report(tmp_path)
    assert list(tmp_path.iterdir()) == []


@blank_figures
def test_scores_without_rows(score_by_hand):
    with pytest.raises(ScoreError, match="the scores are empty; run tronlab score again"):
        build_report(score_by_hand({}))


@blank_figures
def test_failure_leaves_the_old_report(score_by_hand, monkeypatch):
    directory = score_by_hand({"akaze": 0.004})
    build_report(directory)
    first = files(directory)
    score_by_hand({"akaze": 0.008})

    def full_disk(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(build, "render_page", full_disk)
    with pytest.raises(ScoreError, match=r"report cannot be written: .*No space left"):
        build_report(directory)
    assert files(directory) == first


@blank_figures
def test_of_many_cores_the_best_are_drawn_and_all_are_in_the_tables(score_by_hand, monkeypatch):
    monkeypatch.setattr(build, "MAX_DRAWN", 2)
    announced: list[str] = []
    directory = score_by_hand({"blind": None, **{f"c{i}": 0.001 * (9 - i) for i in range(4)}})
    words = Parsed(build_report(directory, announce=announced.append)).words
    [told] = announced
    assert told.startswith("pictures are of the 2 of 5 cores with the least median")
    assert told.capitalize() in words
    names = {path.stem for path in (directory / "figures").glob("*_c*")}
    assert names == {f"{kind}_c{i}" for kind in ("histograms", "worst") for i in (2, 3)}
    statistics = pd.read_csv(directory / "tables" / "statistics.csv")
    assert list(statistics["core"].unique()) == ["blind", "c0", "c1", "c2", "c3"]


@blank_figures
def test_long_lists_of_shots_stay_off_the_page(score_by_hand, monkeypatch):
    monkeypatch.setattr(build, "MAX_PAGE_SHOTS", 4)
    words = Parsed(build_report(score_by_hand({"akaze": 0.001}))).words
    assert "Too many shots for this page: see scores.csv." in words


@blank_figures
def test_formats_thresholds_and_edges_are_chosen(score_by_hand):
    directory = score_by_hand({"akaze": 0.001, "blind": None})
    settings = ReportSettings(
        formats=("json", "parquet"),
        evaluation=EvaluationSettings((Threshold(0.05, 0.2),), {"range_los_m": (3.9,)}),
    )
    words = Parsed(build_report(directory, settings=settings)).words
    assert "0.05 % LOS, 0.2 deg" in words
    assert "below 3.9" in words
    tables = directory / "tables"
    assert {path.suffix for path in tables.iterdir()} == {".json", ".parquet"}
    every = pd.read_parquet(tables / "scores.parquet")
    pd.testing.assert_frame_equal(every, load_results(directory).scores, check_dtype=False)
    (tables / "mine.json").touch()
    build_report(directory)
    assert {path.suffix for path in tables.iterdir()} == {".csv", ".tex", ".json"}
    assert [path.name for path in tables.glob("*.json")] == ["mine.json"]


@blank_figures
def test_bins_by_what_nobody_knows_are_refused(score_by_hand):
    directory = score_by_hand({"akaze": 0.001})
    settings = ReportSettings(evaluation=EvaluationSettings(edges={"phase_deg": (30.0,)}))
    with pytest.raises(ScoreError, match="bins by phase_deg: it is not known of any shot"):
        build_report(directory, settings=settings)
