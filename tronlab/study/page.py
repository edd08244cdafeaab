"""The report of a study: its figures, tables and page."""

from functools import partial
from pathlib import Path

from tronlab.study.keys import REPORT_CODE, key_of
from tronlab.study.steps import Desk, Step
from tronlab.study.study import Study

PAGE = Path("report.html")
_COST_S = 60.0


def report_steps(study: Study) -> list[Step]:
    """Write the report of what the steps before it made; it says what is not there."""
    step = Step(
        "report of the study",
        key_of(
            code=[*REPORT_CODE, "study/page.py", "study/scenery.py"],
            title=study.config.title,
            quick=study.quick,
        ),
        cost=_COST_S,
        run=partial(_write_report, study=study),
        results=(PAGE,),
    )
    return [step]


def _write_report(desk: Desk, *, study: Study) -> None:
    from tronlab.report.study.build import build_study_report
    from tronlab.report.study.results import read_study
    from tronlab.study.scenery import scenery_of

    results = read_study(desk.out, datasets=study.datasets, larger=study.larger)
    scenery = scenery_of(study, desk, list(results.datasets))
    desk.live.announce("report: drawing figures")
    build_study_report(results, scenery)
