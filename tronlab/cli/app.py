"""The command ``tronlab``: its sub-commands, and how errors reach a person.

Only typer is imported here; whatever a command needs it imports when it runs, so that ``--help``
stays instant.
"""

import sys
from collections.abc import Sequence

import typer

from tronlab.cli.budget import budget
from tronlab.cli.calibrate import calibrate
from tronlab.cli.compare import compare
from tronlab.cli.database import database
from tronlab.cli.dataset import dataset
from tronlab.cli.demo import demo
from tronlab.cli.exit_codes import INTERRUPTED, USER_ERROR
from tronlab.cli.plan import plan
from tronlab.cli.render import render
from tronlab.cli.report import report
from tronlab.cli.rig import rig
from tronlab.cli.run import run
from tronlab.cli.score import score
from tronlab.cli.study import study
from tronlab.cli.terrain import terrain
from tronlab.cli.trajectory import trajectory
from tronlab.cli.twin import twin
from tronlab.errors import TronlabError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Test campaigns for optical navigation: plan, run, score and report.",
)
for command in (demo, plan, trajectory, render, run, score, report, compare, study, budget):
    app.command()(command)
app.add_typer(calibrate, name="calibrate")
app.add_typer(database, name="database")
app.add_typer(dataset, name="dataset")
app.add_typer(rig, name="rig")
app.add_typer(terrain, name="terrain")
app.add_typer(twin, name="twin")


@app.callback(invoke_without_command=True)
def _root(
    version: bool = typer.Option(False, "--version", help="Print the version and exit."),
) -> None:
    if version:
        from tronlab import __version__

        typer.echo(f"tronlab {__version__}")
        raise typer.Exit


def main() -> None:
    """Run the command line: a user's mistake is one message and exit code 2, never a traceback."""
    try:
        app()
    except TronlabError as error:
        _fail([error])
    except ExceptionGroup as group:
        ours, others = group.split(TronlabError)
        if others is not None or ours is None:
            raise
        _fail(ours.exceptions)
    except SystemExit as end:
        # typer turns Ctrl-C into its own Exit and leaves without a word
        if isinstance(getattr(end.__context__, "__cause__", None), KeyboardInterrupt):
            typer.echo("interrupted", err=True)
        raise
    except KeyboardInterrupt:
        typer.echo("interrupted", err=True)
        sys.exit(INTERRUPTED)


def _fail(errors: Sequence[BaseException]) -> None:
    for error in errors:
        typer.echo(f"error: {error}", err=True)
    sys.exit(USER_ERROR)
