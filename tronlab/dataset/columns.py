"""The columns of a dataset file: what each row holds, its type, shape and unit.

A column knows how to take its value from the record of a shot or of a drift check.
"""

import math
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.records import DriftRecord, QualityFlag, ShotRecord, ShotTiming
from tronlab.dataset.schema import (
    CAMERA,
    COVARIANCE_UNITS,
    DRIFT,
    DRIFT_SESSION,
    ERROR_CLASSES,
    IMAGE_CRC32,
    MASK_CRC32,
    N_FAILURES,
    NO_ROW,
    PIXEL_FORMAT_BYTES,
    POSE_UNITS,
    QUALITY,
    QUALITY_FLAG_NAMES,
    QUALITY_FLAGS,
    ROBOT,
    ROOM,
    SESSION,
    SHOT_ID,
    SUPERSEDES,
    TIMING,
    TRACKER,
    TRUTH,
    UNIX_TIME,
    UNKNOWN_FLAG,
    VALUES_CRC32,
    VOID_SHOT_ID,
)
from tronlab.devices.readings import PointReading
from tronlab.geometry.poses import FloatArray, xyz_quat_from_pose


@dataclass(frozen=True, slots=True)
class Column:
    """A dataset with one row a shot."""

    path: str
    units: str | list[str]
    dtype: str = "<f8"
    shape: tuple[int, ...] = ()
    """Of one row."""
    attributes: Mapping[str, str | list[str]] = field(default_factory=dict[str, str | list[str]])
    is_optional: bool = False
    """Not always known: NaN where it is not, and files of older layouts may lack it."""
    is_of_laboratory: bool = False
    """Not known of imported shots: NaN there, or ``UNKNOWN_FLAG`` for a yes or no."""

    @property
    def fill(self) -> float:
        """Get what stands in rows that hold nothing."""
        if self.path in {SHOT_ID, SUPERSEDES}:
            return VOID_SHOT_ID if self.path == SHOT_ID else NO_ROW
        return math.nan if np.dtype(self.dtype).kind == "f" else 0


@dataclass(frozen=True, slots=True)
class ShotColumn(Column):
    """A column that holds one value of the shot's record."""

    value_of: Callable[[ShotRecord], ArrayLike] = field(kw_only=True)


def pose_attributes(parent: str, child: str) -> dict[str, str | list[str]]:
    """Give the attributes of a stored pose ``parent_from_child``."""
    return {
        "parent": parent,
        "child": child,
        "columns": "x y z qx qy qz qw",
        "quaternion_order": "x y z w",
    }


def _pose(path: str, pose_of: Callable[[ShotRecord], RigidTransform | None]) -> ShotColumn:
    def numbers(shot: ShotRecord) -> ArrayLike:
        pose = pose_of(shot)
        return np.full(7, np.nan) if pose is None else xyz_quat_from_pose(pose)

    return ShotColumn(
        path,
        POSE_UNITS,
        shape=(7,),
        attributes=pose_attributes(*_frames(path)),
        is_of_laboratory=path.startswith((ROBOT, TRACKER)),
        value_of=numbers,
    )


def _covariance(path: str, covariance_of: Callable[[ShotRecord], FloatArray | None]) -> ShotColumn:
    def numbers(shot: ShotRecord) -> ArrayLike:
        covariance = covariance_of(shot)
        return np.full((6, 6), np.nan) if covariance is None else covariance

    parent, child = _frames(path)
    order = "rotation vector, translation; both in the parent frame"
    return ShotColumn(
        path,
        COVARIANCE_UNITS,
        shape=(6, 6),
        attributes={"parent": parent, "child": child, "order": order},
        is_of_laboratory=True,
        value_of=numbers,
    )


def _frames(path: str) -> tuple[str, str]:
    """Take the frames from a name such as ``trs_from_cam_nominal``."""
    parent, _, child = path.rpartition("/")[2].split("_")[:3]
    return parent, child


def _optional(path: str, units: str, value_of: Callable[[ShotRecord], float | None]) -> ShotColumn:
    def number(shot: ShotRecord) -> float:
        value = value_of(shot)
        return math.nan if value is None else value

    return ShotColumn(path, units, is_optional=True, value_of=number)


def _measured(path: str, units: str, value_of: Callable[[ShotRecord], float | None]) -> ShotColumn:
    return replace(_optional(path, units, value_of), is_optional=False, is_of_laboratory=True)


def _flag(path: str, value_of: Callable[[ShotRecord], bool | None]) -> ShotColumn:
    def number(shot: ShotRecord) -> int:
        value = value_of(shot)
        return UNKNOWN_FLAG if value is None else value

    return ShotColumn(path, "1", "u1", is_of_laboratory=True, value_of=number)


def _air(shot: ShotRecord, quantity: str) -> float | None:
    air = shot.tracker and shot.tracker.air
    return None if air is None else getattr(air, quantity)


def quality_bits(flags: Iterable[QualityFlag]) -> int:
    """Give flags as bits, in the order of ``QUALITY_FLAG_NAMES``."""
    return sum(1 << QUALITY_FLAG_NAMES.index(flag) for flag in set(flags))


def _quality(name: str, units: str) -> ShotColumn:
    def value_of(shot: ShotRecord) -> float | None:
        return None if shot.quality is None else getattr(shot.quality, name)

    return _optional(f"{QUALITY}/{name}", units, value_of)


def _timing(name: str) -> ShotColumn:
    def value_of(shot: ShotRecord) -> float | None:
        return None if shot.timing is None else getattr(shot.timing, name)

    return _optional(f"{TIMING}/{name}", "s", value_of)


_QUALITY_UNITS: Final = {
    "settle_shift_m": "m",
    "settle_turn_rad": "rad",
    "exposure_shift_m": "m",
    "exposure_turn_rad": "rad",
    "tracker_sigma_m": "m",
    "robot_shift_m": "m",
    "robot_turn_rad": "rad",
    "saturated_fraction": "1",
    "contrast": "1",
    "sharpness": "1",
    "brightness": "1/s",
}

COLUMNS: Final[tuple[ShotColumn, ...]] = (
    ShotColumn(SHOT_ID, "1", "<i8", value_of=lambda s: s.shot_id),
    ShotColumn("entry/shots/attempt", "1", "<i8", value_of=lambda s: s.attempt),
    _pose("entry/shots/trs_from_cam_nominal", lambda s: s.trs_from_cam_nominal),
    _measured(f"{ROBOT}/rail_m", "m", lambda s: s.robot and s.robot.rail_m),
    _pose(f"{ROBOT}/base_from_flange", lambda s: s.robot and s.robot.base_from_flange),
    _measured(f"{ROBOT}/time_s", UNIX_TIME, lambda s: s.robot and s.robot.time_s),
    _pose(f"{TRACKER}/trk_from_tmac", lambda s: s.tracker and s.tracker.trk_from_tmac),
    _covariance(
        f"{TRACKER}/trk_from_tmac_covariance", lambda s: s.tracker and s.tracker.covariance
    ),
    _measured(f"{TRACKER}/time_s", UNIX_TIME, lambda s: s.tracker and s.tracker.time_s),
    _measured(f"{ROOM}/air_temperature_k", "K", lambda s: s.room and s.room.air_temperature_k),
    _measured(f"{ROOM}/air_pressure_pa", "Pa", lambda s: s.room and s.room.air_pressure_pa),
    _measured(f"{ROOM}/relative_humidity", "1", lambda s: s.room and s.room.relative_humidity),
    _flag(f"{ROOM}/is_door_closed", lambda s: s.room and s.room.is_door_closed),
    _flag(f"{ROOM}/is_lamp_on", lambda s: s.room and s.room.is_lamp_on),
    _measured(f"{ROOM}/time_s", UNIX_TIME, lambda s: s.room and s.room.time_s),
    ShotColumn(
        f"{CAMERA}/pixel_format",
        "",
        f"S{PIXEL_FORMAT_BYTES}",
        value_of=lambda s: s.frame.pixel_format.encode(),
    ),
    _measured(f"{CAMERA}/exposure_s", "s", lambda s: s.frame.exposure_s),
    _measured(f"{CAMERA}/gain_db", "dB", lambda s: s.frame.gain_db),
    ShotColumn(f"{CAMERA}/frame_id", "1", "<i8", value_of=lambda s: s.frame.frame_id),
    _measured(f"{CAMERA}/time_s", UNIX_TIME, lambda s: s.frame.time_s),
    _pose(f"{TRUTH}/trs_from_cam", lambda s: s.truth.trs_from_cam),
    _covariance(f"{TRUTH}/trs_from_cam_covariance", lambda s: s.truth.covariance),
    ShotColumn(f"{TRUTH}/range_los_m", "m", value_of=lambda s: s.truth.range_los_m),
    ShotColumn(f"{TRUTH}/usable_fraction", "1", value_of=lambda s: s.truth.usable_fraction),
    _optional(f"{TRACKER}/air_temperature_k", "K", lambda s: _air(s, "temperature_k")),
    _optional(f"{TRACKER}/air_pressure_pa", "Pa", lambda s: _air(s, "pressure_pa")),
    _optional(f"{TRACKER}/relative_humidity", "1", lambda s: _air(s, "relative_humidity")),
    _optional(f"{CAMERA}/device_time_s", "s", lambda s: s.frame.device_time_s),
    ShotColumn(SESSION, "1", "<i8", is_optional=True, value_of=lambda s: s.session),
    ShotColumn(
        N_FAILURES,
        "1",
        "<u2",
        shape=(len(ERROR_CLASSES),),
        attributes={"classes": list(ERROR_CLASSES)},
        is_optional=True,
        value_of=lambda s: [s.n_failures.get(name, 0) for name in ERROR_CLASSES],
    ),
    *(_quality(name, units) for name, units in _QUALITY_UNITS.items()),
    ShotColumn(
        QUALITY_FLAGS,
        "1",
        "<u4",
        attributes={"flags": list(QUALITY_FLAG_NAMES)},
        is_optional=True,
        value_of=lambda s: 0 if s.quality is None else quality_bits(s.quality.flags),
    ),
    *(_timing(field.name) for field in fields(ShotTiming)),
)
"""Every value of a shot besides image and mask."""

SUPERSEDES_COLUMN: Final = Column(SUPERSEDES, "1", "<i8", is_optional=True)
"""The earlier row of the same shot that this row replaces, or -1."""


@dataclass(frozen=True, slots=True)
class DriftColumn(Column):
    """A dataset with one row a drift check."""

    value_of: Callable[[DriftRecord], ArrayLike] = field(kw_only=True)
    is_per_reflector: bool = field(default=False, kw_only=True)
    """A row has one value a reflector, each of shape ``shape``."""

    def row_shape(self, n_reflectors: int) -> tuple[int, ...]:
        """Give the shape of one row."""
        return (n_reflectors, *self.shape) if self.is_per_reflector else self.shape


def _per_reflector(
    name: str,
    units: str,
    shape: tuple[int, ...],
    value_of: Callable[[PointReading], FloatArray | float],
) -> DriftColumn:
    return DriftColumn(
        f"{DRIFT}/{name}",
        units,
        shape=shape,
        is_per_reflector=True,
        value_of=lambda check: np.array([value_of(point) for point in check.readings.values()]),
    )


DRIFT_COLUMNS: Final[tuple[DriftColumn, ...]] = (
    DriftColumn(f"{DRIFT}/n_shots_before", "1", "<i8", value_of=lambda c: c.n_shots_before),
    DriftColumn(f"{DRIFT}/time_s", UNIX_TIME, value_of=lambda c: c.time_s),
    _per_reflector("p_trk_m", "m", (3,), lambda reading: reading.p_trk_m),
    _per_reflector("p_trk_covariance_m2", "m2", (3, 3), lambda reading: reading.covariance_m2),
    _per_reflector("p_trk_time_s", UNIX_TIME, (), lambda reading: reading.time_s),
    DriftColumn(f"{DRIFT}/shift", COVARIANCE_UNITS, shape=(6,), value_of=lambda c: c.shift),
    DriftColumn(f"{DRIFT}/max_shift_m", "m", value_of=lambda c: c.max_shift_m),
    DriftColumn(f"{DRIFT}/limit_m", "m", value_of=lambda c: c.limit_m),
    DriftColumn(f"{DRIFT}/is_within", "1", "u1", value_of=lambda c: c.is_within),
    DriftColumn(DRIFT_SESSION, "1", "<i8", is_optional=True, value_of=lambda c: c.session),
)
"""Every value of a drift check, in the order its checksum takes them."""

CHECKSUM_COLUMNS: Final[tuple[Column, ...]] = tuple(
    Column(path, "1", "<u4") for path in (IMAGE_CRC32, MASK_CRC32, VALUES_CRC32)
)
"""CRC-32 of the bytes of image, mask (as uint8) and all other values of a shot."""

ROW_COLUMNS: Final[tuple[Column, ...]] = (*COLUMNS, SUPERSEDES_COLUMN, *CHECKSUM_COLUMNS)
"""Everything with one row a shot, besides image and mask."""

ROW_BYTES: Final = sum(
    np.dtype(column.dtype).itemsize * math.prod(column.shape) for column in ROW_COLUMNS
)

VALUES_ORDER: Final = (*(column.path for column in COLUMNS), SUPERSEDES)
"""The columns in the order their checksum takes them."""


def checksum(values: Iterable[NDArray[Any]]) -> int:
    """Give the CRC-32 of the bytes of all values, one after the other."""
    crc = 0
    for value in values:
        crc = zlib.crc32(np.ascontiguousarray(value).data, crc)
    return crc


def void_row() -> dict[str, NDArray[Any]]:
    """Give the values of a row that holds no shot, by the path of their column."""
    columns = (*COLUMNS, SUPERSEDES_COLUMN)
    values = {c.path: np.full(c.shape, c.fill, c.dtype) for c in columns}
    crc32 = checksum(values[path] for path in VALUES_ORDER)
    return {**values, VALUES_CRC32: np.array(crc32, "<u4")}
