"""What must be true of shots, drift checks, views and provenance before they are written."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tronlab.dataset import columns, schema
from tronlab.dataset.records import DriftRecord, Provenance, ReferenceView, ShotRecord
from tronlab.errors import DatasetError

Values: TypeAlias = dict[str, NDArray[Any]]

_INT64 = np.iinfo(np.int64)


def check_provenance(path: Path, provenance: Provenance) -> None:
    """Check that a dataset can be set up from a provenance.

    Raises:
        DatasetError: No planned shots, or a seed that does not fit 64 bit.
    """
    if provenance.n_shots_planned < 1:
        raise DatasetError(f"{path}: {provenance.n_shots_planned} shots planned, at least 1 needed")
    if not _INT64.min <= provenance.seed <= _INT64.max:
        raise DatasetError(f"{path}: seed {provenance.seed} does not fit a 64-bit integer")


def check_view(path: Path, shape: tuple[int, int], view: ReferenceView) -> None:
    """Check that a reference view fits images of that shape.

    Raises:
        DatasetError: Image, depth or mask of another shape or type, or a pose that is not finite.
    """
    where = f"{path}: reference view {view.view_id}"
    expected = {"image": (view.image, "uint8"), "depth_m": (view.depth_m, "float32")}
    for name, (array, dtype) in {**expected, "mask": (view.mask, "bool")}.items():
        _check_array(f"{where}: {name}", array, shape, (dtype,))
    if not np.isfinite(view.trs_from_cam.as_matrix()).all():
        raise DatasetError(f"{where}: trs_from_cam is not finite")


def check_images(
    path: Path, shape: tuple[int, int], shot: ShotRecord, recorded_dtype: np.dtype[Any] | None
) -> None:
    """Check image and mask of a shot.

    Args:
        path: The dataset, for the message.
        shape: Of the camera's images.
        shot: The shot.
        recorded_dtype: Type of the images already committed; None for the first shot.

    Raises:
        DatasetError: Image or mask of another shape or type.
    """
    where = f"{path}: shot {shot.shot_id}"
    types = ("uint8", "uint16") if recorded_dtype is None else (recorded_dtype.name,)
    _check_array(f"{where}: image", shot.frame.image, shape, types)
    _check_array(f"{where}: mask", shot.mask, shape, ("bool",))


def values_of(path: Path, shot: ShotRecord) -> Values:
    """Give everything of a shot besides image and mask, by the path of its column.

    Raises:
        DatasetError: A value is not finite, has another shape, or does not fit its type.
    """
    where = f"{path}: shot {shot.shot_id}"
    is_imported = shot.tracker is None
    return {
        column.path: _fitting(
            where,
            column,
            column.value_of(shot),
            column.shape,
            may_be_unknown=column.is_optional or (is_imported and column.is_of_laboratory),
        )
        for column in columns.COLUMNS
    }


def drift_values_of(path: Path, check: DriftRecord, reflectors: Sequence[str]) -> Values:
    """Give everything of a drift check, by the path of its column.

    Args:
        path: The dataset, for the message.
        check: The check.
        reflectors: Those the dataset was set up for, in the order of their rows.

    Raises:
        DatasetError: Other reflectors, or as ``values_of``.
    """
    where = f"{path}: drift check after {check.n_shots_before} shots"
    if tuple(check.readings) != tuple(reflectors):
        raise DatasetError(
            f"{where}: of reflectors {', '.join(check.readings)}, expected {', '.join(reflectors)}"
        )
    return {
        column.path: _fitting(
            where,
            column,
            column.value_of(check),
            column.row_shape(len(reflectors)),
            may_be_unknown=column.is_optional,
        )
        for column in columns.DRIFT_COLUMNS
    }


def _fitting(
    where: str,
    column: columns.Column,
    given: ArrayLike,
    shape: tuple[int, ...],
    *,
    may_be_unknown: bool,
) -> NDArray[Any]:
    where = f"{where}: {column.path.removeprefix('entry/')}"
    try:
        value = np.asarray(given, dtype=column.dtype)
    except (OverflowError, TypeError, ValueError) as error:
        raise DatasetError(f"{where}: {given!r}: {error}") from error
    if value.shape != shape:
        raise DatasetError(f"{where}: shape is {value.shape}, expected {shape}")
    if value.dtype.kind == "f" and not _is_known(value, may_be_unknown=may_be_unknown):
        raise DatasetError(f"{where}: is not finite: {value.tolist()}")
    if value.dtype.kind == "S" and value.item() != given:
        raise DatasetError(f"{where}: {given!r} is longer than {schema.PIXEL_FORMAT_BYTES} bytes")
    return value


def _is_known(value: NDArray[Any], *, may_be_unknown: bool) -> bool:
    """Tell whether all numbers are finite; NaN stands for one that may be unknown."""
    return bool(np.all(np.isfinite(value) | (may_be_unknown & np.isnan(value))))


def _check_array(
    where: str, array: NDArray[Any], shape: tuple[int, int], dtypes: tuple[str, ...]
) -> None:
    if array.shape != shape:
        raise DatasetError(f"{where}: shape is {array.shape}, the camera's images have {shape}")
    if array.dtype.name not in dtypes:
        raise DatasetError(f"{where}: type is {array.dtype.name}, expected {' or '.join(dtypes)}")
