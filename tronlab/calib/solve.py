"""From measurements to a calibration record."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np
from scipy.stats import chi2

from tronlab.calib.bundle import BundleSolution, solve_bundle
from tronlab.calib.hand_eye import solve_closed_form
from tronlab.calib.intrinsics import IntrinsicsSolution, solve_intrinsics
from tronlab.calib.measurements import Measurements
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.three_point import FrameSolution, point_in_trs, solve_frame
from tronlab.devices.readings import DeviceIdentity
from tronlab.errors import CalibrationError
from tronlab.geometry.poses import FloatArray

MAX_CHI_SQUARE_RATIO = 3.0
"""Pose corrections that many times larger (squared) than the tracker's covariance allows are no
noise: readings and images contradict each other."""
MIN_P_VALUE = 1e-3
"""Less likely pose corrections deserve a warning."""


def solve_calibration(
    measurements: Measurements,
    *,
    rig_name: str,
    devices: Mapping[str, DeviceIdentity],
    software: Mapping[str, str],
) -> CalibrationRecord:
    """Solve for frame, camera, hand-eye transform and lamp.

    Args:
        measurements: What was measured.
        rig_name: The rig it was measured on.
        devices: Identities of camera, tracker and tmac.
        software: Versions of tronlab, Python and the libraries that shape the numbers.

    Raises:
        DegenerateGeometryError: The measurements do not determine the answer.
        CalibrationError: The measurements contradict each other, or the rig file.
    """
    frame = solve_frame(measurements.reflectors, measurements.laboratory.reflectors)
    p_lamp, p_lamp_covariance = point_in_trs(measurements.lamp, frame)
    intrinsics, bundle = _solve_camera(measurements)
    _check_agreement(bundle)
    return CalibrationRecord(
        rig_name=rig_name,
        created_utc=datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
        software=dict(software),
        devices=dict(devices),
        camera=bundle.camera,
        camera_covariance=bundle.camera_covariance,
        trs_from_trk=frame.trs_from_trk,
        trs_from_trk_covariance=frame.covariance,
        tmac_from_cam=bundle.tmac_from_cam,
        tmac_from_cam_covariance=bundle.tmac_from_cam_covariance,
        p_lamp_trs_m=p_lamp,
        p_lamp_trs_covariance_m2=p_lamp_covariance,
        statistics=_statistics(frame, intrinsics, bundle),
        inputs=measurements.to_inputs(),
    )


def _solve_camera(measurements: Measurements) -> tuple[IntrinsicsSolution, BundleSolution]:
    stations = measurements.stations
    intrinsics = solve_intrinsics(
        [station.view for station in stations], measurements.laboratory.camera.nominal_model
    )
    start = solve_closed_form(
        [station.reading.trk_from_tmac for station in stations], intrinsics.cam_from_board
    )
    bundle = solve_bundle(
        stations, camera=intrinsics.camera, start=start, sigma_px=intrinsics.sigma_px
    )
    return intrinsics, bundle


def _check_agreement(bundle: BundleSolution) -> None:
    ratio = bundle.chi_square_poses / bundle.dof_poses
    if ratio > MAX_CHI_SQUARE_RATIO:
        shifts_m = np.linalg.norm(bundle.pose_corrections[:, 3:], axis=1)
        turns_rad = np.linalg.norm(bundle.pose_corrections[:, :3], axis=1)
        worst = int(np.argmax(shifts_m))
        raise CalibrationError(
            "hand-eye: tracker and camera contradict each other: the T-MAC's readings would have"
            f" to be wrong by {np.sqrt(ratio):.1f} times their stated accuracy; most at station"
            f" {worst}, by {shifts_m[worst] * 1e3:.3f} mm and"
            f" {np.degrees(turns_rad[worst]):.4f} deg;\ncheck that board, camera and T-MAC are"
            " fastened and stand still, and that the board's square_m is right, then calibrate"
            " again"
        )


def _statistics(
    frame: FrameSolution, intrinsics: IntrinsicsSolution, bundle: BundleSolution
) -> dict[str, Any]:
    residuals = np.vstack(bundle.residuals_px)
    return {
        "n_stations": len(bundle.residuals_px),
        "n_corners": len(residuals),
        "corner_sigma_px": intrinsics.sigma_px,
        "rms_px": _rms(residuals),
        "station_rms_px": [_rms(station) for station in bundle.residuals_px],
        "chi_square_pixels": bundle.chi_square_pixels,
        "dof_pixels": bundle.dof_pixels,
        "chi_square_poses": bundle.chi_square_poses,
        "dof_poses": bundle.dof_poses,
        "p_value_poses": float(chi2.sf(bundle.chi_square_poses, bundle.dof_poses)),
        "pose_correction_rms_m": _rms(bundle.pose_corrections[:, 3:]),
        "pose_correction_rms_rad": _rms(bundle.pose_corrections[:, :3]),
        "reflector_length_errors_m": frame.length_errors_m,
    }


def _rms(vectors: FloatArray) -> float:
    """Give the root mean square of the vectors' lengths, shape (n, k)."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))
