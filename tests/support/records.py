"""Calibration records for tests, made from plain values."""

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.projection import N_INTRINSICS
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.results import (
    CameraResult,
    FrameResult,
    HandEyeResult,
    LampResult,
    Results,
)
from tronlab.geometry.camera import CameraModel


def make_results(
    *,
    camera: CameraModel,
    trs_from_trk: RigidTransform | None = None,
    tmac_from_cam: RigidTransform | None = None,
    p_lamp_trs_m: Any = (0.0, 0.0, 5.0),
    sigma_intrinsics: float = 1e-3,
    sigma_rad: float = 1e-6,
    sigma_m: float = 1e-6,
) -> Results:
    """Give results with covariances of one sigma each."""
    pose_covariance = np.diag([sigma_rad**2] * 3 + [sigma_m**2] * 3)
    nowhere = RigidTransform.identity()
    return Results(
        frame=FrameResult(nowhere if trs_from_trk is None else trs_from_trk, pose_covariance),
        camera=CameraResult(camera, sigma_intrinsics**2 * np.eye(N_INTRINSICS), "brown"),
        hand_eye=HandEyeResult(
            nowhere if tmac_from_cam is None else tmac_from_cam, pose_covariance
        ),
        lamp=LampResult(np.array(p_lamp_trs_m), sigma_m**2 * np.eye(3)),
    )


def make_record(results: Results, **fields: Any) -> CalibrationRecord:
    """Give a record of the rig ``twin`` with those results."""
    values: dict[str, Any] = {
        "rig_name": "twin",
        "created_utc": "2026-01-02T03:04:05Z",
        "software": {"tronlab": "test"},
        "devices": {},
        "results": results,
    }
    return CalibrationRecord(**{**values, **fields})
