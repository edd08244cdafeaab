"""Another ground truth for a recorded dataset, in a new file: raw readings and images stay."""

import hashlib
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import h5py
import numpy as np
from numpy.typing import NDArray

from tronlab.dataset import columns, schema
from tronlab.dataset.admission import drift_values_of, values_of
from tronlab.dataset.records import (
    DriftRecord,
    Provenance,
    ReferenceView,
    ShotRecord,
    Truth,
)
from tronlab.dataset.skeleton import (
    dataset_at,
    group_at,
    reference_arrays,
    reference_checksums,
)
from tronlab.dataset.transcript import OnStage, silent, transcribe
from tronlab.dataset.whole_file import whole_file
from tronlab.errors import DatasetError


@contextmanager
def rewritten(
    source: Path, target: Path, *, on_stage: OnStage | None = None
) -> Generator["DatasetRewriter"]:
    """Put other derived values into a copy of a dataset: one file, not compressed.

    The copy takes its name when the ``with`` block ends well; otherwise nothing is left of it.

    Args:
        source: The dataset; it stays as it is.
        target: The new file.
        on_stage: Told how far copying is.

    Raises:
        DatasetError: ``target`` exists or cannot be made, or the dataset is being recorded.
        IntegrityError: Something in the dataset is damaged: nothing should follow from it.
    """
    with whole_file(target) as part:
        transcribe(source, part, uuid=str(uuid4()), on_stage=on_stage or silent)
        with h5py.File(part, "r+") as file:
            yield DatasetRewriter(target, file)


class DatasetRewriter:
    """Puts other derived values into a dataset file; ``rewritten`` opens it."""

    def __init__(self, target: Path, file: h5py.File) -> None:
        """Take the file.

        Args:
            target: What errors call it.
            file: Of the present layout, without segments, open for writing.
        """
        self.target = target
        self._file = file

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
        self._write(schema.MASK_CRC32, i, columns.checksum([stored]))
        crc32 = dataset_at(self._file, schema.VALUES_CRC32)
        rows = (dataset_at(self._file, path)[i : i + 1] for path in _texts(crc32, "order"))
        self._write(schema.VALUES_CRC32, i, columns.checksum(rows))

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
        """Replace what the drift checks found, or, with none, say that nothing is known.

        When they were, and in which session, stays.
        """
        reflectors = _texts(self._file[schema.DRIFT], "reflectors")
        n_before = dataset_at(self._file, f"{schema.DRIFT}/n_shots_before")
        sessions = dataset_at(self._file, schema.DRIFT_SESSION)
        for k, check in enumerate(checks):
            then = replace(check, n_shots_before=int(n_before[k]), session=int(sessions[k]))
            values = drift_values_of(self.target, then, reflectors)
            for path, value in values.items():
                self._write(path, k, value)
            self._write(schema.DRIFT_CRC32, k, columns.checksum(values.values()))
        self._write(schema.N_DRIFT_CHECKS, (), len(checks))

    def write_provenance(self, provenance: Provenance) -> None:
        """Replace the calibration record, in all sessions too, the camera and what is said of them.

        Args:
            provenance: Of the dataset, with ``recomputation``.
        """
        self._replace_texts("entry/calibration", {"data": provenance.calibration_json})
        for session in group_at(self._file, schema.SESSIONS):
            texts = {"calibration_json": provenance.calibration_json}
            self._replace_texts(f"{schema.SESSIONS}/{session}", texts)
        note = self._file["entry/calibration"].attrs
        note.pop("accepted", None)
        if provenance.accepted:
            note["accepted"] = list(provenance.accepted)
        self._file[f"{schema.CAMERA}/model"].attrs.update(provenance.camera.to_dict())
        if provenance.recomputation is not None:
            group = self._file.require_group(schema.RECOMPUTED)
            group.attrs["NX_class"] = schema.OPTIONAL_GROUPS[schema.RECOMPUTED]
            self._replace_texts(schema.RECOMPUTED, asdict(provenance.recomputation))

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
