"""The command ``tronlab plan``."""

import sys
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tronlab.cli.exit_codes import INTERRUPTED

if TYPE_CHECKING:
    from tronlab.campaign.foresight import Foresight
    from tronlab.campaign.job import Job
    from tronlab.report.plan import PlanReport

EXIT_CANNOT_RUN = 1


def plan(
    campaign: Annotated[Path, typer.Argument(metavar="CAMPAIGN.yaml", help="Campaign file.")],
    *,
    rig: Annotated[
        Path | None,
        typer.Option(metavar="RIG.yaml", help="Rig file instead of the one the campaign names."),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="RECORD.json",
            help="Calibration record instead of the one the campaign names.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the report; an earlier plan's is replaced (default: out/NAME-plan).",
        ),
    ] = None,
    pictures: Annotated[
        bool,
        typer.Option("--pictures/--no-pictures", help="Draw cell, predicted views and charts."),
    ] = True,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print plan.json instead of the summary.")
    ] = False,
    accept_calibration: Annotated[
        bool,
        typer.Option(
            "--accept-calibration",
            help="Plan with a calibration record that has expired or is of another rig.",
        ),
    ] = False,
) -> None:
    """See before anything moves whether a campaign can run, and how long it takes.

    Every shot is held against reach, collisions, the tracker's line of sight, what will be seen and
    how it will be lit. No device is connected. The exit code is 1 if the run would not begin.
    """
    from tronlab.campaign.acceptance import Acceptance
    from tronlab.campaign.foresight import foresee
    from tronlab.campaign.job import DEFAULT_OUT_DIR, Files, read_job
    from tronlab.campaign.live import open_live
    from tronlab.planning.summary import full_summary
    from tronlab.report.plan import build_plan_report, check_plan_folder, json_document

    begun = datetime.now()
    try:
        with open_live(sys.stderr) as live:
            acceptance = Acceptance(accept_calibration, warn=live.announce)
            job = read_job(Files(campaign, rig, calibration), seed=None, acceptance=acceptance)
            folder = out or DEFAULT_OUT_DIR / f"{job.campaign.name}-plan"
            is_replaced = check_plan_folder(folder)
            live.announce(f"plan of '{job.campaign.name}': no device is connected, nothing moves")
            foresight = foresee(job, job.plan.shots, live=live)
            report = _report(
                job, foresight, begun=begun, has_pictures=pictures, accepted=acceptance.accepted
            )
            live.announce("report: drawing figures")
            page = build_plan_report(
                report,
                folder,
                on_view=lambda n_done, n_all: live.advance(
                    "predicted views", n_done=n_done, n_all=n_all
                ),
            )
    except KeyboardInterrupt:
        typer.echo("interrupted: no report was written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    if as_json:
        typer.echo(json_document(report), nl=False)
    else:
        typer.echo(full_summary(foresight.assessment, begun=begun))
        typer.echo(f"\n{report.verdict}")
        typer.echo(f"report: {page}" + (", the earlier one was replaced" if is_replaced else ""))
    if not report.can_run:
        raise typer.Exit(EXIT_CANNOT_RUN)


def _report(
    job: "Job",
    foresight: "Foresight",
    *,
    begun: datetime,
    has_pictures: bool,
    accepted: list[str],
) -> "PlanReport":
    from tronlab.campaign.provenance import software_versions
    from tronlab.planning.summary import verdict
    from tronlab.report.plan import PlanReport
    from tronlab.report.plan_stage import Stage

    config, assessment = job.campaign.config, foresight.assessment
    can_run, text = verdict(assessment, leaves_out_refused=config.plan.on_refused == "skip")
    rail_range_m = job.rig.config.laboratory.mounting.rail_range_m
    return PlanReport(
        title=f"Plan: {config.title or job.campaign.name}",
        assessment=assessment,
        verdict=text,
        can_run=can_run,
        begun=begun,
        facts=[
            ("campaign", f"{job.campaign.name} ({job.campaign.path})"),
            ("rig", f"{job.rig.name} ({job.rig.path})"),
            ("calibration", str(job.calibration_path)),
            *(("accepted", reason) for reason in accepted),
            ("order of shots", config.plan.order.replace("_", " ")),
            ("planned", f"{begun.astimezone():%Y-%m-%d %H:%M:%S %z}"),
            *((name, version) for name, version in sorted(software_versions().items())),
        ],
        documents={"campaign file": job.campaign.whole_text, "rig file": job.rig.whole_text},
        stage=Stage(foresight.context, rail_range_m) if has_pictures else None,
    )
