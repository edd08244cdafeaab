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
    tables: Annotated[
        str,
        typer.Option(
            metavar="FORMAT,...",
            help="What tables are written as: csv, latex, xlsx, json, parquet.",
        ),
    ] = "csv,latex",
    recall: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PCT,DEG",
            help="What counts as solved: position in % of the line of sight and rotation in deg;"
            " may be given several times.  [default: 0.1,0.1 0.3,0.3 1,1 3,3]",
        ),
    ] = None,
    bins: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COLUMN=EDGE,...",
            help="Edges between bins of range_los_m, phase_deg or usable_fraction.  [default:"
            " quartiles]",
        ),
    ] = None,
) -> None:
    """Make figures, tables and report.html from a folder of scores."""
    from tronlab.cli.summary import summary_table
    from tronlab.report.build import ReportSettings, build_report
    from tronlab.report.evaluation import EvaluationSettings
    from tronlab.score.evaluation.bins import parse_edges
    from tronlab.score.evaluation.export import parse_formats
    from tronlab.score.evaluation.recall import THRESHOLDS, parse_threshold
    from tronlab.score.results import load_results

    settings = ReportSettings(
        formats=parse_formats(tables),
        evaluation=EvaluationSettings(
            thresholds=tuple(map(parse_threshold, recall)) if recall else THRESHOLDS,
            edges=dict(map(parse_edges, bins or [])),
        ),
    )
    page = build_report(
        directory, settings=settings, announce=lambda text: typer.echo(text, err=True)
    )
    typer.echo(summary_table(load_results(directory).summary))
    typer.echo(f"\nreport: {page}")
