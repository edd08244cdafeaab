"""The empty dataset file: groups, provenance, and room for every planned shot.

Room is made for all planned shots before the first one is committed: committing then only
overwrites bytes in place and never touches the file's inner structure, so that neither a kill nor a
full disk can leave that structure half changed. Images and masks occupy disk only once written.
"""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, cast

import h5py
import numpy as np
from numpy.typing import DTypeLike, NDArray

from tronlab import __version__
from tronlab.dataset import schema
from tronlab.dataset.records import Provenance, ReferenceView
from tronlab.geometry.poses import xyz_quat_from_pose

_ROWS_PER_CHUNK = 64
_SHORT_TEXT_BYTES = 32
_REFERENCE_UNITS: Mapping[str, str | list[str]] = {
    "view_id": "1",
    "trs_from_cam": schema.POSE_UNITS,
    "image": "1",
    "depth_m": "m",
    "mask": "1",
}


def utc_now() -> str:
    """Give the time as ISO 8601 in UTC, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def group_at(file: h5py.File, path: str) -> h5py.Group:
    """Give the group at a path."""
    return cast(h5py.Group, file[path])


def dataset_at(file: h5py.File, path: str) -> h5py.Dataset:
    """Give the dataset at a path."""
    return cast(h5py.Dataset, file[path])


def create_skeleton(file: h5py.File, provenance: Provenance) -> None:
    """Write groups, provenance, the counter at 0 and empty columns for all planned shots."""
    file.attrs.update(
        {
            "NX_class": "NXroot",
            "default": "entry",
            "creator": "tronlab",
            schema.SCHEMA_ATTRIBUTE: ".".join(map(str, schema.SCHEMA_VERSION)),
        }
    )
    for path, nx_class in schema.GROUPS.items():
        file.create_group(path).attrs["NX_class"] = nx_class
    _write_entry(group_at(file, "entry"), provenance)
    _write_recording(group_at(file, "entry/recording"), provenance)
    _write_notes(file, provenance)
    file["entry/software"].attrs.update(provenance.software)
    file["entry/devices"].attrs.update(provenance.devices)
    file[f"{schema.CAMERA}/model"].attrs.update(provenance.camera.to_dict())
    for column in (*schema.COLUMNS, *schema.CHECKSUM_COLUMNS):
        _create_rows(file, column, provenance.n_shots_planned, row_shape=column.shape)
    file[schema.VALUES_CRC32].attrs["order"] = [column.path for column in schema.COLUMNS]


def create_images(file: h5py.File, dtype: DTypeLike, provenance: Provenance) -> None:
    """Make room for the images and masks of all planned shots, and link them for viewers."""
    shape = provenance.camera.shape
    stacks = [
        _create_stack(file, schema.IMAGE, shape, np.dtype(dtype).newbyteorder("<")),
        _create_stack(file, schema.MASK, shape, np.dtype(np.uint8)),
    ]
    # In turns, so that the last shots lie at the end of the file and their room can be given back.
    for n_rows in range(1, provenance.n_shots_planned + 1):
        for stack in stacks:
            stack.resize(n_rows, axis=0)
    file[schema.MASK].attrs["meaning"] = "1 where the flat outline of the model is seen"
    plot = group_at(file, "entry/data")
    plot.attrs.update({"signal": "image", "axes": ["shot_id", ".", "."]})
    plot["image"] = file[schema.IMAGE]
    plot["shot_id"] = file[schema.SHOT_ID]


def create_references(file: h5py.File, views: tuple[ReferenceView, ...]) -> None:
    """Write the reference views, all at once."""
    group = file.create_group(schema.REFERENCES)
    group.attrs["NX_class"] = schema.OPTIONAL_GROUPS[schema.REFERENCES]
    arrays = reference_arrays(views)
    for name, array in arrays.items():
        chunks = (1, *array.shape[1:]) if array.ndim == 3 else None
        stack = group.create_dataset(name, data=array, chunks=chunks)
        stack.attrs["units"] = _REFERENCE_UNITS[name]
    group["trs_from_cam"].attrs.update(schema.pose_attributes("trs", "cam"))
    crc32 = file.create_dataset(schema.REFERENCES_CRC32, data=reference_checksums(arrays))
    crc32.attrs.update({"units": "1", "order": list(schema.REFERENCE_VALUES)})


def reference_arrays(views: Sequence[ReferenceView]) -> dict[str, NDArray[Any]]:
    """Give the values of the reference views by name, stacked, in the order of their checksum."""
    stacks = {
        "view_id": np.array([v.view_id for v in views], "<i8"),
        "trs_from_cam": np.array([xyz_quat_from_pose(v.trs_from_cam) for v in views], "<f8"),
        "image": np.array([v.image for v in views], "u1"),
        "depth_m": np.array([v.depth_m for v in views], "<f4"),
        "mask": np.array([v.mask for v in views], "u1"),
    }
    return {name: stacks[name] for name in schema.REFERENCE_VALUES}


def reference_checksums(arrays: Mapping[str, NDArray[Any]]) -> NDArray[np.uint32]:
    """Give the checksum of each reference view."""
    return np.array(
        [schema.checksum(view) for view in zip(*arrays.values(), strict=True)], dtype="<u4"
    )


def create_drift(file: h5py.File, reflectors: tuple[str, ...], n_checks: int) -> None:
    """Make room for all planned drift checks, with the counter at 0."""
    group = file.create_group(schema.DRIFT)
    group.attrs.update(NX_class=schema.OPTIONAL_GROUPS[schema.DRIFT], reflectors=list(reflectors))
    for column in schema.DRIFT_COLUMNS:
        _create_rows(file, column, n_checks, row_shape=column.row_shape(len(reflectors)))
    crc32 = schema.Column(schema.DRIFT_CRC32, "1", "<u4")
    _create_rows(file, crc32, n_checks, row_shape=())
    file[schema.DRIFT_CRC32].attrs["order"] = [column.path for column in schema.DRIFT_COLUMNS]
    file.create_dataset(schema.N_DRIFT_CHECKS, data=np.int64(0)).attrs["units"] = "1"


def shrink_drift(file: h5py.File, n_rows: int) -> None:
    """Give back the room of drift checks that will never come."""
    for path in (*(column.path for column in schema.DRIFT_COLUMNS), schema.DRIFT_CRC32):
        dataset_at(file, path).resize(n_rows, axis=0)


def shrink_rows(file: h5py.File, n_rows: int) -> None:
    """Give back the room of shots that will never come."""
    columns = [column.path for column in (*schema.COLUMNS, *schema.CHECKSUM_COLUMNS)]
    stacks = [path for path in (schema.IMAGE, schema.MASK) if path in file]
    for path in columns + stacks:
        dataset_at(file, path).resize(n_rows, axis=0)


def _write_entry(entry: h5py.Group, provenance: Provenance) -> None:
    entry.attrs["default"] = "data"
    entry["title"] = provenance.campaign_name
    entry["start_time"] = utc_now()
    _create_short_text(entry, "end_time", "")


def _write_recording(recording: h5py.Group, provenance: Provenance) -> None:
    recording["program"] = "tronlab"
    recording["version"] = __version__
    recording["plan_sha256"] = provenance.plan_sha256
    recording["reason"] = ""
    _create_short_text(recording, "status", "running")
    numbers = {
        "seed": provenance.seed,
        "n_shots_planned": provenance.n_shots_planned,
        "n_committed": 0,
    }
    for name, number in numbers.items():
        recording.create_dataset(name, data=np.int64(number)).attrs["units"] = "1"


def _write_notes(file: h5py.File, provenance: Provenance) -> None:
    notes = {
        "campaign": ("application/yaml", provenance.campaign_yaml),
        "rig": ("application/yaml", provenance.rig_yaml),
        "calibration": ("application/json", provenance.calibration_json),
    }
    for name, (mime_type, text) in notes.items():
        note = group_at(file, f"entry/{name}")
        note["type"] = mime_type
        note["data"] = text
    if provenance.accepted:
        file["entry/calibration"].attrs["accepted"] = list(provenance.accepted)
    file["entry/instrument/name"] = provenance.rig_name


def _create_short_text(group: h5py.Group, name: str, text: str) -> None:
    """Fixed length, so that a later value overwrites it in place."""
    group.create_dataset(name, data=text, dtype=h5py.string_dtype("utf-8", _SHORT_TEXT_BYTES))


def _create_rows(
    file: h5py.File, column: schema.Column, n_rows: int, *, row_shape: tuple[int, ...]
) -> None:
    rows = file.create_dataset(
        column.path,
        shape=(n_rows, *row_shape),
        maxshape=(None, *row_shape),
        dtype=column.dtype,
        chunks=(min(n_rows, _ROWS_PER_CHUNK), *row_shape),
        dcpl=_allocated_early(),
    )
    rows.attrs.update({"units": column.units, **column.attributes})


def _create_stack(
    file: h5py.File, path: str, shape: tuple[int, int], dtype: np.dtype[Any]
) -> h5py.Dataset:
    stack = file.create_dataset(
        path,
        shape=(0, *shape),
        maxshape=(None, *shape),
        dtype=dtype,
        chunks=(1, *shape),
        dcpl=_allocated_early(),
        fill_time="never",
    )
    stack.attrs["units"] = "1"
    return stack


def _allocated_early() -> h5py.h5p.PropDCID:
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    return properties
