"""The layout of a dataset file: where each value lies, its shape, its type and its unit.

The layout is NeXus at heart (https://manual.nexusformat.org): groups carry ``NX_class``, the chain
of ``default`` attributes leads a viewer to the images, and every number says its unit (UDUNITS).
``docs/reference/dataset.md`` describes it for people.
"""

import math
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.records import DriftRecord, ShotRecord
from tronlab.devices.readings import PointReading
from tronlab.geometry.poses import FloatArray, xyz_quat_from_pose

SCHEMA_VERSION: Final = (1, 2)
"""Major and minor. A reader refuses a higher major; a higher minor only adds to the layout."""

SCHEMA_ATTRIBUTE: Final = "tronlab_schema"

FinalStatus: TypeAlias = Literal["complete", "aborted", "failed"]
Status: TypeAlias = Literal["running", "complete", "aborted", "failed"]
TruthState: TypeAlias = Literal["good", "suspect", "unchecked"]
"""Of a shot: between two good drift checks, beside a bad one, or without one on both sides."""

CAMERA: Final = "entry/instrument/camera"
ROBOT: Final = "entry/instrument/robot"
TRACKER: Final = "entry/instrument/tracker"
ROOM: Final = "entry/instrument/room"
TRUTH: Final = "entry/truth"
N_COMMITTED: Final = "entry/recording/n_committed"
IMAGE: Final = f"{CAMERA}/image"
MASK: Final = f"{CAMERA}/mask"
IMAGE_CRC32: Final = f"{CAMERA}/image_crc32"
MASK_CRC32: Final = f"{CAMERA}/mask_crc32"
VALUES_CRC32: Final = "entry/shots/values_crc32"
SHOT_ID: Final = "entry/shots/shot_id"
REFERENCES: Final = "entry/references"
REFERENCES_CRC32: Final = f"{REFERENCES}/crc32"
REFERENCE_VALUES: Final = ("view_id", "trs_from_cam", "image", "depth_m", "mask")
"""Everything of a reference view, in the order its checksum takes it."""
DRIFT: Final = "entry/drift"
N_DRIFT_CHECKS: Final = f"{DRIFT}/n_committed"
DRIFT_CRC32: Final = f"{DRIFT}/crc32"
RECOMPUTED: Final = "entry/recomputed"

POSE_UNITS: Final = ["m", "m", "m", "1", "1", "1", "1"]
"""Of the seven columns."""
COVARIANCE_UNITS: Final = ["rad", "rad", "rad", "m", "m", "m"]
"""Of rows and columns: element (i, j) has the product of units i and j."""
UNIX_TIME: Final = "seconds since 1970-01-01 00:00:00 UTC"
PIXEL_FORMAT_BYTES: Final = 16

GROUPS: Final[Mapping[str, str]] = {
    "entry": "NXentry",
    "entry/recording": "NXprocess",
    "entry/campaign": "NXnote",
    "entry/rig": "NXnote",
    "entry/calibration": "NXnote",
    "entry/software": "NXcollection",
    "entry/devices": "NXcollection",
    "entry/instrument": "NXinstrument",
    CAMERA: "NXdetector",
    f"{CAMERA}/model": "NXcollection",
    ROBOT: "NXpositioner",
    TRACKER: "NXcollection",
    ROOM: "NXcollection",
    "entry/shots": "NXcollection",
    TRUTH: "NXcollection",
    "entry/data": "NXdata",
}
"""Every group and its NeXus class; those that not every file has are in ``OPTIONAL_GROUPS``."""

OPTIONAL_GROUPS: Final[Mapping[str, str]] = {
    REFERENCES: "NXcollection",
    DRIFT: "NXcollection",
    RECOMPUTED: "NXprocess",
}


@dataclass(frozen=True, slots=True)
class Column:
    """A dataset with one row a shot."""

    path: str
    units: str | list[str]
    dtype: str = "<f8"
    shape: tuple[int, ...] = ()
    """Of one row."""
    attributes: Mapping[str, str] = field(default_factory=dict[str, str])
    is_optional: bool = False
    """Not every device says it: NaN where it is not known, and files of layout 1.0 lack it."""


@dataclass(frozen=True, slots=True)
class ShotColumn(Column):
    """A column that holds one value of the shot's record."""

    value_of: Callable[[ShotRecord], ArrayLike] = field(kw_only=True)


def pose_attributes(parent: str, child: str) -> dict[str, str]:
    """Give the attributes of a stored pose ``parent_from_child``."""
    return {
        "parent": parent,
        "child": child,
        "columns": "x y z qx qy qz qw",
        "quaternion_order": "x y z w",
    }


def _pose(path: str, pose_of: Callable[[ShotRecord], RigidTransform]) -> ShotColumn:
    return ShotColumn(
        path,
        POSE_UNITS,
        shape=(7,),
        attributes=pose_attributes(*_frames(path)),
        value_of=lambda shot: xyz_quat_from_pose(pose_of(shot)),
    )


def _covariance(path: str, covariance_of: Callable[[ShotRecord], FloatArray]) -> ShotColumn:
    parent, child = _frames(path)
    order = "rotation vector, translation; both in the parent frame"
    return ShotColumn(
        path,
        COVARIANCE_UNITS,
        shape=(6, 6),
        attributes={"parent": parent, "child": child, "order": order},
        value_of=covariance_of,
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


def _air(shot: ShotRecord, quantity: str) -> float | None:
    return None if shot.tracker.air is None else getattr(shot.tracker.air, quantity)


COLUMNS: Final[tuple[ShotColumn, ...]] = (
    ShotColumn(SHOT_ID, "1", "<i8", value_of=lambda s: s.shot_id),
    ShotColumn("entry/shots/attempt", "1", "<i8", value_of=lambda s: s.attempt),
    _pose("entry/shots/trs_from_cam_nominal", lambda s: s.trs_from_cam_nominal),
    ShotColumn(f"{ROBOT}/rail_m", "m", value_of=lambda s: s.robot.rail_m),
    _pose(f"{ROBOT}/base_from_flange", lambda s: s.robot.base_from_flange),
    ShotColumn(f"{ROBOT}/time_s", UNIX_TIME, value_of=lambda s: s.robot.time_s),
    _pose(f"{TRACKER}/trk_from_tmac", lambda s: s.tracker.trk_from_tmac),
    _covariance(f"{TRACKER}/trk_from_tmac_covariance", lambda s: s.tracker.covariance),
    ShotColumn(f"{TRACKER}/time_s", UNIX_TIME, value_of=lambda s: s.tracker.time_s),
    ShotColumn(f"{ROOM}/air_temperature_k", "K", value_of=lambda s: s.room.air_temperature_k),
    ShotColumn(f"{ROOM}/air_pressure_pa", "Pa", value_of=lambda s: s.room.air_pressure_pa),
    ShotColumn(f"{ROOM}/relative_humidity", "1", value_of=lambda s: s.room.relative_humidity),
    ShotColumn(f"{ROOM}/is_door_closed", "1", "u1", value_of=lambda s: s.room.is_door_closed),
    ShotColumn(f"{ROOM}/is_lamp_on", "1", "u1", value_of=lambda s: s.room.is_lamp_on),
    ShotColumn(f"{ROOM}/time_s", UNIX_TIME, value_of=lambda s: s.room.time_s),
    ShotColumn(
        f"{CAMERA}/pixel_format",
        "",
        f"S{PIXEL_FORMAT_BYTES}",
        value_of=lambda s: s.frame.pixel_format.encode(),
    ),
    ShotColumn(f"{CAMERA}/exposure_s", "s", value_of=lambda s: s.frame.exposure_s),
    ShotColumn(f"{CAMERA}/gain_db", "dB", value_of=lambda s: s.frame.gain_db),
    ShotColumn(f"{CAMERA}/frame_id", "1", "<i8", value_of=lambda s: s.frame.frame_id),
    ShotColumn(f"{CAMERA}/time_s", UNIX_TIME, value_of=lambda s: s.frame.time_s),
    _pose(f"{TRUTH}/trs_from_cam", lambda s: s.truth.trs_from_cam),
    _covariance(f"{TRUTH}/trs_from_cam_covariance", lambda s: s.truth.covariance),
    ShotColumn(f"{TRUTH}/range_los_m", "m", value_of=lambda s: s.truth.range_los_m),
    ShotColumn(f"{TRUTH}/usable_fraction", "1", value_of=lambda s: s.truth.usable_fraction),
    _optional(f"{TRACKER}/air_temperature_k", "K", lambda s: _air(s, "temperature_k")),
    _optional(f"{TRACKER}/air_pressure_pa", "Pa", lambda s: _air(s, "pressure_pa")),
    _optional(f"{TRACKER}/relative_humidity", "1", lambda s: _air(s, "relative_humidity")),
    _optional(f"{CAMERA}/device_time_s", "s", lambda s: s.frame.device_time_s),
)
"""Every value of a shot besides image and mask, in the order their checksum takes them."""


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
)
"""Every value of a drift check, in the order its checksum takes them."""

CHECKSUM_COLUMNS: Final[tuple[Column, ...]] = tuple(
    Column(path, "1", "<u4") for path in (IMAGE_CRC32, MASK_CRC32, VALUES_CRC32)
)
"""CRC-32 of the bytes of image, mask (as uint8) and all other values of a shot."""


def checksum(values: Iterable[NDArray[Any]]) -> int:
    """Give the CRC-32 of the bytes of all values, one after the other."""
    crc = 0
    for value in values:
        crc = zlib.crc32(np.ascontiguousarray(value).data, crc)
    return crc
