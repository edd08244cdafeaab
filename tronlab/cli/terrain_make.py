"""``tronlab terrain make``: a terrain from a seed, as a file."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tronlab.cli.exit_codes import INTERRUPTED
from tronlab.cli.terrain_files import Force

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from tronlab.cli.terrain_source import NamedTerrain


def make(
    path: Annotated[
        Path | None,
        typer.Argument(
            metavar="RIG.yaml",
            help="Rig file, or a file with the section terrain alone; without it, options say all.",
            show_default=False,
        ),
    ] = None,
    *,
    out: Annotated[Path, typer.Option(metavar="NAME.npy", help="NAME.json comes beside it.")],
    seed: Annotated[int | None, typer.Option(help="Another seed, another terrain.")] = None,
    size_m: Annotated[
        tuple[float, float] | None, typer.Option(metavar="X Y", help="Extent along X and along Y.")
    ] = None,
    spacing_m: Annotated[float | None, typer.Option(help="Distance of the samples.")] = None,
    relief_m: Annotated[float | None, typer.Option(help="From the lowest to the highest.")] = None,
    roughness_slope: Annotated[
        float | None, typer.Option(help="RMS slope over 10 mm, craters apart.")
    ] = None,
    hurst_exponent: Annotated[
        float | None, typer.Option(help="How roughness grows with scale, 0 to 1.")
    ] = None,
    crater_density_per_m2: Annotated[
        float | None, typer.Option(help="a of the law N(> D) = a (D / 1 m)^-b per square metre.")
    ] = None,
    crater_exponent: Annotated[float | None, typer.Option(help="b of the law.")] = None,
    crater_smallest_m: Annotated[float | None, typer.Option(help="Smallest diameter.")] = None,
    crater_largest_m: Annotated[float | None, typer.Option(help="Largest diameter.")] = None,
    force: Force = False,
) -> None:
    """Make a terrain and write it as a file that a rig can name.

    Options replace what the rig file says; what neither says has the default of a rig file's
    procedural terrain. A rig names the result as `terrain: {kind: dem, path: NAME.npy}`.
    """
    from tronlab.campaign.live import open_live
    from tronlab.cli.terrain_files import check_dem_name, check_new
    from tronlab.cli.terrain_info import as_text, measure
    from tronlab.cli.terrain_source import open_source

    options = {
        "seed": seed,
        "size_m": size_m,
        "spacing_m": spacing_m,
        "relief_m": relief_m,
        "roughness_slope": roughness_slope,
        "hurst_exponent": hurst_exponent,
        "crater_density_per_m2": crater_density_per_m2,
        "crater_exponent": crater_exponent,
        "crater_smallest_m": crater_smallest_m,
        "crater_largest_m": crater_largest_m,
    }
    named = _named(path, {key: value for key, value in options.items() if value is not None})
    check_dem_name(out)
    check_new(out, out.with_suffix(".json"), force=force)
    try:
        with open_live(sys.stderr) as live:
            _write(named, out, live.announce)
            measured = measure(open_source(out, announce=live.announce))
    except KeyboardInterrupt:
        typer.echo("interrupted: no terrain was written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(as_text({"file": str(out), **measured}))


def _named(path: Path | None, options: "Mapping[str, Any]") -> "NamedTerrain":
    """Give the terrain of the file with the options in place of what it says."""
    from dataclasses import replace

    from tronlab.cli.terrain_source import NamedTerrain, read_yaml
    from tronlab.terrain.config import ProceduralTerrain
    from tronlab.terrain.heightmap import TerrainError
    from tronlab.yaml_models import parse_mapping

    if path is None:
        config = parse_mapping(options, ProceduralTerrain, key="terrain")
        return NamedTerrain("options", config, Path())
    named = read_yaml(path)
    if not options:
        return named
    if not isinstance(named.config, ProceduralTerrain):
        raise TerrainError(
            f"{path}: its terrain is of kind {named.config.kind}; only a procedural one takes"
            f" options such as --{next(iter(options)).replace('_', '-')}"
        )
    settings = {**named.config.model_dump(mode="json"), **options}
    return replace(named, config=parse_mapping(settings, ProceduralTerrain, key="terrain"))


def _write(named: "NamedTerrain", out: Path, announce: "Callable[[str], None]") -> None:
    from tronlab.cli.terrain_source import tell_of_albedo
    from tronlab.terrain.config import DemTerrain, ProceduralTerrain
    from tronlab.terrain.dem import save_dem
    from tronlab.terrain.heightmap import TerrainError
    from tronlab.terrain.load import load_terrain, make_dem

    config = named.config
    tell_of_albedo(config, announce)
    if isinstance(config, ProceduralTerrain):
        make_dem(config, out, announce=announce)
    elif isinstance(config, DemTerrain):
        raise TerrainError(f"{named.name}: its terrain is the file {config.path} already")
    else:
        heightmap = load_terrain(config, base_dir=named.base_dir, announce=announce)
        save_dem(out, heightmap, made_by=config.model_dump(mode="json"))
