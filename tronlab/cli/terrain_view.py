"""``tronlab terrain view``: a terrain on one sheet."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tronlab.cli.exit_codes import INTERRUPTED
from tronlab.cli.terrain_files import Force, HeightUnit

if TYPE_CHECKING:
    from tronlab.cli.terrain_source import TerrainSource
    from tronlab.report.terrain import TerrainSubject


def view(
    path: Annotated[
        Path,
        typer.Argument(metavar="FILE|RIG.yaml", help="Heights, or a rig file.", show_default=False),
    ],
    *,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help=".png, .jpg or .pdf (default: NAME-terrain.png here)."),
    ] = None,
    lamp_trs_m: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            "--lamp",
            metavar="X Y Z",
            help="Where the light is, metres in trs (default: the rig's lamp, else upper left).",
        ),
    ] = None,
    height_unit_m: HeightUnit = None,
    force: Force = False,
) -> None:
    """Draw a terrain: shaded relief, slopes, a profile, craters and roughness.

    Craters and roughness of a terrain made from a seed are drawn with what was asked for.
    """
    from dataclasses import replace

    import numpy as np

    from tronlab.campaign.live import open_live
    from tronlab.cli.terrain_files import check_new
    from tronlab.cli.terrain_source import open_source
    from tronlab.report.terrain import check_suffix, save_sheet, terrain_sheet

    picture = out or Path(f"{path.stem}-terrain.png")
    check_suffix(picture)
    check_new(picture, force=force)
    try:
        with open_live(sys.stderr) as live:
            source = open_source(path, height_unit_m=height_unit_m, announce=live.announce)
            subject = _subject(source, path)
            if lamp_trs_m is not None:
                subject = replace(subject, p_lamp_trs_m=np.array(lamp_trs_m, dtype=np.float64))
            figure = terrain_sheet(
                subject,
                on_progress=lambda n_done, n_all: live.advance(
                    "averaging", n_done=n_done, n_all=n_all
                ),
            )
            save_sheet(figure, picture)
    except KeyboardInterrupt:
        typer.echo("interrupted: no picture was written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(f"terrain: {picture}")


def _subject(source: "TerrainSource", path: Path) -> "TerrainSubject":
    """Give what is drawn: maps of no unit have no slopes."""
    from tronlab.report.terrain import TerrainSubject
    from tronlab.terrain.heightmap import TerrainError

    raster = source.raster
    if raster.spacing_m is None or not raster.has_unit:
        what = "spacing" if raster.has_unit else "unit of height"
        unit = "" if raster.spacing_m is None else "give it with --height-unit-m, or "
        raise TerrainError(
            f"{path}: does not say its {what}, which slopes need; {unit}make a model of it first:"
            f" tronlab terrain convert {path} NAME.npy --size-m X Y --relief-m Z"
        )
    return TerrainSubject(
        source.name,
        raster.height_m,
        raster.spacing_m,
        source.origin_trs_m,
        source.asked,
        source.p_lamp_trs_m,
    )
