"""The command ``tronlab run``."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from tronlab.cli.exit_codes import INTERRUPTED


def run(
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
            metavar="DIR", help="Folder of the dataset, new or empty (default: out/NAME)."
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, max=2**32 - 1, help="Seed instead of the campaign's.")
    ] = None,
    accept_calibration: Annotated[
        bool,
        typer.Option(
            "--accept-calibration",
            help="Go on with a calibration record that has expired, is of another rig or other"
            " devices, or whose reflectors have moved; the dataset says so.",
        ),
    ] = False,
) -> None:
    """Run a campaign and record its dataset."""
    from tronlab.campaign.live import open_live
    from tronlab.campaign.run import run_campaign

    try:
        with open_live(sys.stderr) as live:
            path = run_campaign(
                campaign,
                rig_path=rig,
                calibration_path=calibration,
                out_dir=out,
                seed=seed,
                is_calibration_accepted=accept_calibration,
                live=live,
            )
    except KeyboardInterrupt as interrupt:
        typer.echo(str(interrupt) or "interrupted: nothing was recorded", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(path)
