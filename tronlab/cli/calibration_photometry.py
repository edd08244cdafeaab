"""The paint's photometric function: from a recorded dataset into an existing record."""

import sys
from pathlib import Path

import typer

from tronlab.cli.exit_codes import INTERRUPTED


def calibrate_photometry(dataset: Path, path: Path, rig_path: Path | None) -> None:
    """Find how the paint reflects light and save it with the other parts of a record.

    Args:
        dataset: The dataset's file, or its folder.
        path: File of the record.
        rig_path: Rig file that leads to the terrain's file, if it is one.

    Raises:
        CalibrationError: There is no such record, it is another rig's, or the images do not
            determine the answer.
        DatasetError: The dataset cannot be read, or does not serve.
        ConfigError: The terrain cannot be found.
    """
    from tronlab.calib.record import CalibrationRecord
    from tronlab.campaign.live import open_live
    from tronlab.campaign.photometry import check_rig, measure_photometry, with_photometry
    from tronlab.cli.calibration_session import finish
    from tronlab.dataset.location import dataset_in

    source, record = dataset_in(dataset), CalibrationRecord.load(path)
    check_rig(source, record)
    try:
        with open_live(sys.stderr) as live:
            measured = measure_photometry(source, rig_path=rig_path, live=live)
    except KeyboardInterrupt:
        typer.echo(f"interrupted: {path} is as it was", err=True)
        raise typer.Exit(INTERRUPTED) from None
    finish(with_photometry(record, measured), path)
    typer.echo(
        "to render reference views with it, say in the campaign:\n"
        "database: {photometry: calibrated}"
    )
