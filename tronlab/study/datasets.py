"""Steps that make the study's datasets: record, score, report."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from tronlab.study.calibration import calibration_steps
from tronlab.study.keys import REPORT_CODE, key_of
from tronlab.study.recording import Recording, recording_of, recording_steps
from tronlab.study.steps import Desk, Step
from tronlab.study.study import Study

PAGE_NAME = "report.html"
_REPORT_S = 12.0


def dataset_steps(study: Study, *, larger: bool = False) -> list[Step]:
    """Record, score and report the study's datasets."""
    calibrations = calibration_steps(study)
    steps: list[Step] = []
    for dataset in study.larger if larger else study.datasets:
        recording = recording_of(study, dataset, larger=larger)
        own = [step for step in calibrations if recording.record in step.results]
        steps += recording_steps(study, recording, after=own)
        steps.append(_report_step(recording, after=steps[-1:]))
    return steps


def _report_step(recording: Recording, *, after: Sequence[Step]) -> Step:
    return Step(
        f"report {recording.name}",
        key_of(code=REPORT_CODE, after=after),
        cost=_REPORT_S,
        run=partial(_report, folder=recording.folder),
        results=(recording.folder / PAGE_NAME,),
    )


def _report(desk: Desk, *, folder: Path) -> None:
    from tronlab.report.build import build_report

    desk.live.announce("report: drawing figures")
    build_report(desk.out / folder, announce=desk.live.announce)
