"""Checking a dataset: does it hold together, is it undamaged, can its images be used?"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tronlab.dataset import schema
from tronlab.dataset.drift import doubts
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import ReferenceView
from tronlab.errors import CalibrationError, FrameError, IntegrityError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import (
    ROTATION_TOLERANCE,
    FloatArray,
    pose_from_xyz_quat,
    xyz_quat_from_pose,
)

_FULL_SCALE = {"Mono8": 255, "Mono12": 4095}
_USABLE_PART = 0.01
"""Least part of the mask whose pixels must be neither black nor saturated."""
_FRACTION_TOLERANCE = 1e-9
_TRUTH_TOLERANCE = 1e-9
"""Metres, and quaternion components: truth is computed, so only rounding may differ."""


def validate(path: Path) -> list[str]:
    """Check a dataset from its counter to the last pixel.

    Truth is recomputed from the raw tracker readings if the calibration record inside the dataset
    holds frame and hand-eye transform; the camera model is compared with the record's.

    Returns:
        What is wrong, one sentence each; empty if nothing is.

    Raises:
        DatasetError: The file cannot be opened; see ``Dataset``.
    """
    checks = (_ending, _shot_ids, _columns, _camera, _truth_chain, _drift, _shots, _references)
    findings: list[str] = []
    with Dataset(path) as dataset:
        for check in checks:
            try:
                findings += check(dataset)
            except IntegrityError as error:
                findings.append(str(error).removeprefix(f"{path}: "))
    return list(dict.fromkeys(findings))  # each view finds the same column missing


def _ending(dataset: Dataset) -> Iterator[str]:
    planned = dataset.provenance.n_shots_planned
    because = f": {dataset.reason}" if dataset.reason else ""
    if dataset.status == "running":
        yield "the recording never ended (status running): it still runs, or was killed"
    elif dataset.status != "complete":
        yield f"the recording ended with status {dataset.status}{because}"
    if dataset.n_shots != planned:
        yield f"{dataset.n_shots} of {planned} planned shots are there"


def _shot_ids(dataset: Dataset) -> Iterator[str]:
    ids, counts = np.unique(dataset.shot_ids, return_counts=True)
    for shot_id, n in zip(ids[counts > 1], counts[counts > 1], strict=True):
        yield f"shot {shot_id}: is there {n} times"


def _columns(dataset: Dataset) -> Iterator[str]:
    for column in dataset.columns():
        rows = dataset.rows(column.path)
        name = column.path.removeprefix("entry/")
        if rows.shape != (dataset.n_shots, *column.shape):
            yield f"{name}: shape is {rows.shape}, expected {(dataset.n_shots, *column.shape)}"
        elif column.shape == (7,):
            yield from _at_shots(dataset, name, ~_is_pose(rows), "no pose with a unit quaternion")
        elif column.shape == (6, 6):
            yield from _at_shots(
                dataset,
                name,
                ~_is_covariance(rows),
                "not a covariance (symmetric, positive semidefinite)",
            )
        elif rows.dtype.kind == "f":
            is_bad = np.isinf(rows) if column.is_optional else ~np.isfinite(rows)
            yield from _at_shots(dataset, name, is_bad, "not finite")


def _at_shots(dataset: Dataset, name: str, is_bad: NDArray[np.bool_], what: str) -> Iterator[str]:
    for shot_id in dataset.shot_ids[is_bad]:
        yield f"shot {shot_id}: {name} is {what}"


def _is_pose(rows: FloatArray) -> NDArray[np.bool_]:
    norms = np.linalg.norm(rows[:, 3:], axis=1)
    return np.all(np.isfinite(rows), axis=1) & (np.abs(norms - 1.0) <= ROTATION_TOLERANCE)


def _is_covariance(rows: FloatArray) -> NDArray[np.bool_]:
    is_finite = np.all(np.isfinite(rows), axis=(1, 2))
    safe = np.where(is_finite[:, None, None], rows, 0.0)
    # Rotations and translations may differ by orders of magnitude: compare correlations instead.
    sigmas = np.sqrt(np.abs(np.diagonal(safe, axis1=1, axis2=2)))
    scale = np.where(sigmas > 0, sigmas, 1.0)
    scaled = safe / (scale[:, :, None] * scale[:, None, :])
    is_symmetric = np.all(np.abs(scaled - scaled.transpose(0, 2, 1)) <= 1e-9, axis=(1, 2))
    is_positive = np.all(np.linalg.eigvalsh(scaled) >= -1e-9, axis=1)
    return is_finite & is_symmetric & is_positive


def _truth_chain(dataset: Dataset) -> Iterator[str]:
    record = _calibration(dataset.provenance.calibration_json)
    # Records before version 3 have the poses at the top.
    frame, hand_eye = record.get("frame", record), record.get("hand_eye", record)
    try:
        trs_from_trk = pose_from_xyz_quat(frame["trs_from_trk"]["xyz_m_quat_xyzw"])
        tmac_from_cam = pose_from_xyz_quat(hand_eye["tmac_from_cam"]["xyz_m_quat_xyzw"])
    except (KeyError, TypeError, ValueError, FrameError):
        return
    measured = dataset.rows(f"{schema.TRACKER}/trk_from_tmac")
    recorded = dataset.rows(f"{schema.TRUTH}/trs_from_cam")
    is_usable = _is_pose(measured) & _is_pose(recorded)
    for i in np.flatnonzero(is_usable):
        chain = trs_from_trk * pose_from_xyz_quat(measured[i]) * tmac_from_cam
        trs_from_cam = pose_from_xyz_quat(recorded[i])
        difference = xyz_quat_from_pose(chain.inv() * trs_from_cam)[:6]
        if np.abs(difference).max() > _TRUTH_TOLERANCE:
            yield (
                f"shot {dataset.shot_ids[i]}: truth does not follow from the tracker's reading by"
                f" the calibration: {np.linalg.norm(difference[:3]) * 1e3:.3g} mm apart"
            )


def _drift(dataset: Dataset) -> Iterator[str]:
    """Find shots whose truth the drift checks do not vouch for; older files have no checks."""
    checks = dataset.drift_checks
    if not checks:
        return
    counts = [check.n_shots_before for check in checks]
    if counts != sorted(counts) or counts[-1] > dataset.n_shots:
        yield f"drift: the checks were after {', '.join(map(str, counts))} shots, which cannot be"
    yield from doubts(dataset.shot_ids.tolist(), dataset.truth_states)


def _camera(dataset: Dataset) -> Iterator[str]:
    record = _calibration(dataset.provenance.calibration_json)
    try:
        camera = record["camera"]
        # Records before version 3 have the intrinsics here.
        calibrated = CameraModel.from_dict(camera.get("intrinsics", camera)).to_dict()
    except (KeyError, TypeError, AttributeError, OverflowError, CalibrationError):
        return
    for name, value in dataset.camera.to_dict().items():
        if value != calibrated[name]:
            yield (
                f"{schema.CAMERA.removeprefix('entry/')}/model: {name} is {value},"
                f" the calibration record says {calibrated[name]}"
            )


def _calibration(text: str) -> dict[str, Any]:
    try:
        record = json.loads(text)
    except json.JSONDecodeError:
        return {}
    return record if isinstance(record, dict) else {}


def _shots(dataset: Dataset) -> Iterator[str]:
    damaged = dataset.shots_with_damaged_values()
    fractions = dataset.rows(f"{schema.TRUTH}/usable_fraction")
    for i, shot_id in enumerate(dataset.shot_ids):
        if shot_id in damaged:
            yield f"shot {shot_id}: the checksum of its values does not match"
        try:
            image, mask = dataset.image(i), dataset.mask(i)
            pixel_format = dataset.pixel_format(i)
        except IntegrityError as error:
            yield str(error).removeprefix(f"{dataset.path}: ")
            continue
        for finding in (*_image(image, mask, pixel_format), *_mask(mask, fractions[i])):
            yield f"shot {shot_id}: {finding}"


def _image(
    image: NDArray[np.uint8] | NDArray[np.uint16], mask: NDArray[np.bool_], pixel_format: str
) -> Iterator[str]:
    full_scale = _FULL_SCALE.get(pixel_format, int(np.iinfo(image.dtype).max))
    if image.max() > full_scale:
        yield f"a grey value is {image.max()}, but {pixel_format} ends at {full_scale}"
    seen = image[mask] if mask.any() else image
    if np.mean(seen > 0) < _USABLE_PART:
        yield "the image is black"
    if np.mean(seen < full_scale) < _USABLE_PART:
        yield "the image is saturated"


def _mask(mask: NDArray[np.bool_], usable_fraction: float) -> Iterator[str]:
    if not mask.any():
        yield "the mask is empty"
    if abs(mask.mean() - usable_fraction) > _FRACTION_TOLERANCE:
        yield f"usable fraction is {usable_fraction:.6g}, the mask's is {mask.mean():.6g}"


def _references(dataset: Dataset) -> Iterator[str]:
    ids: list[int] = []
    for i in range(dataset.n_references):
        try:
            view = dataset.reference(i)
        except IntegrityError as error:
            yield str(error).removeprefix(f"{dataset.path}: ")
            continue
        ids.append(view.view_id)
        for finding in _view(view, dataset.camera.shape):
            yield f"reference view {view.view_id}: {finding}"
    if len(set(ids)) != len(ids):
        yield "reference views: an id is there twice"


def _view(view: ReferenceView, shape: tuple[int, int]) -> Iterator[str]:
    arrays: dict[str, NDArray[Any]] = {
        "image": view.image,
        "depth_m": view.depth_m,
        "mask": view.mask,
    }
    for name, array in arrays.items():
        if array.shape != shape:
            yield f"{name} has shape {array.shape}, the camera {shape}"
    if not np.any(view.depth_m > 0):
        yield "no terrain is seen"
    elif np.nanmin(view.depth_m) <= 0:
        yield "a depth is not positive"
