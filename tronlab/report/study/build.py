"""The report of a study: figures, tables and the page, written and put in place."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from tronlab.errors import ScoreError
from tronlab.report.paper import DATASETS
from tronlab.report.study.gallery import Scenery, draw_gallery
from tronlab.report.study.page import StudyPage, WorstShot, render_study
from tronlab.report.study.requirements import (
    requirements,
    requirements_table,
    verdict_sentence,
)
from tronlab.report.study.results import DATASETS_FOLDER, LARGER_FOLDER, StudyResults
from tronlab.report.study.sections import (
    Studio,
    beyond_sections,
    published_section,
    question_sections,
)
from tronlab.report.study.shortfalls import bound_shortfalls
from tronlab.score.evaluation.export import TableFormat, write_tables

PAGE_NAME = "report.html"
_FORMATS: tuple[TableFormat, ...] = ("csv", "latex")


def build_study_report(results: StudyResults, scenery: Scenery) -> Path:
    """Draw the figures, write the tables and the page into the folder of a study.

    They are put in place once all are made; those of an earlier report go.

    Args:
        results: Its tables.
        scenery: What figures need besides.

    Returns:
        The page.

    Raises:
        ScoreError: The files cannot be written, or no dataset was scored.
    """
    out = results.folder
    try:
        with TemporaryDirectory(prefix=".report-", dir=out) as staging:
            folder = Path(staging)
            for name in ("figures", "tables"):
                (folder / name).mkdir()
            page = _make_page(results, scenery, folder / "figures")
            write_tables(folder / "tables", page.tables, _FORMATS)
            (folder / PAGE_NAME).write_text(render_study(page), encoding="utf-8")
            _put_in_place(folder, out)
    except OSError as error:
        raise ScoreError(f"{out}: the report cannot be written: {error}") from error
    return out / PAGE_NAME


def _make_page(results: StudyResults, scenery: Scenery, folder: Path) -> StudyPage:
    studio = Studio.of(results, folder)
    found = requirements(results)
    info = results.info
    return StudyPage(
        title=str(info.get("title") or "The paper's study"),
        verdict=verdict_sentence(found, n_datasets=len(results.datasets)),
        missing=results.missing,
        requirements=requirements_table(found),
        shortfalls=bound_shortfalls(results),
        questions=question_sections(studio),
        worst=list(_worst_shots(results)),
        published=published_section(results, scenery),
        plates=draw_gallery(results, scenery, folder),
        beyond=beyond_sections(studio),
        datasets=list(_dataset_pages(results)),
        provenance=[
            ("folder", results.folder.resolve().name),
            ("kind", "quick: parts are left out" if results.is_quick else "full"),
            *((f"with {name}", str(text)) for name, text in info.get("software", {}).items()),
        ],
    )


def _worst_shots(results: StudyResults) -> Iterator[WorstShot]:
    worst = results.tables.get("worst", pd.DataFrame())
    for row in worst.to_dict("records"):
        error = float(str(row["error_pct_los"]))
        name = str(row["dataset"])
        yield WorstShot(
            dataset=DATASETS[name].title if name in DATASETS else name,
            core=str(row["core"]),
            shot_id=int(str(row["shot_id"])),
            error=f"{error:.3g}" if np.isfinite(error) else "no pose",
            reason=row["reason"] if isinstance(row["reason"], str) else "",
            picture=_link(results.folder, row["picture"]),
            page=_link(results.folder, row["page"]),
        )


def _link(out: Path, target: object) -> str:
    """Give a link relative to the page if it leads anywhere; pages are made before this one."""
    link = target if isinstance(target, str) else ""
    return link if link and (out / link.partition("#")[0]).is_file() else ""


def _dataset_pages(results: StudyResults) -> Iterator[tuple[str, str]]:
    for folder, names, suffix in (
        (DATASETS_FOLDER, results.datasets, ""),
        (LARGER_FOLDER, results.larger, ", larger terrain"),
    ):
        for name in names:
            link = _link(results.folder, f"{folder}/{name}/{PAGE_NAME}")
            if link:
                yield f"{DATASETS[name].title}{suffix}", link


def _put_in_place(staging: Path, out: Path) -> None:
    """Move the finished files over those of an earlier report, and remove what it had more."""
    for name in ("figures", "tables"):
        made = sorted((staging / name).iterdir())
        (out / name).mkdir(exist_ok=True)
        for path in made:
            os.replace(path, out / name / path.name)
        _remove_others(out / name, [path.name for path in made])
    os.replace(staging / PAGE_NAME, out / PAGE_NAME)


def _remove_others(folder: Path, kept: Sequence[str]) -> None:
    for path in folder.iterdir():
        if path.is_file() and path.name not in kept:
            path.unlink()
