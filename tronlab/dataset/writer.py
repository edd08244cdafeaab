"""Recording a dataset shot by shot, so that neither a kill nor a power cut loses what is committed.

The dataset is its own journal: image and mask, then values and checksums, then the counter
``n_committed``. All of it overwrites bytes of files whose structure was made before. A kill leaves
what the operating system was given, in this order. Against power cuts everything is forced to the
disk at least once a second, and ``reopen`` drops the last rows if their checksums do not match.
"""

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Final, Self, get_args

import numpy as np

from tronlab.dataset import columns, schema, skeleton
from tronlab.dataset.admission import Values, check_images, check_view, values_of
from tronlab.dataset.beginning import N_VERIFIED_ROWS, Beginning, begin, begin_again
from tronlab.dataset.drift_writing import DriftWriter
from tronlab.dataset.image_writing import ImageWriter, MasterImages, SegmentImages
from tronlab.dataset.master import Master
from tronlab.dataset.records import DriftRecord, Provenance, ReferenceView, Session, ShotRecord
from tronlab.dataset.segments import plan_segments
from tronlab.errors import DatasetError

_SYNC_EVERY_S: Final = 1.0
_SYNC_EVERY_ROWS: Final = N_VERIFIED_ROWS // 2


class DatasetWriter:
    """Writes one dataset.

    Its file gets its name with the first shot; if there never is one, nothing is left. Leaving the
    ``with`` block by an exception before ``finish`` records the exception and status ``failed``, or
    ``aborted`` for Ctrl-C. Leaving it otherwise without ``finish`` leaves the status ``running``.
    Hold ``lock.run_lock`` meanwhile: it keeps a second recording away.
    """

    def __init__(
        self,
        path: Path,
        provenance: Provenance,
        *,
        session: Session | None = None,
        segment_shots: int | None = None,
        n_spare_rows: int = 0,
    ) -> None:
        """Begin a new dataset.

        Args:
            path: Its file; it must not exist.
            provenance: Where it comes from.
            session: Who records; shots and drift checks get its number. None: it is made from
                another dataset, and they say their session themselves.
            segment_shots: Images of so many shots go to one file beside; None: all into this one.
            n_spare_rows: Room for shots that are taken again.

        Raises:
            DatasetError: The file exists, images of another dataset are where its own would be, it
                cannot be created, or the provenance makes no sense.
        """
        self._set_up(
            *begin(
                path,
                provenance,
                session,
                n_spare_rows=n_spare_rows,
                has_segments=segment_shots is not None,
            ),
            session,
            segment_shots,
        )

    @classmethod
    def reopen(
        cls,
        path: Path,
        session: Session,
        *,
        n_rows: int,
        segment_shots: int,
        n_shots_planned: int | None = None,
    ) -> Self:
        """Go on with a dataset that was recorded in segments.

        The last rows are verified; those that a power cut damaged are dropped, and the journal says
        so. The file itself stays as it was until the first shot is committed, or ``finish``.

        Args:
            path: Its file.
            session: Who records now; its number follows the last one's.
            n_rows: So many more rows are needed.
            segment_shots: Of new segments; one that was begun is filled first.
            n_shots_planned: If that is another number now.

        Raises:
            DatasetError: It cannot be read, has no segments, is of another version, or the session
                does not follow; or the disk does not take it.
        """
        writer = cls.__new__(cls)
        master, beginning = begin_again(
            path,
            session,
            n_rows=n_rows,
            segment_shots=segment_shots,
            n_shots_planned=n_shots_planned,
        )
        writer._set_up(master, beginning, session, segment_shots)  # noqa: SLF001 - it is this class
        return writer

    def _set_up(
        self,
        master: Master,
        beginning: Beginning,
        session: Session | None,
        segment_shots: int | None,
    ) -> None:
        self.path = master.path
        self._master = master
        self._beginning = beginning
        self._session = session
        self._segment_shots = segment_shots
        self._n_rows = beginning.n_rows
        self._row_of = dict(beginning.row_of)
        self._has_references = beginning.has_references
        self._drift = DriftWriter(master, beginning.reflectors, beginning.n_checks)
        self._images: ImageWriter | None = None
        if beginning.dtype is not None:
            self._images = self._segment_images(beginning.dtype)
        self._n_unsynced, self._synced_s = 0, time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if not self._master.is_open:
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
        """Get the number of shots that are safe in the dataset."""
        return len(self._row_of)

    @property
    def committed_ids(self) -> frozenset[int]:
        """Get the ids of those shots."""
        return frozenset(self._row_of)

    def add_references(self, views: Sequence[ReferenceView]) -> None:
        """Store the reference views; once, before the first shot.

        Raises:
            DatasetError: No views, views already stored, a view that does not fit the camera, the
                writer is finished, or the disk does not take them.
        """
        self._check_open()
        if self._has_references:
            raise DatasetError(f"{self.path}: the reference views are already stored")
        if not views:
            raise DatasetError(f"{self.path}: no reference views were given")
        for view in views:
            check_view(self.path, self._beginning.shape, view)
        n_bytes = sum(v.image.nbytes + v.depth_m.nbytes + v.mask.nbytes for v in views)
        with (
            self._master.explaining("the reference views could not be written"),
            self._master.structure(n_bytes) as file,
        ):
            skeleton.create_references(file, tuple(views))
        self._has_references = True

    def plan_drift_checks(self, reflectors: Sequence[str], n_checks: int) -> None:
        """Make room for the drift checks of this session; once, before the first of them.

        Raises:
            DatasetError: Already done, nothing to make room for, other reflectors than in an
                earlier session, or the disk does not take it.
        """
        self._check_open()
        self._drift.plan(reflectors, n_checks)

    def commit_drift(self, check: DriftRecord) -> None:
        """Store one drift check; when this returns, a kill does not lose it.

        It is stored as made after the rows that are committed now: what it counts itself are the
        shots of its session only.

        Raises:
            DatasetError: It was not planned, contradicts the plan, or the disk does not take it.
        """
        self._check_open()
        check = replace(check, n_shots_before=self._n_rows)
        if self._session is not None:
            check = replace(check, session=self._session.number)
        self._drift.commit(check)

    def commit(self, shot: ShotRecord, replaces: bool = False) -> None:
        """Store one shot; when this returns, a kill does not lose it.

        Args:
            shot: The shot.
            replaces: Whether it may take the place of the same shot committed before, which stays
                in the file but does not count any more.

        Raises:
            DatasetError: The shot contradicts the dataset or the disk does not take it. The shots
                committed before stay readable either way.
        """
        self._check_open()
        self._check_plan(shot, replaces=replaces)
        recorded = self._images.dtype if self._images is not None else None
        check_images(self.path, self._beginning.shape, shot, recorded)
        if self._session is not None:
            shot = replace(shot, session=self._session.number)
        values = values_of(self.path, shot)
        values[schema.SUPERSEDES] = np.array(
            self._row_of.get(shot.shot_id, schema.NO_ROW), columns.SUPERSEDES_COLUMN.dtype
        )
        with self._master.explaining(
            f"shot {shot.shot_id} could not be written",
            f"; the {self.n_committed} shots before it are safe",
        ):
            images = self._images or self._first_images(shot)
            self._write(images, shot, values)
        self._row_of[shot.shot_id] = self._n_rows
        self._n_rows += 1

    def finish(self, status: schema.FinalStatus, reason: str = "") -> None:
        """Record how the campaign ended, and close the files; without any shot, remove them.

        Raises:
            DatasetError: Already finished, an unknown status, or the disk does not take it.
        """
        self._check_open()
        if status not in get_args(schema.FinalStatus):
            allowed = ", ".join(get_args(schema.FinalStatus))
            raise DatasetError(f"{self.path}: status '{status}' is not one of {allowed}")
        try:
            with self._master.explaining("could not be finished"):
                if self._n_rows:
                    self._write_ending(status, reason)
        finally:
            self._close()

    def _check_open(self) -> None:
        if not self._master.is_open:
            raise DatasetError(f"{self.path}: is finished; nothing more can be written to it")

    def _check_plan(self, shot: ShotRecord, *, replaces: bool) -> None:
        if shot.shot_id < 0:
            raise DatasetError(f"{self.path}: shot {shot.shot_id}: ids begin at 0")
        if shot.shot_id in self._row_of and not replaces:
            raise DatasetError(f"{self.path}: shot {shot.shot_id} is already committed")
        if self._n_rows == self._beginning.room:
            raise DatasetError(
                f"{self.path}: shot {shot.shot_id} is one more than the"
                f" {self._beginning.room} shots planned"
            )

    def _first_images(self, shot: ShotRecord) -> ImageWriter:
        """Make the structure for images: their type is known only now."""
        dtype = shot.frame.image.dtype.newbyteorder("<")
        shape, room = self._beginning.shape, self._beginning.room
        if self._segment_shots is None:
            n_bytes = room * (shot.frame.image.nbytes + shot.mask.size)
            with self._master.structure(n_bytes) as file:
                skeleton.create_images(file, n_rows=room, shape=shape, dtype=dtype)
            self._images = MasterImages(self._master, dtype)
        else:
            segments = plan_segments(self.path, (), n_rows=room, segment_shots=self._segment_shots)
            with self._master.structure() as file:
                skeleton.show_segments(file, segments, shape=shape, dtype=dtype)
            self._beginning = replace(self._beginning, segments=segments)
            self._images = self._segment_images(dtype)
        return self._images

    def _segment_images(self, dtype: np.dtype) -> SegmentImages:
        return SegmentImages(
            self.path,
            self._beginning.segments,
            uuid=self._beginning.uuid,
            shape=self._beginning.shape,
            dtype=dtype,
        )

    def _write(self, images: ImageWriter, shot: ShotRecord, values: Values) -> None:
        row = self._n_rows
        image = np.ascontiguousarray(shot.frame.image, dtype=images.dtype)
        mask = np.ascontiguousarray(shot.mask).view(np.uint8)
        is_sync_due = self._is_sync_due()
        images.write(row, image, mask)
        if is_sync_due:
            images.sync()
        checksums = {
            schema.IMAGE_CRC32: columns.checksum([image]),
            schema.MASK_CRC32: columns.checksum([mask]),
            schema.VALUES_CRC32: columns.checksum(values[path] for path in columns.VALUES_ORDER),
        }
        for path, value in {**values, **checksums}.items():
            self._master.write_row(path, row, value)
        if not self._master.is_published:
            self._master.publish()  # before the first shot counts: a file without name has none
        self._master.write(schema.N_COMMITTED, row + 1)
        if is_sync_due:
            self._master.sync()
        self._note_sync(is_done=is_sync_due)

    def _is_sync_due(self) -> bool:
        return (
            not self._master.is_published
            or self._n_unsynced >= _SYNC_EVERY_ROWS
            or time.monotonic() - self._synced_s >= _SYNC_EVERY_S
        )

    def _note_sync(self, *, is_done: bool) -> None:
        if is_done:
            self._n_unsynced, self._synced_s = 0, time.monotonic()
        else:
            self._n_unsynced += 1

    def _write_ending(self, status: schema.FinalStatus, reason: str) -> None:
        if self._images is not None:
            self._images.sync()
        self._master.write(schema.REASON, skeleton.shortened(reason, skeleton.REASON_BYTES))
        self._master.write(schema.END_TIME, skeleton.utc_now().encode())
        self._master.write(schema.STATUS, status.encode())
        if self._master.is_published:
            self._master.sync()
        else:
            self._master.publish()

    def _close(self) -> None:
        if self._images is not None:
            self._images.close()
        self._master.close()
