"""``tronlab terrain info``: what a terrain is like, as a table or as JSON."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tronlab.cli.terrain_files import HeightUnit
from tronlab.terrain.lengths import height_unit, length_text

if TYPE_CHECKING:
    from tronlab.cli.terrain_source import TerrainSource
    from tronlab.terrain.config import ProceduralTerrain

SLOPE_BASE_M = 0.01
"""Slopes are told over this length besides that of the facets."""
PERCENTILES = (50, 90, 95, 99)


def info(
    path: Annotated[
        Path,
        typer.Argument(metavar="FILE|RIG.yaml", help="Heights, or a rig file.", show_default=False),
    ],
    *,
    height_unit_m: HeightUnit = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, in SI units.")] = False,
) -> None:
    """Show what a terrain is like: size, heights, slopes, roughness and craters."""
    import json
    import sys

    from tronlab.campaign.live import open_live
    from tronlab.cli.terrain_source import open_source

    with open_live(sys.stderr) as live:
        source = open_source(path, height_unit_m=height_unit_m, announce=live.announce)
        measured = measure(source)
    if as_json:
        typer.echo(json.dumps({"file": str(path), **measured}, indent=2))
    else:
        typer.echo(as_text({"file": str(path), **measured}))


def measure(source: "TerrainSource") -> dict[str, Any]:
    """Give what there is to say about a terrain: SI units, None where something is not known."""
    from tronlab.terrain.statistics import known_heights

    raster = source.raster
    heights, spacing_m = known_heights(raster.height_m), raster.spacing_m
    rows, columns = raster.height_m.shape
    return {
        "name": source.name,
        "shape": [rows, columns],
        "spacing_m": list(spacing_m) if spacing_m else None,
        "size_m": [(rows - 1) * spacing_m[0], (columns - 1) * spacing_m[1]] if spacing_m else None,
        "bytes_as_float32": 4 * rows * columns,
        "has_unit": raster.has_unit,
        "lowest": heights.lowest_m if heights else None,
        "highest": heights.highest_m if heights else None,
        "mean": heights.mean_m if heights else None,
        "n_holes": raster.n_holes,
        "crs": raster.crs,
        "corner_m": list(raster.corner_m) if raster.corner_m else None,
        "origin_trs_m": source.origin_trs_m.tolist(),
        **_roughness(source),
        "craters": _craters(source.asked) if source.asked else None,
        "made_by": dict(source.made_by),
    }


def _roughness(source: "TerrainSource") -> dict[str, Any]:
    import numpy as np

    from tronlab.terrain.statistics import (
        deviogram,
        facet_gradients,
        hurst_fit,
        rms_slope,
        root_mean_square,
    )

    heights, spacing_m = source.raster.height_m, source.raster.spacing_m
    if spacing_m is None or not source.raster.has_unit:
        return {"facet_slope_rad": None, "rms_slope_over_10_mm": None, "hurst": None}
    gradients = facet_gradients(heights, spacing_m)
    slopes = [rms_slope(heights, spacing_m, SLOPE_BASE_M, axis=axis) for axis in (0, 1)]
    fit = hurst_fit([deviogram(heights, spacing_m, axis=axis) for axis in (0, 1)], max(spacing_m))
    facet_slope_rad = {
        "rms": float(np.arctan(root_mean_square(gradients))),
        **{f"p{n}": float(np.arctan(np.percentile(gradients, n))) for n in PERCENTILES},
    }
    return {
        "facet_slope_rad": facet_slope_rad if gradients.size else None,
        "rms_slope_over_10_mm": dict(zip("xy", slopes, strict=True))
        if np.isfinite(slopes).all()
        else None,
        "hurst": {"exponent": fit.exponent, "range_m": list(fit.x_range)} if fit else None,
    }


def _craters(asked: "ProceduralTerrain") -> dict[str, Any]:
    """Give the law of the craters, how many were drawn and how many are to be expected."""
    from tronlab.terrain.crater_counts import count_craters, craters_of, n_expected

    counts = count_craters(craters_of(asked), asked.size_m, asked.crater_smallest_m)
    return {
        "density_per_m2": asked.crater_density_per_m2,
        "exponent": asked.crater_exponent,
        "smallest_m": asked.crater_smallest_m,
        "largest_m": asked.crater_largest_m,
        "n_drawn": int(counts.n_craters[0]),
        "n_expected": n_expected(asked, counts),
    }


def as_text(measured: dict[str, Any]) -> str:
    """Give the facts as a table, lengths in units that people read."""
    rows = {
        "file": measured["file"],
        "made": _made(measured["made_by"]),
        "samples": _samples(measured),
        "size": _size(measured),
        "memory": f"{measured['bytes_as_float32'] / 1e6:.2g} MB as float32",
        "heights": _heights(measured),
        "holes": f"{measured['n_holes']} samples" if measured["n_holes"] else "none",
        "crs": _crs(measured),
        "slope of facets": _facets(measured),
        "slope over 10 mm": _slope(measured["rms_slope_over_10_mm"]),
        "Hurst exponent": _hurst(measured["hurst"]),
        "craters": _crater_line(measured["craters"]),
        "roughness asked": _asked(measured["made_by"]),
    }
    rows = {name: value for name, value in rows.items() if value}
    width = max(len(name) for name in rows)
    return "\n".join(f"{name:<{width}}  {value}" for name, value in rows.items())


def _made(made_by: dict[str, Any]) -> str:
    match made_by:
        case {"kind": "procedural", "seed": seed}:
            return f"from seed {seed}"
        case {"kind": "file", "path": path}:
            return f"from {path}, as a model"
        case {"kind": "converted", "path": path}:
            return f"from {path}, converted"
        case {"kind": "scan", "path": path}:
            return f"as a scan of {path}"
        case _:
            return ""


def _samples(measured: dict[str, Any]) -> str:
    rows, columns = measured["shape"]
    if measured["spacing_m"] is None:
        return f"{rows} x {columns}, the file does not say how far apart"
    along_x, along_y = map(length_text, measured["spacing_m"])
    every = along_x if along_x == along_y else f"{along_x} along X and {along_y} along Y"
    return f"{rows} x {columns}, every {every}"


def _size(measured: dict[str, Any]) -> str:
    if measured["size_m"] is None:
        return ""
    return " x ".join(map(length_text, measured["size_m"])) + " along X and Y"


def _heights(measured: dict[str, Any]) -> str:
    lowest, highest, mean = (measured[key] for key in ("lowest", "highest", "mean"))
    if lowest is None:
        return "nothing but holes"
    if not measured["has_unit"]:
        return f"{lowest:g} to {highest:g}, mean {mean:.6g}: numbers without a unit"
    factor, unit = height_unit(highest - lowest)
    lowest, highest, mean = (factor * value for value in (lowest, highest, mean))
    span = f"{lowest:.1f} to {highest:.1f} {unit}, mean {mean:.1f} {unit}"
    return f"{span}, relief {highest - lowest:.1f} {unit}"


def _crs(measured: dict[str, Any]) -> str:
    if not measured["crs"]:
        return ""
    name = measured["crs"].partition('"')[2].partition('"')[0]
    if measured["corner_m"] is None:
        return name
    x, y = measured["corner_m"]
    return f"{name}, first sample at x = {x:.2f}, y = {y:.2f} m"


def _facets(measured: dict[str, Any]) -> str:
    from math import degrees

    slope_rad = measured["facet_slope_rad"]
    if slope_rad is None:
        return "-"
    percentiles = ", ".join(f"{n} % {degrees(slope_rad[f'p{n}']):.1f}" for n in PERCENTILES)
    return f"RMS {degrees(slope_rad['rms']):.1f} deg; {percentiles} deg"


def _slope(slope: dict[str, float] | None) -> str:
    return f"RMS {slope['x']:.3f} along X, {slope['y']:.3f} along Y" if slope else "-"


def _hurst(hurst: dict[str, Any] | None) -> str:
    if hurst is None:
        return "-"
    shortest, longest = map(length_text, hurst["range_m"])
    return f"{hurst['exponent']:.2f} from steps of {shortest} to {longest}"


def _crater_line(craters: dict[str, Any] | None) -> str:
    if craters is None:
        return ""
    smallest, largest = (length_text(craters[key]) for key in ("smallest_m", "largest_m"))
    return (
        f"{craters['n_drawn']} of {smallest} to {largest} on the model;"
        f" {craters['n_expected']:.0f} expected by the law"
        f" {craters['density_per_m2']:g} (D / 1 m)^-{craters['exponent']:g} per m2"
    )


def _asked(made_by: dict[str, Any]) -> str:
    match made_by:
        case {"kind": "procedural", "roughness_slope": slope, "hurst_exponent": hurst}:
            return f"RMS slope {slope:g} over 10 mm, Hurst exponent {hurst:g}, before craters"
        case _:
            return ""
