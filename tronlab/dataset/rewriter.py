"""Another ground truth for a recorded dataset, in a new file: raw readings and images stay."""

import hashlib
import os
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from tronlab.dataset import schema
from tronlab.dataset.admission import drift_values_of, values_of
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import (
    DriftRecord,
    Provenance,
    ReferenceView,
    ShotRecord,
    Truth,
)
from tronlab.dataset.skeleton import dataset_at, reference_arrays, reference_checksums
from tronlab.errors import DatasetError, IntegrityError

_WRITE_ERRORS = (OSError, RuntimeError)
"""What h5py raises when the operating system does not take what HDF5 writes."""


class DatasetRewriter:
    """Puts other derived values into a copy of a dataset.

    The copy takes its name when the ``with`` block ends well; otherwise nothing is left of it.
    """

    def __init__(self, source: Path, target: Path) -> None:
        """Copy the dataset.

        Raises:
            DatasetError: ``target`` exists, or the copy cannot be made.
            IntegrityError: The values of a shot are damaged: nothing should follow from them.
        """
        if target.exists():
            raise DatasetError(
                f"{target}: exists already and is never overwritten; choose another --out"
            )
        if not target.parent.is_dir():
            raise DatasetError(f"{target}: the directory {target.parent} does not exist")
        _check_values(source)
        self.target = target
        self._part = target.with_name(target.name + ".part")
        try:
            shutil.copyfile(source, self._part)
            self._file = h5py.File(self._part, "r+")
        except BaseException as error:
            self._remove_part()
            if isinstance(error, OSError):
                raise DatasetError(f"{target}: cannot be made: {error}") from error
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self._close()
            if error is None:
                os.replace(self._part, self.target)
        except _WRITE_ERRORS as failure:
            if error is None:
                raise DatasetError(f"{self.target}: cannot be made: {failure}") from failure
        finally:
            self._remove_part()
        if isinstance(error, _WRITE_ERRORS):
            raise DatasetError(f"{self.target}: cannot be made: {error}") from error

    def write_truth(self, i: int, shot: ShotRecord, truth: Truth, mask: NDArray[np.bool_]) -> None:
        """Replace truth and mask of shot ``i``.

        Args:
            i: Its row.
            shot: The shot as it was read from the dataset.
            truth: Its new truth.
            mask: Its new mask.

        Raises:
            DatasetError: A value is not finite.
        """
        values = values_of(self.target, replace(shot, truth=truth))
        for path, value in values.items():
            if path.startswith(schema.TRUTH):
                self._write(path, i, value)
        stored = np.ascontiguousarray(mask, dtype=np.uint8)
        self._write(schema.MASK, i, stored)
        self._write(schema.MASK_CRC32, i, schema.checksum([stored]))
        crc32 = dataset_at(self._file, schema.VALUES_CRC32)
        rows = (dataset_at(self._file, path)[i : i + 1] for path in _texts(crc32, "order"))
        self._write(schema.VALUES_CRC32, i, schema.checksum(rows))

    def write_references(self, views: Sequence[ReferenceView]) -> None:
        """Replace what the reference views show; ids and poses stay."""
        shown = reference_arrays(views)
        stored = {
            name: dataset_at(self._file, f"{schema.REFERENCES}/{name}")
            for name in schema.REFERENCE_VALUES
        }
        for name in ("image", "depth_m", "mask"):
            stored[name][...] = shown[name]
        arrays = {name: np.asarray(values[()]) for name, values in stored.items()}
        self._write(schema.REFERENCES_CRC32, (), reference_checksums(arrays))

    def write_drift_checks(self, checks: Sequence[DriftRecord]) -> None:
        """Replace what the drift checks found, or, with none, say that nothing is known."""
        reflectors = _texts(self._file[schema.DRIFT], "reflectors")
        for k, check in enumerate(checks):
            values = drift_values_of(self.target, check, reflectors)
            for path, value in values.items():
                self._write(path, k, value)
            self._write(schema.DRIFT_CRC32, k, schema.checksum(values.values()))
        self._write(schema.N_DRIFT_CHECKS, (), len(checks))

    def write_provenance(self, provenance: Provenance) -> None:
        """Replace the calibration record, the camera and what is said of them.

        Args:
            provenance: Of the dataset, with ``recomputation``.
        """
        self._replace_texts("entry/calibration", {"data": provenance.calibration_json})
        note = self._file["entry/calibration"].attrs
        note.pop("accepted", None)
        if provenance.accepted:
            note["accepted"] = list(provenance.accepted)
        self._file[f"{schema.CAMERA}/model"].attrs.update(provenance.camera.to_dict())
        if provenance.recomputation is not None:
            group = self._file.require_group(schema.RECOMPUTED)
            group.attrs["NX_class"] = schema.OPTIONAL_GROUPS[schema.RECOMPUTED]
            self._replace_texts(schema.RECOMPUTED, asdict(provenance.recomputation))
        version = ".".join(map(str, schema.SCHEMA_VERSION))
        self._file.attrs[schema.SCHEMA_ATTRIBUTE] = version

    def _remove_part(self) -> None:
        with suppress(OSError):  # it must not hide what went wrong before
            self._part.unlink()

    def _close(self) -> None:
        try:
            self._file.flush()
            os.fsync(self._file.id.get_vfd_handle())
        finally:
            self._file.close()

    def _replace_texts(self, group: str, texts: Mapping[str, str]) -> None:
        for name, text in texts.items():
            path = f"{group}/{name}"
            if path in self._file:
                del self._file[path]
            self._file[path] = text

    def _write(self, path: str, where: Any, value: Any) -> None:
        dataset_at(self._file, path)[where] = value


def sha256_of(path: Path) -> str:
    """Give the hash of a file.

    Raises:
        DatasetError: It cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror}") from error


def _texts(item: Any, attribute: str) -> list[str]:
    return [str(text) for text in item.attrs[attribute]]


def _check_values(source: Path) -> None:
    """Refuse damaged values: a new checksum would hide the damage for ever."""
    with Dataset(source) as dataset:
        damaged = [str(shot_id) for shot_id in dataset.shots_with_damaged_values()]
    if damaged:
        raise IntegrityError(
            f"{source}: the values of shots {', '.join(damaged)} are damaged: their checksums do"
            " not match; fetch the file again from its source"
        )
