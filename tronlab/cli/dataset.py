"""``tronlab dataset``: what is in a recorded dataset, and whether it holds together."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from tronlab.dataset.reader import Dataset
    from tronlab.geometry.poses import FloatArray

EXIT_FINDINGS = 1

dataset = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Look into a recorded dataset, or check it."
)

_PathArgument = Annotated[
    Path, typer.Argument(metavar="DATASET.h5", help="The recorded dataset.", show_default=False)
]


@dataset.command()
def info(path: _PathArgument) -> None:
    """Show what a dataset holds."""
    import sys

    from tronlab.dataset.reader import Dataset

    with Dataset(path) as opened:
        rows = _facts(opened)
    if sys.stdout.isatty():
        _print_table(rows)
    else:
        width = max(len(name) for name in rows)
        for name, value in rows.items():
            typer.echo(f"{name:<{width}}  {value}".rstrip())


@dataset.command()
def validate(path: _PathArgument) -> None:
    """Check a dataset; exit code 1 if something is wrong with it."""
    from tronlab.dataset.validate import validate as findings_of

    findings = findings_of(path)
    for finding in findings:
        typer.echo(finding)
    if findings:
        raise typer.Exit(EXIT_FINDINGS)
    typer.echo("valid")


@dataset.command()
def recompute_truth(
    path: _PathArgument,
    *,
    calibration: Annotated[
        Path, typer.Option(metavar="RECORD.json", help="The calibration record to compute it with.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="NEW.h5", help="The new file (default: beside it, NAME.recomputed.h5)."
        ),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option(
            metavar="RIG.yaml", help="Rig file, needed only where the terrain is a file it names."
        ),
    ] = None,
    accept_calibration: Annotated[
        bool,
        typer.Option(
            "--accept-calibration",
            help="Use a record of another rig or other devices, or one that had expired when the"
            " dataset was recorded; the new dataset says so.",
        ),
    ] = False,
) -> None:
    """Compute the ground truth again with another calibration record, into a new file."""
    import sys

    from tronlab.campaign.live import open_live
    from tronlab.campaign.recompute import recompute_truth as recompute

    target = out or path.with_name(f"{path.stem}.recomputed.h5")
    with open_live(sys.stderr) as live:
        change = recompute(
            path,
            calibration,
            out=target,
            rig_path=rig,
            is_calibration_accepted=accept_calibration,
            live=live,
        )
    typer.echo(change)
    typer.echo(target)


def _print_table(rows: dict[str, str]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for name, value in rows.items():
        table.add_row(Text(name, style="bold"), Text(value))
    Console().print(table)


def _facts(opened: "Dataset") -> dict[str, str]:
    from tronlab.dataset.schema import TRUTH

    provenance = opened.provenance
    return {
        "file": str(opened.path),
        "size": f"{opened.path.stat().st_size / 1e6:.1f} MB",
        "layout": opened.schema_version,
        "campaign": provenance.campaign_name,
        "rig": provenance.rig_name,
        "seed": str(provenance.seed),
        "status": f"{opened.status}: {opened.reason}" if opened.reason else opened.status,
        "started": opened.start_time,
        "duration": _duration(opened.start_time, opened.end_time),
        "shots": f"{opened.n_shots} of {provenance.n_shots_planned} planned",
        "reference views": str(opened.n_references),
        "images": _images(opened),
        "range to terrain": _span(opened.rows(f"{TRUTH}/range_los_m"), "m"),
        "usable fraction": _span(opened.rows(f"{TRUTH}/usable_fraction"), ""),
        "calibrated": _calibrated(provenance.calibration_json),
        **_trust(opened),
        **{f"device {name}": text for name, text in sorted(provenance.devices.items())},
        **{f"version {name}": text for name, text in sorted(provenance.software.items())},
    }


def _trust(opened: "Dataset") -> dict[str, str]:
    """Give what is known about whether truth can be trusted."""
    from collections import Counter

    counts = Counter(opened.truth_states)
    facts = {"truth of the shots": ", ".join(f"{n} {state}" for state, n in counts.items()) or "-"}
    if opened.drift_checks:
        largest = max(opened.drift_checks, key=lambda check: check.max_shift_m)
        facts["drift checks"] = (
            f"{len(opened.drift_checks)}, at most {largest.max_shift_m * 1e3:.3f} mm"
            f" (limit {largest.limit_m * 1e3:g} mm)"
        )
    if opened.provenance.accepted:
        facts["accepted"] = "; ".join(opened.provenance.accepted)
    if (recomputation := opened.provenance.recomputation) is not None:
        facts["truth recomputed"] = f"{recomputation.time_utc} from {recomputation.dataset_name}"
    return facts


def _images(opened: "Dataset") -> str:
    columns, rows = opened.camera.width_px, opened.camera.height_px
    return f"{columns} x {rows}, {opened.image_dtype or 'none yet'}"


def _span(values: "FloatArray", unit: str) -> str:
    return f"{values.min():.3f} to {values.max():.3f} {unit}".rstrip() if values.size else "-"


def _duration(start: str, end: str) -> str:
    from datetime import datetime

    if not end:
        return "-"
    seconds = (datetime.fromisoformat(end) - datetime.fromisoformat(start)).total_seconds()
    minutes, seconds = divmod(seconds, 60)
    return f"{minutes:.0f} min {seconds:.1f} s" if minutes else f"{seconds:.1f} s"


def _calibrated(calibration_json: str) -> str:
    """Give when the calibration was made, as far as the record says."""
    import json

    try:
        record = json.loads(calibration_json)
    except json.JSONDecodeError:
        return "-"
    return str(record.get("created_utc", "-")) if isinstance(record, dict) else "-"
