"""``tronlab dataset info``: what a dataset holds, as a table or as JSON."""

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tronlab.dataset.reader import Dataset
    from tronlab.dataset.records import Session
    from tronlab.dataset.summary import Course
    from tronlab.geometry.poses import FloatArray


def info(
    path: Annotated[
        Path,
        typer.Argument(metavar="DATASET", help="The .h5 file, or its folder.", show_default=False),
    ],
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show what a dataset holds.

    Also how its recording went, where its time went, and who records into it now.
    """
    import json
    import sys

    from tronlab.dataset.location import dataset_in
    from tronlab.dataset.reader import Dataset
    from tronlab.dataset.summary import course_of

    with Dataset(dataset_in(path)) as opened:
        course = course_of(opened)
        if as_json:
            typer.echo(json.dumps(_values(opened, course), indent=2))
            return
        rows = _facts(opened, course)
    if sys.stdout.isatty():
        _print_table(rows)
    else:
        width = max(len(name) for name in rows)
        for name, value in rows.items():
            typer.echo(f"{name:<{width}}  {value}".rstrip())


def _print_table(rows: "Mapping[str, str]") -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for name, value in rows.items():
        table.add_row(Text(name, style="bold"), Text(value))
    Console().print(table)


def _facts(opened: "Dataset", course: "Course") -> dict[str, str]:
    from tronlab.dataset.schema import TRUTH
    from tronlab.dataset.summary import calibrated_utc

    provenance = opened.provenance
    return {
        "file": str(opened.path),
        "size": _size(course),
        "layout": opened.schema_version,
        "campaign": provenance.campaign_name,
        "rig": provenance.rig_name,
        "seed": str(provenance.seed),
        "status": f"{opened.status}: {opened.reason}" if opened.reason else opened.status,
        "written by": str(course.writer or "nobody now"),
        "started": opened.start_time,
        "duration": _duration(opened.start_time, opened.end_time),
        "shots": f"{opened.n_shots} of {provenance.n_shots_planned} planned",
        **_troubles(course),
        "reference views": str(opened.n_references),
        "images": _images(opened),
        "range to terrain": _span(opened.rows(f"{TRUTH}/range_los_m"), "m"),
        "usable fraction": _span(opened.rows(f"{TRUTH}/usable_fraction"), ""),
        "calibrated": calibrated_utc(provenance.calibration_json) or "-",
        **_trust(opened),
        **{f"session {session.number}": _session(session) for session in course.sessions},
        **_shares(course.timing_s),
        **{f"note {note.time_utc}": note.text for note in course.notes},
        **{f"device {name}": text for name, text in sorted(provenance.devices.items())},
        **{f"version {name}": text for name, text in sorted(provenance.software.items())},
    }


def _size(course: "Course") -> str:
    size = f"{course.n_bytes / 1e6:.1f} MB"
    return f"{size} in {course.n_files} files" if course.n_files > 1 else size


def _troubles(course: "Course") -> dict[str, str]:
    """Give what did not go well, as far as there is something to say."""
    from tronlab.dataset.drift import spans

    facts: dict[str, str] = {}
    if course.skipped:
        facts["skipped shots"] = "; ".join(f"{i}: {why}" for i, why in course.skipped.items())
    for flag, shot_ids in course.flagged.items():
        facts[f"flagged {flag}"] = spans(shot_ids)
    if course.n_superseded:
        facts["taken again"] = f"{course.n_superseded} superseded"
    if course.n_failures:
        counts = (f"{n} {kind.replace('_', ' ')}" for kind, n in course.n_failures.items())
        facts["failed attempts"] = ", ".join(counts)
    return facts


def _session(session: "Session") -> str:
    line = f"{session.kind} at {session.start_utc} on {session.host or 'an unknown host'}"
    return "; ".join([line, *(f"accepted: {text}" for text in session.accepted)])


def _shares(timing_s: "Mapping[str, float]") -> dict[str, str]:
    """Give where the time of the shots went: seconds and per cent."""
    total_s = sum(timing_s.values())
    if not total_s:
        return {}
    return {
        f"time {name.removesuffix('_s')}": f"{part_s:10.1f} s {100 * part_s / total_s:5.1f} %"
        for name, part_s in {**timing_s, "together_s": total_s}.items()
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
    if not end:
        return "-"
    seconds = (datetime.fromisoformat(end) - datetime.fromisoformat(start)).total_seconds()
    minutes, seconds = divmod(seconds, 60)
    return f"{minutes:.0f} min {seconds:.1f} s" if minutes else f"{seconds:.1f} s"


def _values(opened: "Dataset", course: "Course") -> dict[str, Any]:
    """Give the facts for programs: numbers in SI units, lists instead of sentences."""
    from collections import Counter
    from dataclasses import asdict

    provenance = opened.provenance
    sessions = [
        {name: value for name, value in asdict(session).items() if not name.endswith(_WHOLE_TEXTS)}
        for session in course.sessions
    ]
    return {
        "file": str(opened.path),
        "layout": opened.schema_version,
        "campaign": provenance.campaign_name,
        "rig": provenance.rig_name,
        "seed": provenance.seed,
        "status": opened.status,
        "reason": opened.reason,
        "start_time": opened.start_time,
        "end_time": opened.end_time,
        "n_shots": opened.n_shots,
        "n_shots_planned": provenance.n_shots_planned,
        "n_references": opened.n_references,
        "n_drift_checks": len(opened.drift_checks),
        "truth_states": Counter(opened.truth_states),
        "image_shape": list(opened.camera.shape),
        "image_dtype": str(opened.image_dtype) if opened.image_dtype else None,
        "software": provenance.software,
        "devices": provenance.devices,
        **asdict(course),
        "sessions": sessions,
    }


_WHOLE_TEXTS = ("_yaml", "_json")
"""Ends of the names of a session's texts, which are files of their own."""
