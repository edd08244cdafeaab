"""Reading a table of shots, and the reference views beside it."""

from collections import Counter
from pathlib import Path

import numpy as np

from tronlab.dataset.exchange.folder import (
    COVARIANCE_COLUMNS,
    NOMINAL_COLUMNS,
    POSE_COLUMNS,
    REFERENCE_COLUMNS,
    REFERENCES_CSV,
    SHOT_COLUMNS,
    UPPER_TRIANGLE,
)
from tronlab.dataset.exchange.foreign import ForeignSet, ForeignShot, ForeignView
from tronlab.dataset.exchange.text_files import Row, pose_of_numbers, read_table
from tronlab.errors import DatasetError
from tronlab.geometry.poses import FloatArray

_CORRELATION_TOLERANCE = 1e-6
"""Text files are rounded."""


def read_folder(csv_path: Path) -> ForeignSet:
    """Read a table of shots as ``FolderExporter`` writes it, and the reference views beside it.

    Columns needed are shot_id, image, x_m, y_m, z_m, qx, qy, qz, qw; files are relative to the
    table.

    Raises:
        DatasetError: A table cannot be read or says something that cannot be.
    """
    required = ("shot_id", "image", *POSE_COLUMNS)
    rows = read_table(csv_path, required=required, known=SHOT_COLUMNS)
    shots = tuple(_shot(row, csv_path.parent) for row in rows)
    _check_ids("shot_id", [shot.shot_id for shot in shots], csv_path)
    references = csv_path.parent / REFERENCES_CSV
    views = _views(references) if references.exists() else ()
    return ForeignSet(shots, views)


def _shot(row: Row, folder: Path) -> ForeignShot:
    pose = row.numbers(POSE_COLUMNS)
    if pose is None:
        raise DatasetError(f"{row.where}: has no pose: {', '.join(POSE_COLUMNS)} are empty")
    nominal = row.numbers(NOMINAL_COLUMNS)
    shot_id = row.integer("shot_id")
    if shot_id < 0:
        raise DatasetError(f"{row.where}: shot_id is {shot_id}, must be 0 or more")
    return ForeignShot(
        shot_id=shot_id,
        where=row.where,
        image_path=folder / row.text("image"),
        mask_path=folder / row.text("mask") if "mask" in row.cells else None,
        trs_from_cam=pose_of_numbers(pose, row.where),
        planned_trs_from_cam=None if nominal is None else pose_of_numbers(nominal, row.where),
        covariance=_covariance(row),
        range_los_m=_range(row),
        time_s=row.number("time_s"),
        exposure_s=row.number("exposure_s"),
        gain_db=row.number("gain_db"),
        pixel_format=row.cells.get("pixel_format"),
    )


def _range(row: Row) -> float:
    range_los_m = row.number("range_los_m")
    if range_los_m <= 0:
        raise DatasetError(f"{row.where}: range_los_m is {range_los_m:g}, must be above 0")
    return range_los_m


def _covariance(row: Row) -> FloatArray | None:
    values = row.numbers(COVARIANCE_COLUMNS)
    if values is None:
        return None
    covariance = np.zeros((6, 6))
    for (i, j), value in zip(UPPER_TRIANGLE, values, strict=True):
        covariance[i, j] = covariance[j, i] = value
    sigmas = np.sqrt(np.diag(covariance).clip(min=np.finfo(np.float64).tiny))
    # Rotations and translations may differ by orders of magnitude: compare correlations instead.
    if np.linalg.eigvalsh(covariance / np.outer(sigmas, sigmas)).min() < -_CORRELATION_TOLERANCE:
        raise DatasetError(f"{row.where}: cov_00 to cov_55 are no covariance: not positive")
    return covariance


def _views(path: Path) -> tuple[ForeignView, ...]:
    rows = read_table(path, required=REFERENCE_COLUMNS, known=REFERENCE_COLUMNS)
    views = tuple(_view(row, path.parent) for row in rows)
    _check_ids("view_id", [view.view_id for view in views], path)
    return views


def _view(row: Row, folder: Path) -> ForeignView:
    pose = row.numbers(POSE_COLUMNS)
    if pose is None:
        raise DatasetError(f"{row.where}: has no pose: {', '.join(POSE_COLUMNS)} are empty")
    return ForeignView(
        view_id=row.integer("view_id"),
        where=row.where,
        trs_from_cam=pose_of_numbers(pose, row.where),
        image_path=folder / row.text("image"),
        mask_path=folder / row.text("mask"),
        depth_path=folder / row.text("depth"),
    )


def _check_ids(name: str, ids: list[int], path: Path) -> None:
    twice = [str(i) for i, n in Counter(ids).items() if n > 1]
    if twice:
        raise DatasetError(f"{path}: {name} must be unique; more than once: {', '.join(twice)}")
