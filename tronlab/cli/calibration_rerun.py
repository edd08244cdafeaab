"""Solving a record again, and saying whether the answer is the same."""

from pathlib import Path

import typer

from tronlab.errors import CalibrationError


def rerun_record(path: Path, out: Path | None) -> bool:
    """Solve a record again, print how it compares, and write it if a file is named.

    A record whose signature is broken is solved all the same: its readings are still there. The
    file that was read stays as it is, unless it is the one that is named.

    Returns:
        Whether the answer is the one that the record has.

    Raises:
        CalibrationError: It is no record, or its readings determine no answer.
    """
    from tronlab.calib.record import CalibrationRecord, measuring_command
    from tronlab.calib.rerun import TOLERANCE, rerun
    from tronlab.campaign.provenance import software_versions
    from tronlab.cli.calibration_files import keep_old
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
    for name, reason in again.unsolved.items():
        command = measuring_command(name.replace("_", "-"), str(out or "NEW.json"))
        typer.echo(f"left out, measure it anew: {command}\n  {reason}")
    for difference in again.differences:
        typer.echo(difference)
    if again.differences:
        typer.echo(f"the answer is another one: {len(again.differences)} values differ")
    elif again.old_parts:
        typer.echo(f"the answer is the same, to {TOLERANCE:g} of each value")
    if out is not None:
        keep_old(out)
        again.record.save(out)
        typer.echo(out)
    return not again.differences
