"""Recording a dataset shot by shot, so that a kill at any moment loses no committed shot.

The dataset is its own journal: the data of a shot, flush; then the counter ``n_committed``, flush.
The first flush matters: without it HDF5 may write the counter before the data.
"""

import errno
import os
import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self, get_args

import h5py
import numpy as np

from tronlab.dataset import schema, skeleton
from tronlab.dataset.admission import (
    Values,
    check_images,
    check_provenance,
    check_view,
    drift_values_of,
    values_of,
)
from tronlab.dataset.records import DriftRecord, Provenance, ReferenceView, ShotRecord
from tronlab.dataset.skeleton import dataset_at
from tronlab.errors import DatasetError

_WRITE_ERRORS = (OSError, RuntimeError)
"""What h5py raises when the operating system does not take what HDF5 writes."""

_STRUCTURE_BYTES = 1 << 20
"""More than HDF5 needs for the structure around a few stacks of images."""


class DatasetWriter:
    """Writes one dataset file.

    Leaving the ``with`` block by an exception before ``finish`` records the exception and status
    ``failed``, or ``aborted`` for Ctrl-C. Leaving it otherwise without ``finish`` leaves the status
    ``running``.
    """

    def __init__(self, path: Path, provenance: Provenance) -> None:
        """Create the file; it must not exist.

        Raises:
            DatasetError: The file exists, cannot be created, or the provenance makes no sense.
        """
        check_provenance(path, provenance)
        self.path = path
        self._provenance = provenance
        self._file = _create(path)
        self._shot_ids: set[int] = set()
        self._rows: dict[str, h5py.Dataset] = {}
        self._reflectors: tuple[str, ...] = ()
        try:
            skeleton.create_skeleton(self._file, provenance)
            self._sync()
        except (OSError, ValueError, TypeError) as error:
            self._close()
            raise DatasetError(f"{path}: cannot be set up: {error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if not self._file:
            return
        if error is None:
            self._close()
            return
        # The error that ends the block is the one to report, not what follows from it.
        with suppress(DatasetError):
            status = "aborted" if isinstance(error, KeyboardInterrupt) else "failed"
            self.finish(status, reason=f"{type(error).__name__}: {error}".removesuffix(": "))

    @property
    def n_committed(self) -> int:
        """Get the number of shots that are safe in the file."""
        return len(self._shot_ids)

    def add_references(self, views: Sequence[ReferenceView]) -> None:
        """Store the reference views; once.

        Raises:
            DatasetError: No views, views already stored, a view that does not fit the camera, the
                writer is finished, or the disk does not take them.
        """
        self._check_open()
        if schema.REFERENCES in self._file:
            raise DatasetError(f"{self.path}: the reference views are already stored")
        if not views:
            raise DatasetError(f"{self.path}: no reference views were given")
        for view in views:
            check_view(self.path, self._provenance, view)
        n_bytes = sum(v.image.nbytes + v.depth_m.nbytes + v.mask.nbytes for v in views)
        try:
            self._probe_room(n_bytes)
            skeleton.create_references(self._file, tuple(views))
            self._sync()
        except _WRITE_ERRORS as error:
            raise DatasetError(
                f"{self.path}: the reference views could not be written: {error}"
            ) from error

    def plan_drift_checks(self, reflectors: Sequence[str], n_checks: int) -> None:
        """Make room for the drift checks; once, before the first of them.

        Raises:
            DatasetError: Already done, nothing to make room for, or the disk does not take it.
        """
        self._check_open()
        if schema.DRIFT in self._file:
            raise DatasetError(f"{self.path}: the drift checks are already planned")
        if not reflectors or n_checks < 1:
            raise DatasetError(
                f"{self.path}: {n_checks} drift checks of {len(reflectors)} reflectors are planned,"
                " at least 1 of each needed"
            )
        try:
            skeleton.create_drift(self._file, tuple(reflectors), n_checks)
            self._sync()
        except _WRITE_ERRORS as error:
            raise DatasetError(
                f"{self.path}: the drift checks could not be set up: {error}"
            ) from error
        self._reflectors = tuple(reflectors)

    def commit_drift(self, check: DriftRecord) -> None:
        """Store one drift check; when this returns, a kill does not lose it.

        Raises:
            DatasetError: It was not planned, contradicts the plan, or the disk does not take it.
        """
        self._check_open()
        values = drift_values_of(self.path, check, self._reflectors)
        row = self._n_rows(schema.N_DRIFT_CHECKS)
        if row == len(self._row(schema.DRIFT_CRC32)):
            raise DatasetError(f"{self.path}: one more than the {row} drift checks planned")
        try:
            for path, value in values.items():
                self._row(path)[row] = value
            self._row(schema.DRIFT_CRC32)[row] = schema.checksum(values.values())
            self._count(schema.N_DRIFT_CHECKS, row + 1)
        except _WRITE_ERRORS as error:
            raise DatasetError(
                f"{self.path}: a drift check could not be written: {error}"
            ) from error

    def commit(self, shot: ShotRecord) -> None:
        """Store one shot; when this returns, a kill does not lose it.

        Raises:
            DatasetError: The shot contradicts the dataset or the disk does not take it. The shots
                committed before stay readable either way.
        """
        self._check_open()
        self._check_plan(shot)
        recorded = self._row(schema.IMAGE).dtype if schema.IMAGE in self._file else None
        check_images(self.path, self._provenance, shot, recorded)
        values = values_of(self.path, shot)
        try:
            if recorded is None:
                self._make_room(shot)
            self._write(shot, values)
            self._count(schema.N_COMMITTED, self.n_committed + 1)
        except _WRITE_ERRORS as error:
            raise DatasetError(
                f"{self.path}: shot {shot.shot_id} could not be written: {error};"
                f" the {self.n_committed} shots before it are safe"
            ) from error
        self._shot_ids.add(shot.shot_id)

    def finish(self, status: schema.FinalStatus, reason: str = "") -> None:
        """Record how the campaign ended, and close the file.

        Raises:
            DatasetError: Already finished, an unknown status, or the disk does not take it.
        """
        self._check_open()
        if status not in get_args(schema.FinalStatus):
            allowed = ", ".join(get_args(schema.FinalStatus))
            raise DatasetError(f"{self.path}: status '{status}' is not one of {allowed}")
        try:
            # The file's own count: an interrupted commit may have counted its shot, and then it is
            # complete.
            n_rows = self._n_rows(schema.N_COMMITTED)
            if n_rows < self._provenance.n_shots_planned:
                skeleton.shrink_rows(self._file, n_rows)
            if self._reflectors:
                skeleton.shrink_drift(self._file, self._n_rows(schema.N_DRIFT_CHECKS))
            dataset_at(self._file, "entry/recording/reason")[()] = reason.replace("\0", " ")
            dataset_at(self._file, "entry/end_time")[()] = skeleton.utc_now()
            self._sync()
            dataset_at(self._file, "entry/recording/status")[()] = status
            self._sync()
        except _WRITE_ERRORS as error:
            raise DatasetError(f"{self.path}: could not be finished: {error}") from error
        finally:
            self._close()

    def _check_open(self) -> None:
        if not self._file:
            raise DatasetError(f"{self.path}: is finished; nothing more can be written to it")

    def _check_plan(self, shot: ShotRecord) -> None:
        if shot.shot_id in self._shot_ids:
            raise DatasetError(f"{self.path}: shot {shot.shot_id} is already committed")
        if self.n_committed == self._provenance.n_shots_planned:
            raise DatasetError(
                f"{self.path}: shot {shot.shot_id} is one more than the"
                f" {self._provenance.n_shots_planned} shots planned"
            )

    def _make_room(self, shot: ShotRecord) -> None:
        """Create the stacks of images and masks: the type of the images is known only now."""
        per_shot = shot.frame.image.nbytes + shot.mask.size
        self._probe_room(per_shot * self._provenance.n_shots_planned)
        skeleton.create_images(self._file, shot.frame.image.dtype, self._provenance)
        self._sync()

    def _probe_room(self, n_bytes: int) -> None:
        """Find out whether the file may grow so far before HDF5 tries: it would leave a ruin.

        Raises:
            OSError: The disk is too small, or the operating system refuses.
        """
        free = shutil.disk_usage(self.path.parent).free
        if free < n_bytes:
            text = f"{n_bytes / 1e6:.0f} MB needed, only {free / 1e6:.0f} MB free; free some space"
            raise OSError(errno.ENOSPC, text)
        size = self.path.stat().st_size
        os.ftruncate(self._file.id.get_vfd_handle(), size + n_bytes + _STRUCTURE_BYTES)
        os.ftruncate(self._file.id.get_vfd_handle(), size)

    def _write(self, shot: ShotRecord, values: Values) -> None:
        row = self.n_committed
        image = np.ascontiguousarray(shot.frame.image, dtype=self._row(schema.IMAGE).dtype)
        mask = np.ascontiguousarray(shot.mask, dtype=np.uint8)
        for path, array in ((schema.IMAGE, image), (schema.MASK, mask)):
            # Written past HDF5's cache: on a full disk nothing stays in there that would fail again
            # when the file is closed.
            self._row(path).id.write_direct_chunk((row, 0, 0), array)
        checksums = {
            schema.IMAGE_CRC32: schema.checksum([image]),
            schema.MASK_CRC32: schema.checksum([mask]),
            schema.VALUES_CRC32: schema.checksum(values.values()),
        }
        for path, value in {**values, **checksums}.items():
            self._row(path)[row] = value

    def _count(self, path: str, n: int) -> None:
        """Set a journal's counter, once its row is in the hands of the operating system."""
        self._file.flush()
        self._row(path)[()] = n
        self._file.flush()

    def _n_rows(self, counter: str) -> int:
        return int(self._row(counter)[()])

    def _row(self, path: str) -> h5py.Dataset:
        if path not in self._rows:
            self._rows[path] = dataset_at(self._file, path)
        return self._rows[path]

    def _sync(self) -> None:
        """Hand everything to the operating system, and have it put on the disk.

        Not for every shot: a flush is enough against a kill, and this costs tens of milliseconds.
        """
        self._file.flush()
        os.fsync(self._file.id.get_vfd_handle())

    def _close(self) -> None:
        try:
            self._file.close()
        except _WRITE_ERRORS as error:
            raise DatasetError(f"{self.path}: could not be closed properly: {error}") from error


def _create(path: Path) -> h5py.File:
    try:
        return h5py.File(path, "x")
    except FileExistsError as error:
        raise DatasetError(
            f"{path}: exists already and is never overwritten; choose another --out"
        ) from error
    except FileNotFoundError as error:
        raise DatasetError(f"{path}: the directory {path.parent} does not exist") from error
    except OSError as error:
        raise DatasetError(f"{path}: cannot be created: {error}") from error
