"""Solving a record again, and saying whether the answer is the same."""

from pathlib import Path

import typer

from tronlab.errors import CalibrationError


def rerun_record(path: Path, out: Path | None) -> bool:
    """Solve a record again, print how it compares, and write it if a file is named.

    A record whose signature is broken is solved all the same: its readings are still there.

    Returns:
        Whether the answer is the one that the record has.

    Raises:
        CalibrationError: It is no record, or its readings determine no answer.
    """
    from tronlab.calib.record import CalibrationRecord
    from tronlab.calib.rerun import TOLERANCE, rerun
    from tronlab.campaign.provenance import software_versions
    from tronlab.cli.calibration_files import save_record
    from tronlab.cli.calibration_verdict import verdict

    try:
        record = CalibrationRecord.load(path)
    except CalibrationError:
        record = CalibrationRecord.load(path, check_signature=False)
        typer.echo("the signature does not match: the file was changed", err=True)
    again = rerun(record, software_versions())
    typer.echo(verdict(again.record))
    if again.new_parts:
        typer.echo(f"solved for the first time: {', '.join(again.new_parts)}")
    for difference in again.differences:
        typer.echo(difference)
    if again.differences:
        typer.echo(f"the answer is another one: {len(again.differences)} values differ")
    elif again.old_parts:
        typer.echo(f"the answer is the same, to {TOLERANCE:g} of each value")
    if out is not None:
        save_record(again.record, out)
        typer.echo(out)
    return not again.differences
