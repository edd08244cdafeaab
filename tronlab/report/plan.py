"""The report of a plan: page, pictures, tables and JSON, made and put in place as one."""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory

from tronlab.errors import ConfigError
from tronlab.planning.assessment import PlanAssessment
from tronlab.planning.summary import count_line, end_line
from tronlab.report.page import PageFigure, render_template
from tronlab.report.plan_charts import shot_charts, time_chart
from tronlab.report.plan_scene import elevation_pictures, perspective_picture
from tronlab.report.plan_stage import Stage
from tronlab.report.plan_storyboard import predict_views, story_shots, storyboard
from tronlab.report.plan_tables import (
    checks_table,
    plan_document,
    refused_table,
    shots_table,
)
from tronlab.report.style import save_chart, save_picture
from tronlab.score.evaluation.export import Table, to_csv

PAGE_NAME = "index.html"
DOCUMENT_NAME = "plan.json"
TABLE_NAME = "shots.csv"
MAX_PAGE_SHOTS = 2000
"""More shots than this are not listed on the page, which must stay quick to open."""
MAX_PAGE_REFUSED = 200
_FIGURES = "figures"
_STEMS = ("cell", "cell_elevations", "storyboard", "shots", "time")
"""Figures of an earlier report that the new one may not have."""


@dataclass(frozen=True, slots=True)
class PlanReport:
    """What a plan's report is made from."""

    title: str
    assessment: PlanAssessment
    verdict: str
    """Whether it can run, in one sentence."""
    can_run: bool
    begun: datetime
    """When the run would begin, for the time at which it would be done."""
    facts: Sequence[tuple[str, str]]
    """What the plan was made from, by name."""
    documents: Mapping[str, str]
    """Whole texts by name: campaign and rig."""
    stage: Stage | None
    """None: a report without pictures of cell and views."""


@dataclass(frozen=True, slots=True)
class _Page:
    """Everything the page says."""

    title: str
    verdict: str
    can_run: bool
    count_line: str
    end_line: str
    checks: Table
    refused: Table
    n_refused_more: int
    """Refused shots that are not listed."""
    cell: Sequence[PageFigure]
    storyboard: Sequence[PageFigure]
    storyboard_note: str
    charts: Sequence[PageFigure]
    time: Sequence[PageFigure]
    shots: Table | None
    """None if there are too many for a page."""
    provenance: Sequence[tuple[str, str]]
    documents: Mapping[str, str]


def check_plan_folder(directory: Path) -> bool:
    """See that a folder can take a plan's report; tell whether it has one, which is replaced.

    Raises:
        ConfigError: It is a file, cannot be written, or holds something else.
    """
    if directory.exists() and not directory.is_dir():
        raise ConfigError(f"--out {directory}: is a file, expected a folder; name another")
    nearest = next(p for p in (directory, *directory.absolute().parents) if p.exists())
    if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
        raise ConfigError(
            f"--out {directory}: cannot be made, {nearest} is no folder that can be written to;"
            " name another folder with --out"
        )
    if not directory.is_dir() or not any(directory.iterdir()):
        return False
    if not (directory / DOCUMENT_NAME).is_file():
        raise ConfigError(
            f"--out {directory}: holds other files than a plan's, nothing of others is"
            " overwritten; name another folder with --out"
        )
    return True


def build_plan_report(
    report: PlanReport, directory: Path, *, on_view: Callable[[int, int], None] | None = None
) -> Path:
    """Write ``index.html``, ``plan.json``, ``shots.csv`` and ``figures/`` into a folder.

    Everything is made beside an earlier report first; then each file is replaced, the page last.

    Args:
        report: What to write.
        directory: Where to; it is made if need be.
        on_view: Told (done, all) while the views of the storyboard are rendered.

    Returns:
        The path of the page.

    Raises:
        ConfigError: The folder holds something else, or cannot be written to.
    """
    check_plan_folder(directory)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".plan-", dir=directory) as staging:
            _write(report, Path(staging), on_view)
            _put_in_place(Path(staging), directory)
    except OSError as error:
        raise ConfigError(
            f"--out {directory}: the report cannot be written: {error.strerror};"
            " name another folder with --out"
        ) from error
    return directory / PAGE_NAME


def json_document(report: PlanReport) -> str:
    """Give everything that is known of the plan as JSON."""
    document = {
        "can_run": report.can_run,
        "verdict": report.verdict,
        **plan_document(report.assessment, report.facts),
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def _write(report: PlanReport, folder: Path, on_view: Callable[[int, int], None] | None) -> None:
    (folder / _FIGURES).mkdir()
    shots = shots_table(report.assessment.shots)
    document = json_document(report)
    (folder / TABLE_NAME).write_text(to_csv(shots), encoding="utf-8")
    (folder / DOCUMENT_NAME).write_text(document, encoding="utf-8")
    page = _page(report, shots, folder / _FIGURES, on_view)
    (folder / PAGE_NAME).write_text(render_template("plan.html.j2", page), encoding="utf-8")


def _page(
    report: PlanReport,
    shots: Table,
    figures: Path,
    on_view: Callable[[int, int], None] | None,
) -> _Page:
    assessment, stage = report.assessment, report.stage
    time = PageFigure(save_chart(time_chart(assessment), figures, "time"), alt="Time by part")
    return _Page(
        title=report.title,
        verdict=report.verdict,
        can_run=report.can_run,
        count_line=count_line(assessment),
        end_line=end_line(assessment, begun=report.begun),
        checks=checks_table(assessment),
        refused=refused_table(assessment.refused[:MAX_PAGE_REFUSED]),
        n_refused_more=max(0, len(assessment.refused) - MAX_PAGE_REFUSED),
        cell=_cell(assessment, stage, figures) if stage else (),
        storyboard=_storyboard(assessment, stage, figures, on_view) if stage else (),
        storyboard_note=_storyboard_note(assessment),
        charts=_charts(assessment, stage, figures) if stage else (),
        time=(time,),
        shots=shots if len(assessment.shots) <= MAX_PAGE_SHOTS else None,
        provenance=report.facts,
        documents=report.documents,
    )


def _cell(assessment: PlanAssessment, stage: Stage, figures: Path) -> Sequence[PageFigure]:
    perspective = perspective_picture(stage, assessment.shots)
    elevations = elevation_pictures(stage, assessment.shots)
    return (
        PageFigure(
            save_chart(perspective, figures, "cell"),
            alt="The cell in perspective: model, rail, robot, what the camera sees, tracker, lamp",
        ),
        PageFigure(
            save_chart(elevations, figures, "cell_elevations"),
            alt="The cell from two sides in true scale",
        ),
    )


def _storyboard(
    assessment: PlanAssessment,
    stage: Stage,
    figures: Path,
    on_view: Callable[[int, int], None] | None,
) -> Sequence[PageFigure]:
    views = predict_views(story_shots(assessment.shots), stage.context, on_view=on_view)
    path = save_picture(storyboard(views), figures, "storyboard")
    return (PageFigure(path, alt=f"Predicted views of {len(views)} shots"),)


def _charts(assessment: PlanAssessment, stage: Stage, figures: Path) -> Sequence[PageFigure]:
    path = save_chart(shot_charts(assessment, stage.context), figures, "shots")
    return (PageFigure(path, alt="Figures of every shot with what is allowed"),)


def _storyboard_note(assessment: PlanAssessment) -> str:
    """Say which shots are shown."""
    n_all, n_refused = len(assessment.shots), len(assessment.refused)
    shown = story_shots(assessment.shots)
    if len(shown) == n_all:
        return "All shots." if n_all > 1 else "The shot."
    n_shown = sum(shot.is_refused for shot in shown)
    refused = f", {n_shown} of the {n_refused} refused ones among them" if n_refused else ""
    return f"{len(shown)} of {n_all} shots, evenly chosen{refused}."


def _put_in_place(staging: Path, directory: Path) -> None:
    (directory / _FIGURES).mkdir(exist_ok=True)
    made = {path.name for path in (staging / _FIGURES).iterdir()}
    for name in sorted(made):
        os.replace(staging / _FIGURES / name, directory / _FIGURES / name)
    for name in (TABLE_NAME, DOCUMENT_NAME, PAGE_NAME):
        os.replace(staging / name, directory / name)
    for stem in _STEMS:
        for path in (directory / _FIGURES).glob(f"{stem}.*"):
            if path.name not in made:
                path.unlink()
