"""Measuring at a rig, or reading files: from a command's arguments to a saved record."""

import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from tronlab.cli.calibration_files import (
    Keep,
    journal,
    load_existing,
    record_path,
    refuse_existing,
    save_record,
)
from tronlab.cli.exit_codes import INTERRUPTED

if TYPE_CHECKING:
    from tronlab.calib.inputs import PartName
    from tronlab.calib.record import CalibrationRecord
    from tronlab.calib.wizard import Dialogue
    from tronlab.campaign.rig import Rig


def measure_all(rig_path: Path, record: Path | None, *, yes: bool, seed: int, force: bool) -> None:
    """Measure every part of a rig's calibration and save the record.

    Raises:
        CalibrationError: There is a record already, or what was measured makes no sense.
        DeviceError: A device failed.
    """
    from tronlab.calib.wizard import ALL_PARTS
    from tronlab.campaign.rig import load_rig

    rig = load_rig(rig_path)
    path = record_path(record, rig.name)
    refuse_existing(path, force=force)
    _measure_and_save(ALL_PARTS, rig, path, None, yes=yes, seed=seed)


def measure_part(
    part: "PartName", rig_path: Path, record: Path | None, *, yes: bool, seed: int
) -> None:
    """Measure one part of a rig's calibration; a record that exists keeps its other parts.

    Raises:
        CalibrationError: The record is another rig's, or what was measured makes no sense.
        DeviceError: A device failed.
    """
    from tronlab.campaign.rig import load_rig

    rig = load_rig(rig_path)
    path = record_path(record, rig.name)
    _measure_and_save((part,), rig, path, load_existing(path, rig.name), yes=yes, seed=seed)


def solve_files(path: Path, rig_name: str, **parts: Any) -> None:
    """Solve what was read from files; a record that exists keeps its other parts.

    Args:
        path: File of the record.
        rig_name: Whose it is.
        parts: What was read, by the names of ``Inputs``.

    Raises:
        CalibrationError: The record is another rig's, or what was read determines no answer.
    """
    from tronlab.calib.solve import solve
    from tronlab.campaign.calibrating import draft_of

    draft = draft_of(rig_name, load_existing(path, rig_name), {}, valid_days=None)
    inputs = draft.inputs.with_parts(**parts)
    finish(replace(draft, inputs=inputs, results=solve(inputs)), path)


def finish(record: "CalibrationRecord", path: Path) -> None:
    """Save a record and show what it is worth."""
    from tronlab.cli.calibration_verdict import verdict
    from tronlab.report.calibration import write_pictures

    kept = save_record(record, path)
    typer.echo(verdict(record))
    pictures = write_pictures(record, path.with_name(f"{path.stem}_pictures"))
    if pictures:
        typer.echo(f"pictures: {len(pictures)} in {pictures[0].parent}")
    if kept:
        typer.echo(f"the record before is kept in {kept}")
    typer.echo(path)


def _measure_and_save(
    parts: "tuple[PartName, ...]",
    rig: "Rig",
    path: Path,
    before: "CalibrationRecord | None",
    *,
    yes: bool,
    seed: int,
) -> None:
    try:
        with journal(path) as keep:
            finish(_measure(parts, rig, before, yes=yes, seed=seed, keep=keep), path)
    except KeyboardInterrupt:
        typer.echo("interrupted", err=True)
        raise typer.Exit(INTERRUPTED) from None


def _measure(
    parts: "tuple[PartName, ...]",
    rig: "Rig",
    before: "CalibrationRecord | None",
    *,
    yes: bool,
    seed: int,
    keep: Keep,
) -> "CalibrationRecord":
    from tronlab.campaign.calibrating import NotReadyToMeasureError, measure_parts

    with _dialogue(yes=yes) as dialogue:
        try:
            return measure_parts(parts, rig, before, dialogue=dialogue, seed=seed, keep=keep)
        except NotReadyToMeasureError:
            raise typer.Abort from None


@contextmanager
def _dialogue(*, yes: bool) -> "Generator[Dialogue]":
    from tronlab.calib.wizard import Unattended
    from tronlab.campaign.live import open_live
    from tronlab.cli.terminal import TerminalDialogue

    if not yes:
        yield TerminalDialogue()
        return
    with open_live(sys.stderr) as live:
        yield Unattended(live)
