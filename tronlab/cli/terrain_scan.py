"""``tronlab terrain scan``: the terrain as a laboratory would have measured it."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tronlab.cli.exit_codes import INTERRUPTED
from tronlab.cli.terrain_files import Force

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tronlab.terrain.heightmap import HeightMap
    from tronlab.terrain.scan import Scan, ScanConfig

N_COORDINATES = 3


def scan(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="IN", help="The true terrain: a file, or a rig file.", show_default=False
        ),
    ],
    *,
    out: Annotated[Path, typer.Option(metavar="NAME.npy", help="NAME.json comes beside it.")],
    spacing_mm: Annotated[
        float | None, typer.Option(metavar="MM", help="Of the scan (default: as the terrain).")
    ] = None,
    noise_mm: Annotated[
        float, typer.Option(metavar="MM", help="Noise of each sample, one sigma.")
    ] = 0.0,
    correlated_mm: Annotated[
        float, typer.Option(metavar="MM", help="Noise that neighbours share, one sigma.")
    ] = 0.0,
    correlation_length_mm: Annotated[
        float, typer.Option(metavar="MM", help="How far they share it.")
    ] = 50.0,
    spot_mm: Annotated[
        float, typer.Option(metavar="MM", help="Diameter of the scanner's spot.")
    ] = 0.0,
    registration_mm: Annotated[
        float, typer.Option(metavar="MM", help="Error of the scan's place, one sigma an axis.")
    ] = 0.0,
    registration_deg: Annotated[
        float, typer.Option(metavar="DEG", help="Error of its direction, one sigma an axis.")
    ] = 0.0,
    scanner_trs_m: Annotated[
        list[str] | None,
        typer.Option(
            "--scanner",
            metavar="X,Y,Z",
            help="Where a scanner stands, metres in trs; may be given several times. What none sees"
            " is filled (default: everything is seen).",
        ),
    ] = None,
    widest_hole_mm: Annotated[
        float, typer.Option(metavar="MM", help="Wider holes are an error.")
    ] = 200.0,
    seed: Annotated[int, typer.Option(help="Another seed, other errors.")] = 1,
    force: Force = False,
) -> None:
    """Measure a terrain as a laboratory would, with errors.

    A rig that has the result as `terrain` and the true one as `world: {terrain: ...}` knows of its
    terrain what a laboratory knows.
    """
    from tronlab.campaign.live import open_live
    from tronlab.cli.terrain_files import check_dem_name, check_new
    from tronlab.cli.terrain_source import open_source
    from tronlab.terrain.conversion import heightmap_of
    from tronlab.terrain.dem import save_dem
    from tronlab.terrain.scan import ScanConfig
    from tronlab.terrain.scan import scan as scan_terrain
    from tronlab.yaml_models import parse_mapping

    settings: dict[str, Any] = {
        "spacing_m": None if spacing_mm is None else spacing_mm / 1e3,
        "noise_sigma_m": noise_mm / 1e3,
        "correlated_sigma_m": correlated_mm / 1e3,
        "correlation_length_m": correlation_length_mm / 1e3,
        "spot_diameter_m": spot_mm / 1e3,
        "registration_sigma_m": registration_mm / 1e3,
        "registration_sigma_deg": registration_deg,
        "scanners_trs_m": [_point(text) for text in scanner_trs_m or ()],
        "widest_hole_m": widest_hole_mm / 1e3,
        "seed": seed,
    }
    config = parse_mapping(settings, ScanConfig, key="scan")
    check_dem_name(out)
    check_new(out, out.with_suffix(".json"), force=force)
    try:
        with open_live(sys.stderr) as live:
            source = open_source(path, announce=live.announce)
            true = heightmap_of(source.raster, source.origin_trs_m, announce=live.announce)
            live.announce("scanning")
            scanned = scan_terrain(true, config)
            save_dem(
                out,
                scanned.heightmap,
                made_by={
                    "kind": "scan",
                    "path": str(path),
                    **config.model_dump(mode="json"),
                    "truth": _truth(scanned),
                    "source": dict(source.made_by),
                },
                n_holes_filled=scanned.n_holes_filled,
            )
    except KeyboardInterrupt:
        typer.echo("interrupted: no scan was written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo("\n".join([f"terrain: {out}", *_told(true, scanned, config)]))


def _point(text: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != N_COORDINATES:
        raise typer.BadParameter(
            f"'{text}' is no point, expected X,Y,Z in metres", param_hint="--scanner"
        )
    return numbers


def _truth(scanned: "Scan") -> dict[str, Any]:
    """Give what only the simulator knows, for the record."""
    from tronlab.geometry.poses import xyz_quat_from_pose

    return {
        "scan_from_true_xyz_m_quat_xyzw": xyz_quat_from_pose(scanned.scan_from_true).tolist(),
        "n_outside": scanned.n_outside,
    }


def _told(true: "HeightMap", scanned: "Scan", config: "ScanConfig") -> "Sequence[str]":
    """Say what was done to the terrain."""
    import numpy as np

    rows, columns = scanned.heightmap.height_m.shape
    n_samples = rows * columns
    middle = np.array([*true.origin_trs_m[:2], true.mean_height_trs_m])
    middle[:2] += np.array(true.size_m) / 2
    shift_mm = 1e3 * (scanned.scan_from_true.apply(middle) - middle)
    turn_deg = np.degrees(scanned.scan_from_true.rotation.as_rotvec())
    lines = [
        f"samples: {rows} x {columns}, every {1e3 * scanned.heightmap.spacing_m:g} mm",
        f"registration error: moved by {_triple(shift_mm)} mm at the middle, turned by"
        f" {_triple(turn_deg)} deg about X, Y and Z",
        f"noise: {1e3 * config.noise_sigma_m:g} mm each sample,"
        f" {1e3 * config.correlated_sigma_m:g} mm shared over"
        f" {1e3 * config.correlation_length_m:g} mm",
    ]
    for n, what in (
        (scanned.n_holes_filled, "seen by no scanner, filled from their rims"),
        (scanned.n_outside, "beyond the true terrain, given the height of its border"),
    ):
        if n:
            lines.append(f"{n} samples ({100 * n / n_samples:.2g} %) {what}")
    return lines


def _triple(vector: Any) -> str:
    return ", ".join(f"{value:+.3g}" for value in vector)
