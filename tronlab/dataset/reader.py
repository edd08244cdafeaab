"""Reading a dataset; whatever is wrong with its files becomes one clear error."""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast, get_args

import numpy as np
from numpy.typing import NDArray

from tronlab.dataset import columns, schema
from tronlab.dataset.drift import drift_records, truth_states
from tronlab.dataset.hdf5 import Hdf5Reader
from tronlab.dataset.opening import open_dataset
from tronlab.dataset.records import (
    DriftRecord,
    ErrorClass,
    Provenance,
    ReferenceView,
    Session,
    ShotQuality,
    ShotRecord,
    ShotTiming,
    Truth,
)
from tronlab.dataset.segments import Segment
from tronlab.dataset.sessions import only_session, read_sessions
from tronlab.dataset.stored_provenance import read_provenance
from tronlab.dataset.stored_shots import StoredShots
from tronlab.errors import DatasetError, IntegrityError
from tronlab.geometry.camera import CameraModel


class Dataset:
    """One recorded dataset: its committed shots, in the order they were taken.

    A shot that was taken again is there once, as it was taken last. Images are read when asked for,
    and a dataset that is being recorded may be read: it shows what was there when it was opened.

    Every method may raise ``IntegrityError`` if what it reads is damaged.
    """

    def __init__(self, path: Path) -> None:
        """Open the file.

        Raises:
            DatasetError: No such file, a directory, not HDF5, not a dataset, or being written.
            SchemaVersionError: Written by a version with another layout.
            IntegrityError: Truncated, or inconsistent.
        """
        self.path = path
        self._file = Hdf5Reader(path, open_dataset(path))
        try:
            self.stored = StoredShots(path, self._file)
            """Every row, also those that were superseded."""
            self._rows = self.stored.current_rows()
            self.shot_ids: NDArray[np.int64] = self.stored.shot_ids[self._rows]
            self.provenance: Provenance = read_provenance(self._file)
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; may be called twice."""
        self.stored.close()
        self._file.close()

    @property
    def n_shots(self) -> int:
        """Get the number of committed shots."""
        return len(self._rows)

    @property
    def n_rows(self) -> int:
        """Get the number of committed rows, with those of shots that were taken again."""
        return self.stored.n_rows

    @property
    def row_numbers(self) -> tuple[int, ...]:
        """Get the row of each shot."""
        return tuple(self._rows.tolist())

    @property
    def superseded_rows(self) -> tuple[int, ...]:
        """Get the rows whose shot was taken again later."""
        is_held = self.stored.shot_ids != schema.VOID_SHOT_ID
        is_held[self._rows] = False
        return tuple(np.flatnonzero(is_held).tolist())

    @property
    def void_rows(self) -> tuple[int, ...]:
        """Get the rows that hold nothing: a power cut had damaged them."""
        is_void = self.stored.shot_ids == schema.VOID_SHOT_ID
        return tuple(np.flatnonzero(is_void).tolist())

    @property
    def segments(self) -> tuple[Segment, ...]:
        """Get the segments planned; empty if the images are in the file itself.

        Only those whose first row is below ``n_rows`` hold anything.
        """
        return self.stored.segments

    @property
    def uuid(self) -> str | None:
        """Get what tells this dataset from all others; None before layout 2."""
        return self._file.text(schema.UUID) if schema.UUID in self._file else None

    @property
    def can_go_on(self) -> bool:
        """Tell whether more can be recorded into it: its images are in segments, as recorded."""
        return bool(self.segments) and self.schema_version == schema.VERSION_TEXT

    @property
    def camera(self) -> CameraModel:
        """Get the calibrated intrinsics of the images."""
        return self.provenance.camera

    @cached_property
    def sessions(self) -> tuple[Session, ...]:
        """Get who recorded when; one that follows from the provenance if none is named."""
        return read_sessions(self._file) or (
            only_session(self.provenance, start_utc=self.start_time),
        )

    @property
    def status(self) -> schema.Status:
        """Get how the campaign ended; ``running`` if it never said."""
        status = self._file.text(schema.STATUS)
        if status not in get_args(schema.Status):
            raise IntegrityError(f"{self.path}: unknown status '{status}'")
        return cast(schema.Status, status)

    @property
    def reason(self) -> str:
        """Get why the campaign ended so; empty if there was nothing to say."""
        return self._file.text(schema.REASON)

    @property
    def schema_version(self) -> str:
        """Get the version of the layout, ``major.minor``."""
        return str(self._file.attributes("/")[schema.SCHEMA_ATTRIBUTE])

    @property
    def start_time(self) -> str:
        """Get when recording began, ISO 8601."""
        return self._file.text("entry/start_time")

    @property
    def end_time(self) -> str:
        """Get when the campaign ended, ISO 8601; empty if it never said."""
        return self._file.text(schema.END_TIME)

    @property
    def image_dtype(self) -> np.dtype[Any] | None:
        """Get the type of the images; None before the first shot."""
        return self._file.at(schema.IMAGE).dtype if schema.IMAGE in self._file else None

    @property
    def n_references(self) -> int:
        """Get the number of reference views."""
        if schema.REFERENCES not in self._file:
            return 0
        return len(self._file.at(f"{schema.REFERENCES}/view_id"))

    @cached_property
    def drift_checks(self) -> tuple[DriftRecord, ...]:
        """Get the drift checks in their order, checksums verified; empty if there were none.

        Their ``n_shots_before`` counts rows.
        """
        if schema.DRIFT not in self._file:
            return ()
        n = int(self._file.read(schema.N_DRIFT_CHECKS))
        order = self._file.attributes(schema.DRIFT_CRC32).get("order", ())
        paths = (schema.DRIFT_CRC32, *map(str, order))
        rows = {path: self._file.read(path, slice(0, n)) for path in paths}
        try:
            return drift_records(rows, self.drift_reflectors)
        except IntegrityError as error:
            raise IntegrityError(f"{self.path}: {error}") from None
        except KeyError as error:
            raise IntegrityError(f"{self.path}: {schema.DRIFT}: {error} is missing") from None

    @property
    def drift_reflectors(self) -> tuple[str, ...]:
        """Get the names of the reflectors that drift checks measure; empty without such checks."""
        if schema.DRIFT not in self._file:
            return ()
        return tuple(map(str, self._file.attributes(schema.DRIFT).get("reflectors", ())))

    @cached_property
    def truth_states(self) -> tuple[schema.TruthState, ...]:
        """Get what the drift checks say of the truth of each shot."""
        frames = {session.number: session.calibration_json for session in self.sessions}
        try:
            return truth_states(
                self._rows.tolist(),
                self.stored.sessions()[self._rows].tolist(),
                self.drift_checks,
                frames,
            )
        except KeyError as error:
            raise IntegrityError(f"{self.path}: there is no session {error}") from None

    def columns(self) -> tuple[columns.ShotColumn, ...]:
        """Give the columns of the layout that this file has: older ones lack some optional ones."""
        return tuple(
            column
            for column in columns.COLUMNS
            if not column.is_optional or column.path in self._file
        )

    def shots_with_damaged_values(self) -> tuple[int, ...]:
        """Give the ids of shots whose values, besides image and mask, do not fit their checksum."""
        values = [self.rows(path) for path in self.stored.values_order()]
        checksums = self.rows(schema.VALUES_CRC32)
        # A slice keeps the stored type, an index would make a Python value of a text.
        return tuple(
            int(shot_id)
            for i, shot_id in enumerate(self.shot_ids)
            if columns.checksum(rows[i : i + 1] for rows in values) != checksums[i]
        )

    def image(self, i: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Read the image of shot ``i``, shape (rows, columns), and verify its checksum."""
        return self.stored.image(self._row(i))

    def mask(self, i: int) -> NDArray[np.bool_]:
        """Read the mask of shot ``i``, shape (rows, columns), and verify its checksum."""
        return self.stored.mask(self._row(i))

    def pixel_format(self, i: int) -> str:
        """Read how the grey values of shot ``i`` are coded, as ``Mono8``."""
        return self.stored.pixel_format(self._row(i))

    def truth(self, i: int) -> Truth:
        """Read the ground truth of shot ``i``."""
        return self.stored.truth(self._row(i))

    def quality(self, i: int) -> ShotQuality | None:
        """Read how good shot ``i`` is; None if nobody measured it."""
        return self.stored.quality(self._row(i))

    def timing(self, i: int) -> ShotTiming | None:
        """Read how long the parts of shot ``i`` took; None if nobody measured it."""
        return self.stored.timing(self._row(i))

    def n_failures(self, i: int) -> Mapping[ErrorClass, int]:
        """Read how many attempts at shot ``i`` came to nothing, by why."""
        return self.stored.n_failures(self._row(i))

    def session(self, i: int) -> int:
        """Read the number of the session that took shot ``i``."""
        return self.stored.session(self._row(i))

    def shot(self, i: int) -> ShotRecord:
        """Read everything of shot ``i``."""
        return self.stored.shot(self._row(i))

    def references(self) -> tuple[ReferenceView, ...]:
        """Read the reference views and verify their checksums; empty if there are none."""
        return tuple(self.reference(i) for i in range(self.n_references))

    def reference(self, i: int) -> ReferenceView:
        """Read reference view ``i``, 0 to ``n_references - 1``, and verify its checksum."""
        if not 0 <= i < self.n_references:
            raise DatasetError(
                f"{self.path}: no reference view with index {i}; there are {self.n_references}"
            )
        values = [
            self._file.read(f"{schema.REFERENCES}/{name}", i) for name in schema.REFERENCE_VALUES
        ]
        view_id, xyz_quat, image, depth_m, mask = values
        if columns.checksum(values) != self._file.read(schema.REFERENCES_CRC32, i):
            raise IntegrityError(
                f"{self.path}: reference view {view_id} is damaged: its checksum does not match;"
                " fetch the file again from its source"
            )
        return ReferenceView(
            view_id=int(view_id),
            trs_from_cam=self.stored.as_pose(f"{schema.REFERENCES}/trs_from_cam", i, xyz_quat),
            image=image,
            depth_m=depth_m,
            mask=mask.astype(np.bool_),
        )

    def rows(self, path: str) -> NDArray[Any]:
        """Read one column (``tronlab.dataset.schema``) of all shots."""
        return self.stored.column(path)[self._rows]

    def _row(self, i: int) -> int:
        if not 0 <= i < self.n_shots:
            allowed = f"0 to {self.n_shots - 1}" if self.n_shots else "none, it holds no shots"
            raise DatasetError(f"{self.path}: no shot with index {i}; allowed: {allowed}")
        return int(self._rows[i])
