"""The command ``tronlab score``."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from tronlab.cli.exit_codes import INTERRUPTED


def score(
    dataset: Annotated[
        Path, typer.Argument(metavar="DATASET.h5", help="The recorded dataset.", show_default=False)
    ],
    core: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Navigation core, may be given several times.  [default: the campaign's]",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the results.  [default: the dataset's]"),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(metavar="N", help="Number of processes.  [default: one a processor]"),
    ] = None,
) -> None:
    """Score navigation cores against a recorded dataset."""
    from tronlab.campaign.live import open_live
    from tronlab.cli.summary import missing_poses, summary_table
    from tronlab.score.rescore import score_dataset
    from tronlab.score.results import load_results

    try:
        with open_live(sys.stderr) as live:
            score_dataset(
                dataset,
                cores=core,
                out_dir=out,
                workers=workers,
                progress=lambda done, n: live.advance("score", n_done=done, n_all=n),
                announce=live.announce,
            )
    except KeyboardInterrupt as interrupt:
        typer.echo(str(interrupt) or "interrupted", err=True)
        raise typer.Exit(INTERRUPTED) from None
    folder = out or dataset.parent
    results = load_results(folder)
    typer.echo("\n".join([summary_table(results.summary), *missing_poses(results)]))
    typer.echo(f"\nscores: {folder / 'scores.csv'}")
