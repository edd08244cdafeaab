"""The command ``tronlab run``: record a campaign, go on with one, or take shots of it again."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from tronlab.cli.exit_codes import INTERRUPTED

if TYPE_CHECKING:
    from tronlab.campaign.console import Console
    from tronlab.campaign.live import Live


def run(
    campaign: Annotated[
        Path | None,
        typer.Argument(
            metavar="CAMPAIGN.yaml",
            help="Campaign file; to go on with a dataset it is known.",
            show_default=False,
        ),
    ] = None,
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
            metavar="DIR", help="Folder of the dataset, new or empty (default: out/NAME)."
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, max=2**32 - 1, help="Seed instead of the campaign's.")
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Take the shots that are missing in this dataset."),
    ] = None,
    retake: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Take shots of this dataset again: --failed or --shots. The new ones count, the"
            " old ones stay in the file.",
        ),
    ] = None,
    failed: Annotated[
        bool, typer.Option("--failed", help="Those that are missing or were flagged.")
    ] = False,
    shots: Annotated[
        str | None, typer.Option(metavar="LIST", help="Those of these numbers, as 3,7-9.")
    ] = None,
    accept_calibration: Annotated[
        bool,
        typer.Option(
            "--accept-calibration",
            help="Go on with a calibration record that has expired, is of another rig or other"
            " devices, or whose reflectors have moved; the dataset says so.",
        ),
    ] = False,
    accept_changes: Annotated[
        bool,
        typer.Option(
            "--accept-changes",
            help="Go on with a dataset although plan, rig or calibration record have changed since;"
            " the dataset says so.",
        ),
    ] = False,
) -> None:
    """Run a campaign and record its dataset, or go on with one.

    Ctrl-C pauses after the shot in hand and asks how to go on: resume, take shots again, write a
    note, abort. Ctrl-C again stops the robot at once. Whatever ended a run, be it a power cut,
    --resume takes the shots that are missing; --retake takes shots again.
    """
    from tronlab.campaign.continuation import GivenFiles, parse_shot_ids
    from tronlab.campaign.live import open_live
    from tronlab.campaign.run import resume_campaign, retake_shots, run_campaign

    _check_options(
        campaign,
        going_on={"--resume": resume, "--retake": retake},
        only_new={"--out": out, "--seed": seed},
        only_retake={"--failed": failed or None, "--shots": shots},
        accept_changes=accept_changes,
    )
    shot_ids = None if shots is None else parse_shot_ids(shots)
    files = GivenFiles(campaign, rig, calibration)
    try:
        terminal = sys.stderr  # while the live view is open, a stand-in of it is in sys
        with open_live(terminal) as live:
            console = _console(live, terminal)
            if resume is not None:
                path = resume_campaign(
                    resume,
                    files=files,
                    is_calibration_accepted=accept_calibration,
                    are_changes_accepted=accept_changes,
                    live=live,
                    console=console,
                )
            elif retake is not None:
                path = retake_shots(
                    retake,
                    shot_ids,
                    files=files,
                    is_calibration_accepted=accept_calibration,
                    are_changes_accepted=accept_changes,
                    live=live,
                    console=console,
                )
            else:
                path = run_campaign(
                    _given(campaign),
                    rig_path=rig,
                    calibration_path=calibration,
                    out_dir=out,
                    seed=seed,
                    is_calibration_accepted=accept_calibration,
                    live=live,
                    console=console,
                )
    except KeyboardInterrupt as interrupt:
        typer.echo(str(interrupt) or "interrupted: nothing more was recorded", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(path)


def _check_options(
    campaign: Path | None,
    *,
    going_on: dict[str, Path | None],
    only_new: dict[str, object],
    only_retake: dict[str, object],
    accept_changes: bool,
) -> None:
    """Refuse options that contradict each other.

    Raises:
        BadParameter: Some do.
    """
    modes = [name for name, value in going_on.items() if value is not None]
    if len(modes) == 2:
        raise typer.BadParameter("--resume and --retake: one of them at a time")
    if not modes and campaign is None:
        raise typer.BadParameter("name a CAMPAIGN.yaml, or a dataset with --resume or --retake")
    if modes:
        _refuse(only_new, because=f"{modes[0]} goes on with a dataset as it was begun")
    elif accept_changes:
        raise typer.BadParameter("--accept-changes is for --resume and --retake")
    given = [name for name, value in only_retake.items() if value is not None]
    if modes != ["--retake"]:
        _refuse(only_retake, because="it says what --retake shall take")
    elif len(given) != 1:
        raise typer.BadParameter("--retake needs to know which shots: --failed or --shots 3,7-9")


def _refuse(options: dict[str, object], *, because: str) -> None:
    for name, value in options.items():
        if value is not None:
            raise typer.BadParameter(f"{name}: {because}")


def _given(campaign: Path | None) -> Path:
    if campaign is None:
        raise typer.BadParameter("name a CAMPAIGN.yaml")
    return campaign


def _console(live: "Live", terminal: TextIO) -> "Console | None":
    """Give somebody to ask when the run is paused, if a person sits at a terminal."""
    from tronlab.campaign.console import TerminalConsole

    if not (sys.stdin.isatty() and terminal.isatty()):
        return None
    return TerminalConsole(sys.stdin, terminal, undisturbed=live.suspended)
