"""``tronlab dataset``: look into a recorded dataset, check it, keep it, exchange it."""

from pathlib import Path
from typing import Annotated

import typer

from tronlab.cli.dataset_exchange import export, import_app
from tronlab.cli.dataset_files import migrate, pack, recompute_truth
from tronlab.cli.dataset_info import info

EXIT_FINDINGS = 1

dataset = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Look into a recorded dataset, check it, keep it, exchange it.",
)
for _command in (info, pack, migrate, recompute_truth, export):
    dataset.command()(_command)
dataset.add_typer(import_app, name="import")

_PathArgument = Annotated[
    Path,
    typer.Argument(metavar="DATASET", help="The .h5 file, or its folder.", show_default=False),
]


@dataset.command()
def validate(
    path: _PathArgument,
    *,
    strict: Annotated[
        bool,
        typer.Option(
            "--strict", help="Let notes fail too: shots missing, flagged or not vouched for."
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check a dataset to the last pixel.

    Exit code 0: sound, though perhaps incomplete, which notes say; 1: damaged or contradicting
    itself, or with --strict worth a note; 2: cannot be opened.
    """
    import json
    import sys
    from dataclasses import asdict

    from tronlab.campaign.live import open_live
    from tronlab.dataset.location import dataset_in
    from tronlab.dataset.validate import examine

    with open_live(sys.stderr) as live:
        found = examine(
            dataset_in(path),
            on_shot=lambda n_done, n_all: live.advance("shots", n_done=n_done, n_all=n_all),
        )
    is_passed = not (found.findings or (strict and found.notes))
    if as_json:
        typer.echo(json.dumps({"is_valid": not found.findings, **asdict(found)}, indent=2))
    else:
        for finding in found.findings:
            typer.echo(finding)
        for note in found.notes:
            typer.echo(f"note: {note}")
        if not found.findings:
            typer.echo("valid")
    if not is_passed:
        raise typer.Exit(EXIT_FINDINGS)


@dataset.command()
def note(
    path: _PathArgument,
    text: Annotated[
        str,
        typer.Argument(
            metavar="TEXT",
            help="What happened; - reads it from standard input.",
            show_default=False,
        ),
    ],
    *,
    author: Annotated[
        str, typer.Option(metavar="NAME", help="Who says so.  [default: the user's name]")
    ] = "",
) -> None:
    """Write a note into a dataset's journal.

    Also while a run records it.
    """
    import getpass
    import sys

    from tronlab.dataset.journal import Journal
    from tronlab.dataset.location import dataset_to_note_in

    words = (sys.stdin.read() if text == "-" else text).strip()
    if not words:
        raise typer.BadParameter("is empty", param_hint="TEXT")
    Journal(dataset_to_note_in(path)).write("note", words, author=author or getpass.getuser())
