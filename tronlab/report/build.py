"""The report of one scored dataset: figures, tables and the page, written and put in place."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd

from tronlab.errors import ScoreError
from tronlab.report.curves import error_against_range, error_distribution
from tronlab.report.evaluation import EvaluationSettings, evaluate
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
    Reasons,
    cores_of,
    effort_table,
    paper_table,
    shots_table,
    worst_shots_table,
)
from tronlab.report.worst import worst_answers, worst_reasons
from tronlab.score.evaluation.export import (
    WORKBOOK,
    Table,
    TableFormat,
    check_formats,
    frame_table,
    write_tables,
)
from tronlab.score.results import ScoreResults, load_results

PAGE_NAME = "report.html"
MAX_PAGE_SHOTS = 2000
"""More shots of a core than this are not listed on the page, which must stay quick to open."""
MAX_DRAWN = 12
"""More cores than this, as those of a sweep, are told apart in no chart: the best are drawn."""
_OWN_TABLES = (
    "paper",
    "statistics",
    "seeds",
    "recall",
    "bins_*",
    "consistency",
    "effort",
    "worst_shots",
    "scores",
)
_OWN_FILES = (
    "figures/histograms_*",
    "figures/worst_*",
    "figures/contact_sheet.*",
    "figures/boxes_*",
    f"tables/{WORKBOOK}",
    *(f"tables/{n}.{end}" for n in _OWN_TABLES for end in ("csv", "tex", "json", "parquet")),
)
"""Files of an earlier report that the new one may no longer have."""


@dataclass(frozen=True, slots=True)
class _Answer:
    """One answer to a shot."""

    shot_id: int
    seed: int


@dataclass(frozen=True, slots=True)
class ReportSettings:
    """What a person may choose of a report."""

    formats: tuple[TableFormat, ...] = ("csv", "latex")
    """What the tables are written as."""
    evaluation: EvaluationSettings = field(default_factory=EvaluationSettings)


@dataclass(frozen=True, slots=True)
class _Job:
    results: ScoreResults
    settings: ReportSettings
    styles: Mapping[str, CoreStyle]
    """Of each core that is drawn; tables have all."""
    not_drawn: str
    """What a person should know of the others; empty if there are none."""
    worst: Mapping[str, _Answer]
    """Core to its worst answer."""
    reasons: Reasons
    """Why there is no pose, and what dominates the worst errors."""
    sheet: tuple[_Answer, ...]
    """Those of the contact sheet."""
    sheet_core: str
    """The core whose inliers the contact sheet shows."""
    recording: Recording
    staging: Path


def build_report(
    directory: Path,
    *,
    settings: ReportSettings | None = None,
    announce: Callable[[str], None] | None = None,
) -> Path:
    """Write ``figures/``, ``tables/`` and ``report.html`` into a directory that holds scores.

    Everything is made beside the old report first; only then is each file replaced, the page last.

    Args:
        directory: Where ``tronlab score`` wrote its results.
        settings: What of it a person chose.
        announce: Told what a person should know.

    Returns:
        The path of the page.

    Raises:
        ScoreError: The directory holds no scores, they cannot be read, it cannot be written to, or
            a package that a table format needs is not installed.
    """
    say = announce or _keep_quiet
    chosen = settings or ReportSettings()
    check_formats(chosen.formats)
    results = load_results(directory)
    try:
        with TemporaryDirectory(prefix=".report-", dir=directory) as staging:
            job = _job(results, chosen, Path(staging))
            if job.not_drawn:
                say(job.not_drawn)
            if job.recording.missing:
                say(f"report without pictures: {job.recording.missing}")
            page = _make_page(job)
            (job.staging / PAGE_NAME).write_text(render_page(page), encoding="utf-8")
            _put_in_place(job.staging, directory)
    except OSError as error:
        raise ScoreError(f"{directory}: the report cannot be written: {error}") from error
    return directory / PAGE_NAME


def _job(results: ScoreResults, settings: ReportSettings, staging: Path) -> _Job:
    scores = results.scores
    cores = cores_of(scores)
    if not cores:
        raise ScoreError(f"{results.directory}: the scores are empty; run tronlab score again")
    for name in ("figures", "tables"):
        (staging / name).mkdir()
    best = _best_first(scores, cores)
    drawn = [core for core in cores if core in best[:MAX_DRAWN]]
    worst = {
        answer.core: _Answer(answer.shot_id, answer.seed)
        for answer in worst_answers(scores)
        if answer.core in drawn
    }
    sheet_core = best[0]
    of_sheet = _of(scores, sheet_core)
    sheet_seed = int(of_sheet["seed"].iloc[0])
    sheet = tuple(shots_over_range(of_sheet[of_sheet["seed"] == sheet_seed]))
    return _Job(
        results=results,
        settings=settings,
        styles=core_styles(drawn),
        not_drawn=_not_drawn(n_drawn=len(drawn), n_cores=len(cores)),
        worst=worst,
        reasons=worst_reasons(results, drawn),
        sheet=tuple(_Answer(shot_id, sheet_seed) for shot_id in sheet),
        sheet_core=sheet_core,
        recording=read_recording(results, {*sheet, *(answer.shot_id for answer in worst.values())}),
        staging=staging,
    )


def _make_page(job: _Job) -> Page:
    scores = job.results.scores
    paper, effort = paper_table(scores), effort_table(scores)
    worst_shots = worst_shots_table(scores, job.reasons)
    evaluation = evaluate(
        scores, job.styles, settings=job.settings.evaluation, folder=job.staging / "figures"
    )
    _save_tables(job, [paper, *evaluation.tables, effort, worst_shots])
    recording = job.recording
    return Page(
        title=_title(recording),
        paper=paper,
        paper_source=SOURCE,
        evaluation=evaluation,
        effort=effort,
        cores=[_core_section(job, core) for core in job.styles],
        not_drawn=job.not_drawn,
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
    scores, folder = _drawn(job), job.staging / "figures"
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
        [_picture(job, core, answer) for answer in job.sheet], f"inliers of {core}"
    )
    shown = [
        PageFigure(
            save_picture(sheet, folder, "contact_sheet"),
            alt=f"{len(job.sheet)} shots over the range with the inliers of {core}",
        )
    ]
    for core, answer in job.worst.items():
        slug = job.styles[core].slug
        figure = single_picture(_picture(job, core, answer), f"worst shot of {core}")
        shown.append(
            PageFigure(
                save_picture(figure, folder, f"worst_{slug}"),
                alt=f"Worst shot of {core}: shot {answer.shot_id}",
                anchor=f"worst-{slug}",
                core=core,
                note=job.reasons.get((core, answer.seed, answer.shot_id), ""),
            )
        )
    return shown


def _picture(job: _Job, core: str, answer: _Answer) -> ShotPicture:
    rows = _of(job.results.scores, core)
    is_it = (rows["shot_id"] == answer.shot_id) & (rows["seed"] == answer.seed)
    shot = job.recording.images[answer.shot_id]
    return ShotPicture(
        image=shot.image,
        mask=shot.mask,
        uv_inliers=job.results.uv_inliers(core, answer.shot_id, answer.seed),
        caption=shot_caption(rows[is_it].iloc[0]),
    )


def _provenance(results: ScoreResults, recording: Recording) -> list[tuple[str, str]]:
    return [
        ("dataset", results.dataset_path.name),
        *recording.facts,
        ("scored", results.scored_utc),
        ("cores", ", ".join(results.cores)),
        *((f"scored with {name}", text) for name, text in sorted(results.software.items())),
    ]


def _save_tables(job: _Job, tables: Sequence[Table]) -> None:
    """Write the tables of the page; the formats that keep types also have every row of the scores.

    CSV has these already: ``scores.csv``.
    """
    every = frame_table("scores", "Every answer of every core", job.results.scores)
    folder = job.staging / "tables"
    for name in job.settings.formats:
        has_types = name in ("xlsx", "json", "parquet")
        write_tables(folder, [*tables, every] if has_types else tables, [name])


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


def _best_first(scores: pd.DataFrame, cores: Sequence[str]) -> list[str]:
    """Sort cores by their median error; those without a pose come last."""
    solved = scores[scores["status"] == "ok"]
    medians = solved.groupby("core")["position_error_pct_los"].median().dropna()
    return sorted(cores, key=lambda core: medians.get(core, float("inf")))


def _not_drawn(*, n_drawn: int, n_cores: int) -> str:
    if n_drawn == n_cores:
        return ""
    return (
        f"pictures are of the {n_drawn} of {n_cores} cores with the least median position error;"
        " tables are of all"
    )


def _drawn(job: _Job) -> pd.DataFrame:
    """Give the scores of the cores that are drawn."""
    return job.results.scores[job.results.scores["core"].isin(list(job.styles))]


def _of(scores: pd.DataFrame, core: str) -> pd.DataFrame:
    return scores[scores["core"] == core]


def _keep_quiet(_text: str) -> None:
    pass
