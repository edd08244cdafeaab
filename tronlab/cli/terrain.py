"""``tronlab terrain``: make a terrain, look at it, bring it from one form into another."""

import typer

from tronlab.cli.terrain_convert import convert
from tronlab.cli.terrain_info import info
from tronlab.cli.terrain_make import make
from tronlab.cli.terrain_scan import scan
from tronlab.cli.terrain_view import view

terrain = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Make a terrain, look at it, bring it from one form into another.",
)
for _command in (make, info, convert, view, scan):
    terrain.command()(_command)
