"""``tronlab terrain convert``: a terrain from one file format into another."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tronlab.cli.exit_codes import INTERRUPTED
from tronlab.cli.terrain_files import Force, HeightUnit
from tronlab.terrain.lengths import length_text

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tronlab.campaign.live import Live
    from tronlab.cli.terrain_source import TerrainSource
    from tronlab.terrain.formats.model import Raster


def convert(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="IN", help=".npy, .png, .tif, .img, .lbl or a rig file.", show_default=False
        ),
    ],
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help=".npy (with NAME.json: a terrain model), .tif, .png; .ply, .obj or .stl: a mesh.",
            show_default=False,
        ),
    ],
    *,
    crop_px: Annotated[
        tuple[int, int, int, int] | None,
        typer.Option("--crop", metavar="ROW COLUMN ROWS COLUMNS", help="Part of IN to use."),
    ] = None,
    fill_holes_px: Annotated[
        int, typer.Option("--fill-holes", metavar="SAMPLES", help="Widest hole to fill.")
    ] = 0,
    height_unit_m: HeightUnit = None,
    size_m: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="X Y", help="Extent to lay the map on, along rows and columns."),
    ] = None,
    relief_m: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="From the lowest to the highest (default: to scale with the size)."
        ),
    ] = None,
    spacing_m: Annotated[
        float | None, typer.Option(metavar="M", help="Resample to this distance of samples.")
    ] = None,
    every: Annotated[
        int, typer.Option(min=1, metavar="N", help="Of a mesh alone: use every N-th sample.")
    ] = 1,
    force: Force = False,
) -> None:
    """Convert a terrain between file formats, or into a mesh.

    Holes are filled first, then the map is laid on its size and its heights are scaled, then it is
    resampled. What that and the format of OUT lose is told.
    """
    from dataclasses import replace

    from tronlab.campaign.live import open_live
    from tronlab.cli.terrain_files import check_new
    from tronlab.cli.terrain_source import open_source
    from tronlab.terrain.conversion import Conversion
    from tronlab.terrain.conversion import convert as convert_raster

    _check_out(out, every)
    beside = [out.with_suffix(".json")] if out.suffix == ".npy" else []
    check_new(out, *beside, force=force)
    wanted = Conversion(fill_holes_px, size_m, relief_m, spacing_m)
    try:
        with open_live(sys.stderr) as live:
            source = open_source(
                path, window=crop_px, height_unit_m=height_unit_m, announce=live.announce
            )
            raster, n_filled = convert_raster(
                source.raster,
                wanted,
                announce=live.announce,
                on_progress=lambda n_done, n_all: live.advance(
                    "resampling", n_done=n_done, n_all=n_all
                ),
            )
            steps: dict[str, Any] = {
                "crop_px": crop_px,
                "height_unit_m": height_unit_m,
                "fill_holes_px": fill_holes_px or None,
                "size_m": size_m,
                "relief_m": relief_m,
                "spacing_m": spacing_m,
            }
            done = replace(source, raster=raster, made_by=_made_by(source, path, steps))
            text = _write(done, out, live, every=every, n_filled=n_filled)
    except KeyboardInterrupt:
        typer.echo(f"interrupted: {out} was not written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(text)


def _made_by(source: "TerrainSource", path: Path, steps: "Mapping[str, Any]") -> dict[str, Any]:
    """Give how the result was made: a model that only changes its file stays what it was."""
    taken = {name: value for name, value in steps.items() if value is not None}
    if source.made_by and not taken:
        return dict(source.made_by)
    return {"kind": "converted", "path": str(path), **taken, "source": dict(source.made_by)}


def _check_out(out: Path, every: int) -> None:
    """Refuse a format that cannot be written, and a coarser mesh that is no mesh.

    Raises:
        TerrainError: The suffix is that of no such format, or of one without ``--every``.
    """
    from tronlab.terrain.heightmap import TerrainError
    from tronlab.terrain.raster import MESH_SUFFIXES, WRITABLE_SUFFIXES

    allowed = (*WRITABLE_SUFFIXES, *MESH_SUFFIXES)
    if out.suffix.lower() not in allowed:
        raise TerrainError(f"{out}: cannot be written (allowed: {', '.join(allowed)})")
    if every != 1 and out.suffix.lower() not in MESH_SUFFIXES:
        raise TerrainError(
            f"{out}: --every {every} is for meshes ({', '.join(MESH_SUFFIXES)}); --spacing-m makes"
            " heights coarser"
        )


def _write(source: "TerrainSource", out: Path, live: "Live", *, every: int, n_filled: int) -> str:
    """Write the file; give what to tell about it."""
    from tronlab.terrain.conversion import heightmap_of
    from tronlab.terrain.dem import save_dem
    from tronlab.terrain.raster import MESH_SUFFIXES, write_mesh, write_raster

    raster = source.raster
    if out.suffix.lower() in MESH_SUFFIXES:
        heightmap = heightmap_of(raster, source.origin_trs_m, announce=live.announce)
        write_mesh(
            heightmap,
            out,
            every_n=every,
            announce=live.announce,
            on_progress=lambda n_done, n_all: live.advance("mesh", n_done=n_done, n_all=n_all),
        )
        return f"mesh: {out}"
    if out.suffix.lower() == ".npy":
        heightmap = heightmap_of(raster, source.origin_trs_m, announce=live.announce)
        save_dem(out, heightmap, made_by=source.made_by, n_holes_filled=n_filled)
        return f"terrain: {out}, {_shape(raster)}, origin {_triple(heightmap.origin_trs_m)} m"
    lines = [f"terrain: {out}, {_shape(raster)}", str(write_raster(raster, out))]
    if source.origin_trs_m.any():
        origin = _triple(source.origin_trs_m)
        lines.append(f"not kept in this format: the origin {origin} m in trs")
    return "\n".join(lines)


def _shape(raster: "Raster") -> str:
    rows, columns = raster.height_m.shape
    if raster.spacing_m is None:
        return f"{rows} x {columns} samples"
    return f"{rows} x {columns} samples every {length_text(raster.spacing_m[0])}"


def _triple(point: Any) -> str:
    return " ".join(f"{value:g}" for value in point)
