"""Is every value there, finite, and of a kind that can be?"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tronlab.dataset.columns import Column
from tronlab.dataset.reader import Dataset
from tronlab.geometry.poses import ROTATION_TOLERANCE, FloatArray

_CORRELATION_TOLERANCE = 1e-9


def shot_ids(dataset: Dataset) -> Iterator[str]:
    """Find shots that are there twice."""
    ids, counts = np.unique(dataset.shot_ids, return_counts=True)
    for shot_id, n in zip(ids[counts > 1], counts[counts > 1], strict=True):
        yield f"shot {shot_id}: is there {n} times"


def columns(dataset: Dataset) -> Iterator[str]:
    """Find values that are no poses, no covariances or not finite."""
    is_imported = imported(dataset)
    for column in dataset.columns():
        rows = dataset.rows(column.path)
        name = column.path.removeprefix("entry/")
        if rows.shape != (dataset.n_shots, *column.shape):
            yield f"{name}: shape is {rows.shape}, expected {(dataset.n_shots, *column.shape)}"
        elif rows.dtype.kind == "f":
            is_bad, what = _judge(column, rows)
            may_be_unknown = column.is_optional | (column.is_of_laboratory & is_imported)
            is_bad &= ~(may_be_unknown & _is_unknown(rows))
            for shot_id in dataset.shot_ids[is_bad]:
                yield f"shot {shot_id}: {name} is {what}"


def values(dataset: Dataset) -> Iterator[str]:
    """Find values that do not fit their checksum."""
    for shot_id in dataset.shots_with_damaged_values():
        yield f"shot {shot_id}: the checksum of its values does not match"


def is_pose(rows: FloatArray) -> NDArray[np.bool_]:
    """Tell which rows, shape (n, 7), are finite with a unit quaternion; shape (n,)."""
    norms = np.linalg.norm(rows[:, 3:], axis=1)
    return np.all(np.isfinite(rows), axis=1) & (np.abs(norms - 1.0) <= ROTATION_TOLERANCE)


def imported(dataset: Dataset) -> NDArray[np.bool_]:
    """Tell which shots were not recorded but imported, shape (n,): much is not known of them."""
    foreign = [session.number for session in dataset.sessions if session.kind == "import"]
    return np.isin(dataset.stored.sessions()[list(dataset.row_numbers)], foreign)


def _judge(column: Column, rows: FloatArray) -> tuple[NDArray[np.bool_], str]:
    """Tell which rows are bad, shape (n,), and why."""
    if column.shape == (7,):
        return ~is_pose(rows), "no pose with a unit quaternion"
    if column.shape == (6, 6):
        return ~_is_covariance(rows), "not a covariance (symmetric, positive semidefinite)"
    return ~np.all(np.isfinite(rows), axis=tuple(range(1, rows.ndim))), "not finite"


def _is_unknown(rows: FloatArray) -> NDArray[np.bool_]:
    return np.all(np.isnan(rows), axis=tuple(range(1, rows.ndim)))


def _is_covariance(rows: FloatArray) -> NDArray[np.bool_]:
    is_finite = np.all(np.isfinite(rows), axis=(1, 2))
    safe = np.where(is_finite[:, None, None], rows, 0.0)
    # Rotations and translations may differ by orders of magnitude: compare correlations instead.
    sigmas = np.sqrt(np.abs(np.diagonal(safe, axis1=1, axis2=2)))
    scale = np.where(sigmas > 0, sigmas, 1.0)
    scaled = safe / (scale[:, :, None] * scale[:, None, :])
    asymmetry = np.abs(scaled - scaled.transpose(0, 2, 1))
    is_symmetric = np.all(asymmetry <= _CORRELATION_TOLERANCE, axis=(1, 2))
    is_positive = np.all(np.linalg.eigvalsh(scaled) >= -_CORRELATION_TOLERANCE, axis=1)
    return is_finite & is_symmetric & is_positive
