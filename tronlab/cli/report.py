"""The command ``tronlab report``."""

from pathlib import Path
from typing import Annotated

import typer


def report(
    directory: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Folder that `tronlab score` wrote to.", show_default=False
        ),
    ],
) -> None:
    """Make figures, tables and report.html from a folder of scores."""
    from tronlab.cli.summary import summary_table
    from tronlab.report.build import build_report
    from tronlab.score.results import load_results

    page = build_report(directory, announce=lambda text: typer.echo(text, err=True))
    typer.echo(summary_table(load_results(directory).summary))
    typer.echo(f"\nreport: {page}")
