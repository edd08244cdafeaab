"""``tronlab database``: make a file of landmarks, look at it, prune it."""

import typer

from tronlab.cli.database_build import build
from tronlab.cli.database_info import info
from tronlab.cli.database_prune import prune

database = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Make a file of landmarks for navigation cores, look at it, prune it.",
)
for _command in (build, info, prune):
    database.command()(_command)
