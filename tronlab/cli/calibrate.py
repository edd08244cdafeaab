"""The command ``tronlab calibrate``."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tronlab.errors import CalibrationError

if TYPE_CHECKING:
    from tronlab.calib.record import CalibrationRecord
    from tronlab.campaign.rig import Rig

RECORDS = Path("calibration/records")


class Part(StrEnum):
    """What can be calibrated."""

    ALL = "all"


def calibrate(
    part: Annotated[Part, typer.Argument(help="What to calibrate.")],
    *,
    rig: Annotated[Path, typer.Option(metavar="RIG.yaml", help="Rig file.")],
    record: Annotated[
        Path | None,
        typer.Option(
            metavar="RECORD.json",
            help=f"File of the calibration record.  [default: {RECORDS}/RIG-NAME.json]",
        ),
    ] = None,
    seed: Annotated[
        int,
        typer.Option(
            min=0, max=2**32 - 1, help="Seed of the measurement noise of simulated devices."
        ),
    ] = 0,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before the robot moves.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing record.")] = False,
) -> None:
    """Calibrate a rig: model frame, camera, hand-eye transform and lamp."""
    from tronlab.campaign.rig import load_rig

    opened = load_rig(rig)
    path = record or RECORDS / f"{opened.name}.json"
    if path.exists() and not force:
        raise CalibrationError(
            f"calibration record {path}: exists already;\nname another file, or replace it: --force"
        )
    if not yes:
        typer.confirm("The robot will move round the calibration board. Go on?", abort=True)
    made = _measure_and_solve(opened, seed)
    made.save(path)
    typer.echo(_verdict(made))
    typer.echo(path)


def _measure_and_solve(rig: "Rig", seed: int) -> "CalibrationRecord":
    from tronlab.calib.wizard import CalibrationSettings, calibrate
    from tronlab.campaign.live import open_live
    from tronlab.campaign.provenance import software_versions
    from tronlab.devices.registry import connected

    devices = rig.open_devices(seed, session="calibration")
    with open_live(sys.stderr) as live, connected(devices):
        return calibrate(
            devices,
            rig.config.laboratory,
            rig_name=rig.name,
            software=software_versions(),
            settings=CalibrationSettings(),
            progress=live,
        )


def _verdict(record: "CalibrationRecord") -> str:
    """Give the results with one sigma each, as lines of a table."""
    import numpy as np

    def sigmas(covariance: np.ndarray) -> np.ndarray:
        return np.sqrt(np.diag(covariance))

    def pose(covariance: np.ndarray) -> str:
        turn_mdeg = np.degrees(sigmas(covariance)[:3]) * 1e3
        shift_mm = sigmas(covariance)[3:] * 1e3
        return (
            f"sigma x y z  {' '.join(f'{value:.3f}' for value in shift_mm)} mm,"
            f"  {' '.join(f'{value:.2f}' for value in turn_mdeg)} mdeg"
        )

    camera, s = record.camera, record.statistics
    f_sigma = sigmas(record.camera_covariance)[:4]
    focal_and_centre = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
    pixels = [f"{v:.3f} +- {d:.3f}" for v, d in zip(focal_and_centre, f_sigma, strict=True)]
    lamp_mm = " ".join(f"{v * 1e3:.3f}" for v in sigmas(record.p_lamp_trs_covariance_m2))
    lamp_m = " ".join(f"{v:.4f}" for v in record.p_lamp_trs_m)
    rows = [
        ("focal length fx, fy", f"{pixels[0]}, {pixels[1]} px"),
        ("principal point", f"{pixels[2]}, {pixels[3]} px"),
        ("distortion", "  ".join(f"{k:.5f}" for k in camera.distortion) + "  (k1 k2 p1 p2 k3)"),
        (
            "corners",
            f"rms {s['rms_px']:.3f} px over {s['n_corners']} in {s['n_stations']} stations",
        ),
        ("hand-eye tmac_from_cam", pose(record.tmac_from_cam_covariance)),
        ("frame trs_from_trk", pose(record.trs_from_trk_covariance)),
        ("lamp, its reflector", f"{lamp_m} m,  sigma {lamp_mm} mm"),
        (
            "tracker against camera",
            f"chi-square {s['chi_square_poses']:.1f}, expected {s['dof_poses']:.1f}:"
            f" {_judge(s['p_value_poses'])}",
        ),
    ]
    return "\n".join(f"{name:<24}{value}" for name, value in rows)


def _judge(p_value: float) -> str:
    from tronlab.calib.solve import MIN_P_VALUE

    if p_value < MIN_P_VALUE:
        return "DOES NOT FIT the stated accuracy of the tracker; look for what moved"
    return "agrees with the stated accuracy of the tracker"
