"""Reading a dataset; whatever is wrong with the file becomes one clear error."""

import math
from dataclasses import fields
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.dataset import schema
from tronlab.dataset.drift import drift_records, truth_states
from tronlab.dataset.opening import open_dataset
from tronlab.dataset.records import (
    DriftRecord,
    Provenance,
    Recomputation,
    ReferenceView,
    ShotRecord,
    Truth,
)
from tronlab.devices.readings import AirReading, Frame, PoseReading, RobotReading, RoomReading
from tronlab.errors import CalibrationError, DatasetError, FrameError, IntegrityError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_from_xyz_quat

_TRUTH_COLUMNS = ("trs_from_cam", "trs_from_cam_covariance", "range_los_m", "usable_fraction")


class Dataset:
    """One recorded dataset. Only committed shots exist; images are read when asked for.

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
        self._file = open_dataset(path)
        self._objects: dict[str, Any] = {}
        try:
            self._n_shots = self._counted()
            self.shot_ids: NDArray[np.int64] = self.rows(schema.SHOT_ID).astype(np.int64)
            self.provenance: Provenance = self._provenance()
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
        self._file.close()

    @property
    def n_shots(self) -> int:
        """Get the number of committed shots."""
        return self._n_shots

    @property
    def camera(self) -> CameraModel:
        """Get the calibrated intrinsics of the images."""
        return self.provenance.camera

    @property
    def status(self) -> schema.Status:
        """Get how the campaign ended; ``running`` if it never said."""
        status = self._text("entry/recording/status")
        if status not in get_args(schema.Status):
            raise IntegrityError(f"{self.path}: unknown status '{status}'")
        return cast(schema.Status, status)

    @property
    def reason(self) -> str:
        """Get why the campaign ended so; empty if there was nothing to say."""
        return self._text("entry/recording/reason")

    @property
    def schema_version(self) -> str:
        """Get the version of the layout, ``major.minor``."""
        return str(self._file.attrs[schema.SCHEMA_ATTRIBUTE])

    @property
    def start_time(self) -> str:
        """Get when recording began, ISO 8601."""
        return self._text("entry/start_time")

    @property
    def end_time(self) -> str:
        """Get when the campaign ended, ISO 8601; empty if it never said."""
        return self._text("entry/end_time")

    @property
    def image_dtype(self) -> np.dtype[Any] | None:
        """Get the type of the images; None before the first shot."""
        return self._object(schema.IMAGE).dtype if schema.IMAGE in self._file else None

    @property
    def n_references(self) -> int:
        """Get the number of reference views."""
        if schema.REFERENCES not in self._file:
            return 0
        return len(self._object(f"{schema.REFERENCES}/view_id"))

    @cached_property
    def drift_checks(self) -> tuple[DriftRecord, ...]:
        """Get the drift checks in their order, checksums verified; empty if there were none."""
        if schema.DRIFT not in self._file:
            return ()
        n = int(self._read(schema.N_DRIFT_CHECKS))
        paths = (*(column.path for column in schema.DRIFT_COLUMNS), schema.DRIFT_CRC32)
        rows = {path: self._read(path, slice(0, n)) for path in paths}
        reflectors = self._attributes(schema.DRIFT).get("reflectors", ())
        try:
            return drift_records(rows, tuple(map(str, reflectors)))
        except IntegrityError as error:
            raise IntegrityError(f"{self.path}: {error}") from None

    @cached_property
    def truth_states(self) -> tuple[schema.TruthState, ...]:
        """Get what the drift checks say of the truth of each shot."""
        return truth_states(self.n_shots, self.drift_checks)

    def columns(self) -> tuple[schema.ShotColumn, ...]:
        """Give the columns of the layout that this file has: older ones lack some optional ones."""
        return tuple(
            column
            for column in schema.COLUMNS
            if not column.is_optional or column.path in self._file
        )

    def shots_with_damaged_values(self) -> tuple[int, ...]:
        """Give the ids of shots whose values, besides image and mask, do not fit their checksum."""
        order = self._attributes(schema.VALUES_CRC32).get("order", ())
        if not len(order):
            raise IntegrityError(f"{self.path}: {schema.VALUES_CRC32} does not say its order")
        values = [self.rows(str(path)) for path in order]
        checksums = self.rows(schema.VALUES_CRC32)
        # A slice keeps the stored type, an index would make a Python value of a text.
        return tuple(
            int(shot_id)
            for i, shot_id in enumerate(self.shot_ids)
            if schema.checksum(rows[i : i + 1] for rows in values) != checksums[i]
        )

    def image(self, i: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Read the image of shot ``i``, shape (rows, columns), and verify its checksum."""
        return self._stacked(schema.IMAGE, schema.IMAGE_CRC32, i)

    def mask(self, i: int) -> NDArray[np.bool_]:
        """Read the mask of shot ``i``, shape (rows, columns), and verify its checksum."""
        return self._stacked(schema.MASK, schema.MASK_CRC32, i).astype(np.bool_)

    def pixel_format(self, i: int) -> str:
        """Read how the grey values of shot ``i`` are coded, as ``Mono8``."""
        path = f"{schema.CAMERA}/pixel_format"
        i = self._checked(i)
        where = f"shot {self.shot_ids[i]}: pixel_format"
        return self._decoded(where, bytes(self._value(path, i)))

    def truth(self, i: int) -> Truth:
        """Read the ground truth of shot ``i``."""
        return self._truth(self._checked(i))

    def truths(self) -> tuple[Truth, ...]:
        """Read the ground truth of all shots."""
        poses, covariances, ranges_m, fractions = (
            self.rows(f"{schema.TRUTH}/{name}") for name in _TRUTH_COLUMNS
        )
        return tuple(
            Truth(
                trs_from_cam=self._as_pose(f"{schema.TRUTH}/trs_from_cam", i, poses[i]),
                covariance=covariances[i],
                range_los_m=float(ranges_m[i]),
                usable_fraction=float(fractions[i]),
            )
            for i in range(self.n_shots)
        )

    def shot(self, i: int) -> ShotRecord:
        """Read everything of shot ``i``."""
        i = self._checked(i)
        return ShotRecord(
            shot_id=int(self.shot_ids[i]),
            attempt=int(self._value("entry/shots/attempt", i)),
            trs_from_cam_nominal=self._pose("entry/shots/trs_from_cam_nominal", i),
            robot=RobotReading(
                rail_m=float(self._value(f"{schema.ROBOT}/rail_m", i)),
                base_from_flange=self._pose(f"{schema.ROBOT}/base_from_flange", i),
                time_s=float(self._value(f"{schema.ROBOT}/time_s", i)),
            ),
            tracker=PoseReading(
                trk_from_tmac=self._pose(f"{schema.TRACKER}/trk_from_tmac", i),
                covariance=self._value(f"{schema.TRACKER}/trk_from_tmac_covariance", i),
                time_s=float(self._value(f"{schema.TRACKER}/time_s", i)),
                air=self._air(i),
            ),
            room=self._room(i),
            frame=self._frame(i),
            mask=self.mask(i),
            truth=self._truth(i),
        )

    def references(self) -> tuple[ReferenceView, ...]:
        """Read the reference views and verify their checksums; empty if there are none."""
        return tuple(self.reference(i) for i in range(self.n_references))

    def reference(self, i: int) -> ReferenceView:
        """Read reference view ``i``, 0 to ``n_references - 1``, and verify its checksum."""
        if not 0 <= i < self.n_references:
            raise DatasetError(
                f"{self.path}: no reference view with index {i}; there are {self.n_references}"
            )
        values = [self._value(f"{schema.REFERENCES}/{name}", i) for name in schema.REFERENCE_VALUES]
        view_id, xyz_quat, image, depth_m, mask = values
        if schema.checksum(values) != self._value(schema.REFERENCES_CRC32, i):
            raise IntegrityError(
                f"{self.path}: reference view {view_id} is damaged: its checksum does not match;"
                " fetch the file again from its source"
            )
        return ReferenceView(
            view_id=int(view_id),
            trs_from_cam=self._as_pose(f"{schema.REFERENCES}/trs_from_cam", i, xyz_quat),
            image=image,
            depth_m=depth_m,
            mask=mask.astype(np.bool_),
        )

    def rows(self, path: str) -> NDArray[Any]:
        """Read one column (``tronlab.dataset.schema``) of all committed shots."""
        return self._read(path, slice(0, self.n_shots))

    def _room(self, i: int) -> RoomReading:
        return RoomReading(
            air_temperature_k=float(self._value(f"{schema.ROOM}/air_temperature_k", i)),
            air_pressure_pa=float(self._value(f"{schema.ROOM}/air_pressure_pa", i)),
            relative_humidity=float(self._value(f"{schema.ROOM}/relative_humidity", i)),
            is_door_closed=bool(self._value(f"{schema.ROOM}/is_door_closed", i)),
            is_lamp_on=bool(self._value(f"{schema.ROOM}/is_lamp_on", i)),
            time_s=float(self._value(f"{schema.ROOM}/time_s", i)),
        )

    def _air(self, i: int) -> AirReading | None:
        values = [
            self._known(f"{schema.TRACKER}/{name}", i)
            for name in ("air_temperature_k", "air_pressure_pa", "relative_humidity")
        ]
        if any(value is None for value in values):
            return None
        return AirReading(*cast("list[float]", values))

    def _known(self, path: str, i: int) -> float | None:
        """Read an optional value; None if the file lacks it or it was not known."""
        value = float(self._value(path, i)) if path in self._file else math.nan
        return None if math.isnan(value) else value

    def _frame(self, i: int) -> Frame:
        return Frame(
            image=self.image(i),
            pixel_format=self.pixel_format(i),
            exposure_s=float(self._value(f"{schema.CAMERA}/exposure_s", i)),
            gain_db=float(self._value(f"{schema.CAMERA}/gain_db", i)),
            frame_id=int(self._value(f"{schema.CAMERA}/frame_id", i)),
            time_s=float(self._value(f"{schema.CAMERA}/time_s", i)),
            device_time_s=self._known(f"{schema.CAMERA}/device_time_s", i),
        )

    def _truth(self, i: int) -> Truth:
        return Truth(
            trs_from_cam=self._pose(f"{schema.TRUTH}/trs_from_cam", i),
            covariance=self._value(f"{schema.TRUTH}/trs_from_cam_covariance", i),
            range_los_m=float(self._value(f"{schema.TRUTH}/range_los_m", i)),
            usable_fraction=float(self._value(f"{schema.TRUTH}/usable_fraction", i)),
        )

    def _provenance(self) -> Provenance:
        return Provenance(
            campaign_name=self._text("entry/title"),
            campaign_yaml=self._text("entry/campaign/data"),
            rig_name=self._text("entry/instrument/name"),
            rig_yaml=self._text("entry/rig/data"),
            calibration_json=self._text("entry/calibration/data"),
            seed=int(self._read("entry/recording/seed")),
            software=self._attributes("entry/software"),
            devices=self._attributes("entry/devices"),
            plan_sha256=self._text("entry/recording/plan_sha256"),
            n_shots_planned=int(self._read("entry/recording/n_shots_planned")),
            camera=self._camera_model(),
            accepted=tuple(map(str, self._attributes("entry/calibration").get("accepted", ()))),
            recomputation=self._recomputation(),
        )

    def _recomputation(self) -> Recomputation | None:
        if schema.RECOMPUTED not in self._file:
            return None
        texts = {
            field.name: self._text(f"{schema.RECOMPUTED}/{field.name}")
            for field in fields(Recomputation)
        }
        return Recomputation(**texts)

    def _camera_model(self) -> CameraModel:
        path = f"{schema.CAMERA}/model"
        values: dict[str, Any] = {}
        for name, value in self._attributes(path).items():
            # Text of digits would pass for a number.
            if not isinstance(value, np.generic | np.ndarray) or value.dtype.kind not in "iuf":
                raise IntegrityError(f"{self.path}: {path}: {name} is {value!r}, not a number")
            values[name] = value.tolist()
        try:
            return CameraModel.from_dict(values)
        except (CalibrationError, OverflowError) as error:
            raise IntegrityError(f"{self.path}: {path}: {error}") from error

    def _counted(self) -> int:
        n = int(self._read(schema.N_COMMITTED))
        n_rows = len(self._object(schema.SHOT_ID))
        if not 0 <= n <= n_rows:
            raise IntegrityError(
                f"{self.path}: {n} shots are counted as committed, there is room for {n_rows}"
            )
        return n

    def _checked(self, i: int) -> int:
        if not 0 <= i < self.n_shots:
            allowed = f"0 to {self.n_shots - 1}" if self.n_shots else "none, it holds no shots"
            raise DatasetError(f"{self.path}: no shot with index {i}; allowed: {allowed}")
        return i

    def _stacked(self, path: str, crc_path: str, i: int) -> NDArray[Any]:
        array = self._value(path, self._checked(i))
        if schema.checksum([array]) != int(self._value(crc_path, i)):
            raise IntegrityError(
                f"{self.path}: shot {self.shot_ids[i]}: {path.rpartition('/')[2]} is damaged:"
                " its checksum does not match; fetch the file again from its source"
            )
        return array

    def _pose(self, path: str, i: int) -> RigidTransform:
        return self._as_pose(path, i, self._value(path, i))

    def _as_pose(self, path: str, i: int, xyz_quat: NDArray[Any]) -> RigidTransform:
        try:
            return pose_from_xyz_quat(xyz_quat)
        except FrameError as error:
            raise IntegrityError(f"{self.path}: {path}[{i}]: {error}") from error

    def _value(self, path: str, i: int) -> Any:
        """Read one row; the index must be checked."""
        return self._read(path, i)

    def _text(self, path: str) -> str:
        value = self._read(path)
        return self._decoded(path, value) if isinstance(value, bytes) else str(value)

    def _decoded(self, where: str, text: bytes) -> str:
        try:
            return text.decode()
        except UnicodeDecodeError as error:
            raise IntegrityError(
                f"{self.path}: {where} is damaged: {text[:40]!r} is not text"
            ) from error

    def _attributes(self, path: str) -> dict[str, Any]:
        attributes = dict(self._object(path).attrs)
        attributes.pop("NX_class", None)
        return attributes

    def _read(self, path: str, where: Any = ()) -> Any:
        dataset = self._object(path)
        try:
            return dataset[where]
        except (OSError, RuntimeError, ValueError, IndexError) as error:
            raise IntegrityError(
                f"{self.path}: {path} cannot be read, the file is damaged (HDF5: {error})"
            ) from error

    def _object(self, path: str) -> Any:
        if not self._file:
            raise DatasetError(f"{self.path}: is closed")
        try:
            if path not in self._objects:
                self._objects[path] = self._file[path]
            return self._objects[path]
        except (KeyError, OSError, RuntimeError) as error:
            raise IntegrityError(
                f"{self.path}: {path} is missing or damaged (HDF5: {error})"
            ) from error
