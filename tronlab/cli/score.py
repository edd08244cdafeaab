"""The command ``tronlab score``."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

EXIT_INTERRUPTED = 130


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
    from tronlab.cli.summary import summary_table
    from tronlab.score.rescore import score_dataset

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
        raise typer.Exit(EXIT_INTERRUPTED) from None
    folder = out or dataset.parent
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    typer.echo(summary_table(summary))
    typer.echo(f"\nscores: {folder / 'scores.csv'}")
