"""The command ``tronlab budget``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tronlab.errors import CalibrationError

if TYPE_CHECKING:
    from tronlab.calib.budget import Budget

OUT = Path("out/budget")


def budget(
    record: Annotated[
        Path,
        typer.Argument(metavar="RECORD.json", help="Calibration record.", show_default=False),
    ],
    campaign: Annotated[
        Path | None,
        typer.Option(
            metavar="CAMPAIGN.yaml",
            help="Make it for the poses of this campaign.  [default: 0.5 to 5 m before the model]",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of table and plot.")] = OUT,
) -> None:
    """Say what the uncertainty of camera poses comes from, and what to do about it."""
    from tronlab.calib.budget import error_budget, sweep
    from tronlab.calib.budget_table import budget_table
    from tronlab.calib.record import CalibrationRecord
    from tronlab.campaign.config import load_campaign
    from tronlab.campaign.job import campaign_poses
    from tronlab.report.calibration import save_budget

    calibration = CalibrationRecord.load(record)
    if campaign is None:
        poses = sweep(calibration)
    else:
        overridden = {"rig", "calibration"}
        poses = campaign_poses(load_campaign(campaign, overridden=overridden))
    made = error_budget(calibration, poses)
    typer.echo(budget_table(made))
    try:
        out.mkdir(parents=True, exist_ok=True)
        table, plot = _save_table(made, out / "budget.csv"), save_budget(made, out)
    except OSError as error:
        raise CalibrationError(
            f"error budget: {error.filename or out}: {error.strerror};"
            "\nname another folder: --out DIR"
        ) from error
    typer.echo(f"\ntable: {table}\nplot: {plot}")


def _save_table(made: "Budget", path: Path) -> Path:
    import csv

    columns = made.columns()
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(columns)
        rows.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))
    return path
