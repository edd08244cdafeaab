"""Do the loops of frames close: does truth follow from the tracker, and does the robot agree?"""

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.dataset import schema
from tronlab.dataset.checks.columns import is_pose
from tronlab.dataset.reader import Dataset
from tronlab.errors import CalibrationError, FrameError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray, pose_from_xyz_quat

_TRUTH_TOLERANCE = 1e-9
"""Metres, and radians: truth is computed, so only rounding may differ."""
_ROBOT_TOLERANCE_M = 0.01
"""A calibrated arm on a rail is good to a few millimetres; beyond are readings of other shots."""
_ROBOT_TOLERANCE_RAD = np.deg2rad(0.5)

Record = Mapping[str, Any]
"""A calibration record as it is stored; only what is needed here is looked at."""


def camera(dataset: Dataset) -> Iterator[str]:
    """Find where the camera model is not the calibrated one."""
    section = _parsed(dataset.provenance.calibration_json).get("camera", {})
    try:
        # Records before version 3 have the intrinsics here.
        calibrated = CameraModel.from_dict(section.get("intrinsics", section)).to_dict()
    except (KeyError, TypeError, AttributeError, OverflowError, CalibrationError):
        return
    for name, value in dataset.camera.to_dict().items():
        if value != calibrated[name]:
            yield (
                f"{schema.CAMERA.removeprefix('entry/')}/model: {name} is {value},"
                f" the calibration record says {calibrated[name]}"
            )


def truth(dataset: Dataset) -> Iterator[str]:
    """Find shots whose truth does not follow from the tracker by the record of their session."""
    measured = dataset.rows(f"{schema.TRACKER}/trk_from_tmac")
    for record, rows in _sessions(dataset, is_pose(measured)):
        trs_from_trk = _pose_in(record, "frame", "trs_from_trk")
        tmac_from_cam = _pose_in(record, "hand_eye", "tmac_from_cam")
        if trs_from_trk is None or tmac_from_cam is None:
            continue
        chain = trs_from_trk * _poses(measured[rows]) * tmac_from_cam
        for shot_id, shift_m, turn_rad in _apart(dataset, rows, chain):
            if max(shift_m, turn_rad) > _TRUTH_TOLERANCE:
                yield (
                    f"shot {shot_id}: truth does not follow from the tracker's reading by the"
                    f" calibration: {shift_m * 1e3:.3g} mm apart"
                )


def robot(dataset: Dataset) -> Iterator[str]:
    """Find shots whose robot and rail, as calibrated, were not where truth has the camera."""
    base_from_flange = dataset.rows(f"{schema.ROBOT}/base_from_flange")
    rail_m = dataset.rows(f"{schema.ROBOT}/rail_m")
    is_known = is_pose(base_from_flange) & np.isfinite(rail_m)
    for record, rows in _sessions(dataset, is_known):
        trs_from_rail = _pose_in(record, "robot", "trs_from_rail")
        flange_from_tmac = _pose_in(record, "robot", "flange_from_tmac")
        tmac_from_cam = _pose_in(record, "hand_eye", "tmac_from_cam")
        rail_axis = _rail_axis(record)
        if (
            trs_from_rail is None
            or rail_axis is None
            or flange_from_tmac is None
            or tmac_from_cam is None
        ):
            continue
        rail_from_base = RigidTransform.from_translation(np.outer(rail_m[rows], rail_axis))
        trs_from_flange = trs_from_rail * rail_from_base * _poses(base_from_flange[rows])
        chain = trs_from_flange * flange_from_tmac * tmac_from_cam
        for shot_id, shift_m, turn_rad in _apart(dataset, rows, chain):
            if shift_m > _ROBOT_TOLERANCE_M or turn_rad > _ROBOT_TOLERANCE_RAD:
                yield (
                    f"shot {shot_id}: robot and rail have the camera {shift_m * 1e3:.1f} mm and"
                    f" {np.rad2deg(turn_rad):.2f} deg from truth, allowed"
                    f" {_ROBOT_TOLERANCE_M * 1e3:g} mm and {np.rad2deg(_ROBOT_TOLERANCE_RAD):g} deg"
                )


def _sessions(
    dataset: Dataset, is_known: NDArray[np.bool_]
) -> Iterator[tuple[Record, NDArray[np.intp]]]:
    """Give each session's calibration record and rows, those left out that have no reading."""
    number_of = dataset.stored.sessions()[list(dataset.row_numbers)]
    is_usable = is_known & is_pose(dataset.rows(f"{schema.TRUTH}/trs_from_cam"))
    for session in dataset.sessions:
        rows = np.flatnonzero(is_usable & (number_of == session.number))
        if rows.size:
            yield _parsed(session.calibration_json), rows


def _apart(
    dataset: Dataset, rows: NDArray[np.intp], chain: RigidTransform
) -> Iterator[tuple[int, float, float]]:
    """Give how far (m, rad) truth is from what a chain of frames says, by shot id."""
    recorded = _poses(dataset.rows(f"{schema.TRUTH}/trs_from_cam")[rows])
    difference = chain.inv() * recorded
    shifts_m = np.linalg.norm(difference.translation, axis=1)
    turns_rad = difference.rotation.magnitude()
    for i, shift_m, turn_rad in zip(rows, shifts_m, turns_rad, strict=True):
        yield int(dataset.shot_ids[i]), float(shift_m), float(turn_rad)


def _poses(rows: FloatArray) -> RigidTransform:
    """Make poses of rows (n, 7) that were found to be some."""
    return RigidTransform.from_components(rows[:, :3], Rotation.from_quat(rows[:, 3:]))


def _parsed(text: str) -> Record:
    try:
        record = json.loads(text)
    except json.JSONDecodeError:
        return {}
    return record if isinstance(record, dict) else {}


def _pose_in(record: Record, part: str, name: str) -> RigidTransform | None:
    """Give a pose of a record; None if it has none."""
    # Records before version 3 have the poses at the top.
    section = record.get(part, record)
    try:
        return pose_from_xyz_quat(section[name]["xyz_m_quat_xyzw"])
    except (KeyError, TypeError, ValueError, FrameError):
        return None


def _rail_axis(record: Record) -> FloatArray | None:
    """Give how far the base moves for a metre of the rail, shape (3,); None if it is not known."""
    try:
        axis = np.asarray(record["robot"]["rail_axis_m_per_m"], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        return None
    return axis if axis.shape == (3,) and np.all(np.isfinite(axis)) else None
