"""``tronlab database info``: what a file of landmarks holds, as a table, JSON or a picture."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tronlab.nav.database_file import Counts, DatabaseFile
    from tronlab.nav.survey import Survey


def info(
    path: Annotated[
        Path, typer.Argument(metavar="DB.h5", help="The database.", show_default=False)
    ],
    *,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw where landmarks are, too.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, in SI units.")] = False,
) -> None:
    """Show what a database holds and covers, and verify that it is whole."""
    import json

    from tronlab.nav.database_file import read_database_file, verify_database
    from tronlab.nav.survey import survey

    verify_database(path)
    file = read_database_file(path)
    surveyed = survey(file.database)
    measured = {"file": str(path), **measure(file, surveyed)}
    if plot is not None:
        from tronlab.report.database import save_database_sheet

        save_database_sheet(file, surveyed, plot, title=path.name)
    if as_json:
        typer.echo(json.dumps(measured, indent=2))
        return
    typer.echo(as_text(measured))
    if plot is not None:
        typer.echo(f"picture: {plot}")


def measure(file: "DatabaseFile", surveyed: "Survey") -> dict[str, Any]:
    """Give what there is to say about a database, in SI units."""
    import numpy as np

    database, about = file.database, file.about
    density = surveyed.density_per_m2[surveyed.density_per_m2 > 0]
    lower, upper = surveyed.bands_m[:-1], surveyed.bands_m[1:]
    n_views = surveyed.n_views_of_point
    return {
        "digest": database.digest,
        "made_utc": about.made_utc,
        "software": about.software,
        "detector": database.detector.model_dump(mode="json"),
        "sources": [source.model_dump(exclude={"camera"}) for source in about.sources],
        "n_landmarks": len(database),
        "n_views": len(file.views_trs_from_cam),
        "n_views_without_landmarks": len(file.views_trs_from_cam)
        - int(np.count_nonzero(np.bincount(database.view))),
        "descriptor_bits": 8 * database.descriptors.shape[1],
        "low_trs_m": surveyed.low_trs_m.tolist(),
        "high_trs_m": surveyed.high_trs_m.tolist(),
        "covered_m2": surveyed.covered_m2,
        "density_per_m2": dict(
            zip(("p10", "p50", "p90"), np.percentile(density, (10, 50, 90)).tolist(), strict=True)
        ),
        "range_m": dict(zip(("least", "median", "greatest"), surveyed.range_m, strict=True)),
        "covered_share_by_range": [
            {"from_m": a, "to_m": b, "share": share}
            for a, b, share in zip(
                lower.tolist(), upper.tolist(), surveyed.covered_share.tolist(), strict=True
            )
        ],
        "n_views_of_point": dict(
            zip(("p10", "p50", "p90"), np.percentile(n_views, (10, 50, 90)).tolist(), strict=True)
        ),
        "verified": _verified(file.counts),
        "prunings": [pruning.model_dump() for pruning in about.prunings],
    }


def _verified(counts: "Counts | None") -> dict[str, int] | None:
    import numpy as np

    if counts is None:
        return None
    return {
        "n_offered": int(np.count_nonzero(counts.n_offered)),
        "n_verified": int(np.count_nonzero(counts.n_verified)),
        "n_verified_twice": int(np.count_nonzero(counts.n_verified > 1)),
    }


def as_text(measured: dict[str, Any]) -> str:
    """Give the facts as a table."""
    rows = {
        "file": measured["file"],
        "digest": measured["digest"],
        "made": f"{measured['made_utc']} by tronlab {measured['software']['tronlab']}",
        "detector": _detector(measured["detector"], measured["descriptor_bits"]),
        **_sources(measured["sources"]),
        "landmarks": _landmarks(measured),
        "extent": _extent(measured),
        "density": _spread(measured["density_per_m2"], "per m2"),
        "ranges": "{least:.2f} to {greatest:.2f} m, median {median:.2f} m".format(
            **measured["range_m"]
        ),
        "covered from": _bands(measured["covered_share_by_range"]),
        "views of a point": _spread(measured["n_views_of_point"], "views"),
        "verified": _verified_line(measured["verified"]),
        **_prunings(measured["prunings"]),
    }
    rows = {name: value for name, value in rows.items() if value}
    width = max(len(name) for name in rows)
    return "\n".join(f"{name:<{width}}  {value}" for name, value in rows.items())


def _detector(settings: dict[str, Any], bits: int) -> str:
    asked = [f"{name} {settings[name]:g}" for name in ("threshold", "n_max") if settings[name]]
    return f"{settings['features']}, {', '.join(asked) or 'as usual'}; descriptors of {bits} bits"


def _sources(sources: list[dict[str, Any]]) -> dict[str, str]:
    lines = [f"{s['kind']} {s['name']} (rig {s['rig']}): {s['views']}" for s in sources]
    return {f"source {i}": line for i, line in enumerate(lines, start=1)}


def _landmarks(measured: dict[str, Any]) -> str:
    empty = measured["n_views_without_landmarks"]
    none_in = f"; {empty} views have none" if empty else ""
    return f"{measured['n_landmarks']} in {measured['n_views']} views{none_in}"


def _extent(measured: dict[str, Any]) -> str:
    spans = (
        f"{axis} {low:.2f} to {high:.2f} m"
        for axis, low, high in zip(
            "XYZ", measured["low_trs_m"], measured["high_trs_m"], strict=True
        )
    )
    return f"{', '.join(spans)}; {measured['covered_m2']:.2f} m2 have landmarks"


def _spread(percentiles: dict[str, float], unit: str) -> str:
    p10, p50, p90 = (percentiles[name] for name in ("p10", "p50", "p90"))
    return f"{p50:.0f} {unit} in the median; one in ten {p10:.0f} or less, one {p90:.0f} or more"


def _bands(bands: list[dict[str, float]]) -> str:
    return ", ".join(
        f"{band['from_m']:.2g} to {band['to_m']:.2g} m: {100 * band['share']:.0f} %"
        for band in bands
    )


def _verified_line(verified: dict[str, int] | None) -> str:
    if verified is None:
        return ""
    return (
        f"{verified['n_verified']} of {verified['n_offered']} that were offered,"
        f" {verified['n_verified_twice']} more than once"
    )


def _prunings(prunings: list[dict[str, Any]]) -> dict[str, str]:
    return {
        f"pruning {i}": f"{step['n_before']} to {step['n_after']} landmarks by"
        f" {len(step['datasets'])} datasets, {step['time_utc']}"
        for i, step in enumerate(prunings, start=1)
    }
