"""What the commands ``tronlab terrain`` write."""

import os
from pathlib import Path
from typing import Annotated

import typer

Force = Annotated[bool, typer.Option("--force", help="Replace a file that is already there.")]
HeightUnit = Annotated[
    float | None,
    typer.Option(metavar="M", help="Height of 1 in a file that does not say its unit."),
]


def check_new(*paths: Path, force: bool) -> None:
    """Refuse to write over a file, or into a folder that is not there or not ours to write to.

    Raises:
        TerrainError: A file exists and ``force`` is not set, or a folder is missing or protected.
    """
    from tronlab.terrain.heightmap import TerrainError

    for path in paths:
        if path.is_dir():
            raise TerrainError(f"{path}: is a folder, expected the name of a file")
        if path.exists() and not force:
            raise TerrainError(f"{path}: exists already; --force replaces it")
        if not path.parent.is_dir():
            raise TerrainError(f"{path}: there is no folder {path.parent}; make it first")
        if not os.access(path.parent, os.W_OK):
            raise TerrainError(f"{path}: the folder {path.parent} cannot be written to")


def check_dem_name(out: Path) -> None:
    """Refuse a name that a terrain model cannot have.

    Raises:
        TerrainError: It does not end in .npy.
    """
    from tronlab.terrain.heightmap import TerrainError

    if out.suffix != ".npy":
        raise TerrainError(f"{out}: a terrain model is written to a file NAME.npy")
