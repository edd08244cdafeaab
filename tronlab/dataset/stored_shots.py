"""The rows of a dataset file, one a shot that was taken, and the records made of them."""

import math
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.dataset import columns, schema
from tronlab.dataset.hdf5 import Hdf5Reader
from tronlab.dataset.records import (
    ErrorClass,
    QualityFlag,
    ShotQuality,
    ShotRecord,
    ShotTiming,
    Truth,
)
from tronlab.dataset.segments import Segment, SegmentReader
from tronlab.devices.readings import AirReading, Frame, PoseReading, RobotReading, RoomReading
from tronlab.errors import FrameError, IntegrityError
from tronlab.geometry.poses import pose_from_xyz_quat

_QUALITY_NUMBERS: Final = tuple(
    field.name for field in fields(ShotQuality) if field.name not in {"flags"}
)
_NAMES_OF_STACKS: Final = {schema.IMAGE: "image", schema.MASK: "mask"}


class StoredShots:
    """Every committed row, also those that were superseded; the caller checks the index."""

    def __init__(self, path: Path, file: Hdf5Reader) -> None:
        """Find out how many rows there are.

        Raises:
            IntegrityError: The counter contradicts the columns, or something is missing.
        """
        self._path = path
        self._file = file
        self.n_rows = self._counted()
        self.shot_ids: NDArray[np.int64] = self.column(schema.SHOT_ID).astype(np.int64)
        self.segments = _segments(file)
        self._segment_reader = (
            SegmentReader(path, file.text(schema.UUID), self.segments) if self.segments else None
        )

    @property
    def room(self) -> int:
        """Get the number of rows that there is room for."""
        return len(self._file.at(schema.SHOT_ID))

    def close(self) -> None:
        """Close the segments; may be called twice."""
        if self._segment_reader is not None:
            self._segment_reader.close()

    def current_rows(self) -> NDArray[np.intp]:
        """Give the rows that hold a shot and were not replaced by a later one."""
        is_current = self.shot_ids != schema.VOID_SHOT_ID
        if schema.SUPERSEDES in self._file:
            later = np.flatnonzero(is_current & (self.column(schema.SUPERSEDES) != schema.NO_ROW))
            last_row_of = dict(zip(self.shot_ids[later].tolist(), later.tolist(), strict=True))
            first_valid = [last_row_of.get(shot_id, 0) for shot_id in self.shot_ids.tolist()]
            is_current &= np.arange(self.n_rows) >= np.array(first_valid, np.intp)
        return np.flatnonzero(is_current)

    def column(self, path: str) -> NDArray[Any]:
        """Read one column (``tronlab.dataset.schema``) of all rows."""
        return self._file.read(path, slice(0, self.n_rows))

    def sessions(self) -> NDArray[np.int64]:
        """Read which session took each row; 1 in files that do not say it."""
        if schema.SESSION not in self._file:
            return np.ones(self.n_rows, np.int64)
        return self.column(schema.SESSION)

    def image(self, row: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Read an image and verify its checksum."""
        return self._verified(schema.IMAGE, schema.IMAGE_CRC32, row)

    def mask(self, row: int) -> NDArray[np.bool_]:
        """Read a mask and verify its checksum."""
        return self._verified(schema.MASK, schema.MASK_CRC32, row).astype(np.bool_)

    def values_order(self) -> list[str]:
        """Give the columns in the order the checksum of the values takes them.

        Raises:
            IntegrityError: The file does not say it.
        """
        order = self._file.attributes(schema.VALUES_CRC32).get("order", ())
        if not len(order):
            raise IntegrityError(f"{self._path}: {schema.VALUES_CRC32} does not say its order")
        return [str(path) for path in order]

    def has_good_values(self, row: int) -> bool:
        """Tell whether the values besides image and mask fit their checksum."""
        # A slice keeps the stored type, an index would make a Python value of a text.
        rows = (self._file.read(path, slice(row, row + 1)) for path in self.values_order())
        return columns.checksum(rows) == int(self._file.read(schema.VALUES_CRC32, row))

    def is_whole(self, row: int) -> bool:
        """Tell whether everything of a row fits its checksums.

        Raises:
            IntegrityError: Its images cannot be read at all, as when a segment is missing.
        """
        if self.shot_ids[row] == schema.VOID_SHOT_ID:
            return self.has_good_values(row)
        return self.has_good_values(row) and all(
            columns.checksum([self._stacked(path, row)]) == int(self._file.read(crc32, row))
            for path, crc32 in (
                (schema.IMAGE, schema.IMAGE_CRC32),
                (schema.MASK, schema.MASK_CRC32),
            )
        )

    def shot(self, row: int) -> ShotRecord:
        """Read everything of a row."""
        return ShotRecord(
            shot_id=int(self.shot_ids[row]),
            attempt=int(self._value("entry/shots/attempt", row)),
            trs_from_cam_nominal=self._pose("entry/shots/trs_from_cam_nominal", row),
            robot=self._robot(row),
            tracker=self._tracker(row),
            room=self._room(row),
            frame=self._frame(row),
            mask=self.mask(row),
            truth=self.truth(row),
            quality=self.quality(row),
            timing=self.timing(row),
            n_failures=self.n_failures(row),
            session=self.session(row),
        )

    def truth(self, row: int) -> Truth:
        """Read the ground truth of a row."""
        return Truth(
            trs_from_cam=self._pose(f"{schema.TRUTH}/trs_from_cam", row),
            covariance=self._value(f"{schema.TRUTH}/trs_from_cam_covariance", row),
            range_los_m=float(self._value(f"{schema.TRUTH}/range_los_m", row)),
            usable_fraction=float(self._value(f"{schema.TRUTH}/usable_fraction", row)),
        )

    def pixel_format(self, row: int) -> str:
        """Read how the grey values are coded, as ``Mono8``."""
        where = f"shot {self.shot_ids[row]}: pixel_format"
        return self._file.decoded(where, bytes(self._value(f"{schema.CAMERA}/pixel_format", row)))

    def quality(self, row: int) -> ShotQuality | None:
        """Read how good a shot is; None if nobody measured it."""
        numbers = {name: self._known(f"{schema.QUALITY}/{name}", row) for name in _QUALITY_NUMBERS}
        if all(number is None for number in numbers.values()):
            return None
        known = {name: math.nan if n is None else n for name, n in numbers.items()}
        return ShotQuality(
            **{**known, "brightness": numbers["brightness"]},  # pyright: ignore[reportArgumentType]
            flags=self._flags(row),
        )

    def timing(self, row: int) -> ShotTiming | None:
        """Read how long the parts of a shot took; None if nobody measured it."""
        names = [field.name for field in fields(ShotTiming)]
        numbers = {name: self._known(f"{schema.TIMING}/{name}", row) for name in names}
        if all(number is None for number in numbers.values()):
            return None
        return ShotTiming(**{name: math.nan if n is None else n for name, n in numbers.items()})

    def n_failures(self, row: int) -> Mapping[ErrorClass, int]:
        """Read how many attempts came to nothing before, by why."""
        if schema.N_FAILURES not in self._file:
            return {}
        classes = self._file.attributes(schema.N_FAILURES).get("classes", ())
        counts = self._value(schema.N_FAILURES, row)
        named = zip(map(str, classes), counts.tolist(), strict=True)
        return {cast(ErrorClass, name): n for name, n in named if n}

    def session(self, row: int) -> int:
        """Read which session took a row."""
        return int(self._value(schema.SESSION, row)) if schema.SESSION in self._file else 1

    def as_pose(self, path: str, row: int, xyz_quat: NDArray[Any]) -> RigidTransform:
        """Make a pose of its seven columns.

        Raises:
            IntegrityError: They are none.
        """
        try:
            return pose_from_xyz_quat(xyz_quat)
        except FrameError as error:
            raise IntegrityError(f"{self._path}: {path}[{row}]: {error}") from error

    def _robot(self, row: int) -> RobotReading | None:
        time_s = self._known(f"{schema.ROBOT}/time_s", row)
        if time_s is None:
            return None
        return RobotReading(
            rail_m=float(self._value(f"{schema.ROBOT}/rail_m", row)),
            base_from_flange=self._pose(f"{schema.ROBOT}/base_from_flange", row),
            time_s=time_s,
        )

    def _tracker(self, row: int) -> PoseReading | None:
        time_s = self._known(f"{schema.TRACKER}/time_s", row)
        if time_s is None:
            return None
        return PoseReading(
            trk_from_tmac=self._pose(f"{schema.TRACKER}/trk_from_tmac", row),
            covariance=self._value(f"{schema.TRACKER}/trk_from_tmac_covariance", row),
            time_s=time_s,
            air=self._air(row),
        )

    def _room(self, row: int) -> RoomReading | None:
        time_s = self._known(f"{schema.ROOM}/time_s", row)
        if time_s is None:
            return None
        return RoomReading(
            air_temperature_k=float(self._value(f"{schema.ROOM}/air_temperature_k", row)),
            air_pressure_pa=float(self._value(f"{schema.ROOM}/air_pressure_pa", row)),
            relative_humidity=float(self._value(f"{schema.ROOM}/relative_humidity", row)),
            is_door_closed=bool(self._value(f"{schema.ROOM}/is_door_closed", row)),
            is_lamp_on=bool(self._value(f"{schema.ROOM}/is_lamp_on", row)),
            time_s=time_s,
        )

    def _air(self, row: int) -> AirReading | None:
        values = [
            self._known(f"{schema.TRACKER}/{name}", row)
            for name in ("air_temperature_k", "air_pressure_pa", "relative_humidity")
        ]
        if any(value is None for value in values):
            return None
        return AirReading(*cast("list[float]", values))

    def _frame(self, row: int) -> Frame:
        return Frame(
            image=self.image(row),
            pixel_format=self.pixel_format(row),
            exposure_s=float(self._value(f"{schema.CAMERA}/exposure_s", row)),
            gain_db=float(self._value(f"{schema.CAMERA}/gain_db", row)),
            frame_id=int(self._value(f"{schema.CAMERA}/frame_id", row)),
            time_s=float(self._value(f"{schema.CAMERA}/time_s", row)),
            device_time_s=self._known(f"{schema.CAMERA}/device_time_s", row),
        )

    def _flags(self, row: int) -> tuple[QualityFlag, ...]:
        if schema.QUALITY_FLAGS not in self._file:
            return ()
        names = self._file.attributes(schema.QUALITY_FLAGS).get("flags", ())
        bits = int(self._value(schema.QUALITY_FLAGS, row))
        if bits >> len(names):
            raise IntegrityError(
                f"{self._path}: shot {self.shot_ids[row]}: {schema.QUALITY_FLAGS} is {bits}, but"
                f" only {len(names)} flags have names"
            )
        return tuple(
            cast(QualityFlag, str(name)) for bit, name in enumerate(names) if bits >> bit & 1
        )

    def _counted(self) -> int:
        n = int(self._file.read(schema.N_COMMITTED))
        if not 0 <= n <= self.room:
            raise IntegrityError(
                f"{self._path}: {n} shots are counted as committed, there is room for {self.room}"
            )
        return n

    def _verified(self, path: str, crc_path: str, row: int) -> NDArray[Any]:
        array = self._stacked(path, row)
        if columns.checksum([array]) != int(self._value(crc_path, row)):
            raise IntegrityError(
                f"{self._path}: shot {self.shot_ids[row]}: {_NAMES_OF_STACKS[path]} is damaged:"
                " its checksum does not match; fetch the file again from its source"
            )
        return array

    def _stacked(self, path: str, row: int) -> NDArray[Any]:
        if self._segment_reader is None:
            return self._value(path, row)
        return self._segment_reader.read(path, row)

    def _pose(self, path: str, row: int) -> RigidTransform:
        return self.as_pose(path, row, self._value(path, row))

    def _known(self, path: str, row: int) -> float | None:
        """Read an optional value; None if the file lacks it or it was not known."""
        value = float(self._value(path, row)) if path in self._file else math.nan
        return None if math.isnan(value) else value

    def _value(self, path: str, row: int) -> Any:
        return self._file.read(path, row)


def _segments(file: Hdf5Reader) -> tuple[Segment, ...]:
    if schema.SEGMENTS not in file:
        return ()
    names = [bytes(name).decode() for name in file.read(f"{schema.SEGMENTS}/file")]
    first_rows = file.read(f"{schema.SEGMENTS}/first_row").tolist()
    lengths = file.read(f"{schema.SEGMENTS}/n_rows").tolist()
    return tuple(Segment(*row) for row in zip(names, first_rows, lengths, strict=True))
