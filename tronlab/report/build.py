"""The report of one scored dataset: figures, tables and the page, written and put in place."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd

from tronlab.errors import ScoreError
from tronlab.report.curves import error_against_range, error_distribution
from tronlab.report.histograms import error_histograms
from tronlab.report.page import CoreSection, Page, PageFigure, render_page
from tronlab.report.paper import SOURCE
from tronlab.report.pictures import (
    ShotPicture,
    contact_sheet,
    shot_caption,
    shots_over_range,
    single_picture,
)
from tronlab.report.recording import Recording, read_recording
from tronlab.report.style import CoreStyle, core_styles, save_chart, save_picture
from tronlab.report.tables import (
    Table,
    cores_of,
    effort_table,
    paper_table,
    shots_table,
    statistics_table,
    to_csv,
    to_latex,
    worst_first,
    worst_shots_table,
)
from tronlab.score.results import ScoreResults, load_results

PAGE_NAME = "report.html"
MAX_PAGE_SHOTS = 2000
"""More shots of a core than this are not listed on the page, which must stay quick to open."""
_OWN_FILES = ("figures/histograms_*", "figures/worst_*", "figures/contact_sheet.*")
"""Files of an earlier report that the new one may no longer have."""


@dataclass(frozen=True, slots=True)
class _Job:
    results: ScoreResults
    styles: Mapping[str, CoreStyle]
    worst: Mapping[str, int]
    """Core to the id of its worst shot."""
    sheet: tuple[int, ...]
    """Shots of the contact sheet."""
    sheet_core: str
    """The core whose inliers the contact sheet shows."""
    recording: Recording
    staging: Path


def build_report(directory: Path, *, announce: Callable[[str], None] | None = None) -> Path:
    """Write ``figures/``, ``tables/`` and ``report.html`` into a directory that holds scores.

    Everything is made beside the old report first; only then is each file replaced, the page last.

    Args:
        directory: Where ``tronlab score`` wrote its results.
        announce: Told what a person should know.

    Returns:
        The path of the page.

    Raises:
        ScoreError: The directory holds no scores, they cannot be read, or it cannot be written to.
    """
    say = announce or _keep_quiet
    results = load_results(directory)
    try:
        with TemporaryDirectory(prefix=".report-", dir=directory) as staging:
            job = _job(results, Path(staging))
            if job.recording.missing:
                say(f"report without pictures: {job.recording.missing}")
            page = _make_page(job)
            (job.staging / PAGE_NAME).write_text(render_page(page), encoding="utf-8")
            _put_in_place(job.staging, directory)
    except OSError as error:
        raise ScoreError(f"{directory}: the report cannot be written: {error}") from error
    return directory / PAGE_NAME


def _job(results: ScoreResults, staging: Path) -> _Job:
    scores = results.scores
    cores = cores_of(scores)
    if not cores:
        raise ScoreError(f"{results.directory}: the scores are empty; run tronlab score again")
    for name in ("figures", "tables"):
        (staging / name).mkdir()
    worst = {core: int(worst_first(_of(scores, core))["shot_id"].iloc[0]) for core in cores}
    sheet_core = _best_core(scores, cores)
    sheet = tuple(shots_over_range(_of(scores, sheet_core)))
    return _Job(
        results=results,
        styles=core_styles(cores),
        worst=worst,
        sheet=sheet,
        sheet_core=sheet_core,
        recording=read_recording(results, {*sheet, *worst.values()}),
        staging=staging,
    )


def _make_page(job: _Job) -> Page:
    scores, reasons = job.results.scores, job.results.reasons
    paper, statistics = paper_table(scores), statistics_table(scores)
    worst_shots = worst_shots_table(scores, reasons)
    effort = effort_table(scores)
    for table in (paper, statistics, effort, worst_shots):
        _save_table(table, job.staging / "tables")
    recording = job.recording
    return Page(
        title=_title(recording),
        paper=paper,
        paper_source=SOURCE,
        statistics=statistics,
        effort=effort,
        cores=[_core_section(job, core) for core in job.styles],
        curves=_curves(job),
        pictures=[] if recording.missing else _pictures(job),
        pictures_missing=recording.missing,
        worst_shots=worst_shots,
        provenance=_provenance(job.results, recording),
        documents=recording.documents,
    )


def _title(recording: Recording) -> str:
    campaign = dict(recording.facts).get("campaign", "")
    return f"Navigation errors: {campaign}" if campaign else "Navigation errors"


def _core_section(job: _Job, core: str) -> CoreSection:
    scores, slug = job.results.scores, job.styles[core].slug
    path = save_chart(error_histograms(scores, core), job.staging / "figures", f"histograms_{slug}")
    is_listed = len(_of(scores, core)) <= MAX_PAGE_SHOTS
    return CoreSection(
        name=core,
        anchor=f"histograms-{slug}",
        histograms=PageFigure(path, alt=f"Error histograms of {core}"),
        shots=shots_table(scores, core, job.results.reasons) if is_listed else None,
    )


def _curves(job: _Job) -> list[PageFigure]:
    scores, folder = job.results.scores, job.staging / "figures"
    against_range = error_against_range(scores, job.styles)
    distribution = error_distribution(scores, job.styles)
    return [
        PageFigure(
            save_chart(against_range, folder, "error_against_range"),
            alt="Position error of each shot against its range",
        ),
        PageFigure(
            save_chart(distribution, folder, "error_distribution"),
            alt="Cumulative distribution of the position error",
        ),
    ]


def _pictures(job: _Job) -> list[PageFigure]:
    folder = job.staging / "figures"
    core = job.sheet_core
    sheet = contact_sheet(
        [_picture(job, core, shot_id) for shot_id in job.sheet], f"inliers of {core}"
    )
    shown = [
        PageFigure(
            save_picture(sheet, folder, "contact_sheet"),
            alt=f"{len(job.sheet)} shots over the range with the inliers of {core}",
        )
    ]
    for core, shot_id in job.worst.items():
        slug = job.styles[core].slug
        figure = single_picture(_picture(job, core, shot_id), f"worst shot of {core}")
        shown.append(
            PageFigure(
                save_picture(figure, folder, f"worst_{slug}"),
                alt=f"Worst shot of {core}: shot {shot_id}",
                anchor=f"worst-{slug}",
                core=core,
            )
        )
    return shown


def _picture(job: _Job, core: str, shot_id: int) -> ShotPicture:
    rows = _of(job.results.scores, core)
    shot = job.recording.images[shot_id]
    return ShotPicture(
        image=shot.image,
        mask=shot.mask,
        uv_inliers=job.results.uv_inliers(core, shot_id),
        caption=shot_caption(rows[rows["shot_id"] == shot_id].iloc[0]),
    )


def _provenance(results: ScoreResults, recording: Recording) -> list[tuple[str, str]]:
    return [
        ("dataset", results.dataset_path.name),
        *recording.facts,
        ("scored", results.scored_utc),
        ("cores", ", ".join(results.cores)),
        *((f"scored with {name}", text) for name, text in sorted(results.software.items())),
    ]


def _save_table(table: Table, folder: Path) -> None:
    (folder / f"{table.name}.csv").write_text(to_csv(table), encoding="utf-8")
    (folder / f"{table.name}.tex").write_text(to_latex(table), encoding="utf-8")


def _put_in_place(staging: Path, directory: Path) -> None:
    """Move the finished files over those of an earlier report, and remove what it had more."""
    made = [path for name in ("figures", "tables") for path in sorted((staging / name).iterdir())]
    for path in made:
        target = directory / path.relative_to(staging)
        target.parent.mkdir(exist_ok=True)
        os.replace(path, target)
    os.replace(staging / PAGE_NAME, directory / PAGE_NAME)
    kept = {directory / path.relative_to(staging) for path in made}
    for pattern in _OWN_FILES:
        for path in set(directory.glob(pattern)) - kept:
            path.unlink()


def _best_core(scores: pd.DataFrame, cores: list[str]) -> str:
    """Give the core with the smallest median error; the first one if none has a pose."""
    solved = scores[scores["status"] == "ok"]
    medians = solved.groupby("core", sort=False)["position_error_pct_los"].median().dropna()
    return str(medians.idxmin()) if len(medians) else cores[0]


def _of(scores: pd.DataFrame, core: str) -> pd.DataFrame:
    return scores[scores["core"] == core]


def _keep_quiet(_text: str) -> None:
    pass
