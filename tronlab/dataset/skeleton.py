"""The empty dataset file: groups, provenance, and room for every planned shot.

Room is made for all rows before the file has its name: committing a shot then only overwrites bytes
in place and never touches the file's inner structure, so that neither a kill nor a full disk can
leave that structure half changed.
"""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, cast

import h5py
import numpy as np
from numpy.typing import NDArray

from tronlab import __version__
from tronlab.dataset import columns, schema
from tronlab.dataset.records import Provenance, ReferenceView
from tronlab.dataset.segments import (
    Segment,
    create_stack,
    write_segment_table,
    write_virtual_stacks,
)
from tronlab.geometry.poses import xyz_quat_from_pose

SHORT_TEXT_BYTES = 32
REASON_BYTES = 4096
"""The journal has longer ones whole."""
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


def create_skeleton(file: h5py.File, provenance: Provenance, *, uuid: str, n_rows: int) -> None:
    """Write groups, provenance, the counter at 0 and empty columns."""
    file.attrs.update(
        {
            "NX_class": "NXroot",
            "default": "entry",
            "creator": "tronlab",
            schema.SCHEMA_ATTRIBUTE: schema.VERSION_TEXT,
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
    file[schema.UUID] = uuid
    for column in columns.ROW_COLUMNS:
        _create_rows(file, column, n_rows, row_shape=column.shape)
    file[schema.VALUES_CRC32].attrs["order"] = list(columns.VALUES_ORDER)
    _link(file, "entry/overview", "range_los_m", f"{schema.TRUTH}/range_los_m")
    _link(file, "entry/overview", "usable_fraction", f"{schema.TRUTH}/usable_fraction")
    file["entry/overview"].attrs.update(
        {"signal": "range_los_m", "auxiliary_signals": ["usable_fraction"], "axes": ["shot_id"]}
    )
    _link(file, "entry/overview", "shot_id", schema.SHOT_ID)


def create_images(
    file: h5py.File, *, n_rows: int, shape: tuple[int, int], dtype: np.dtype[Any]
) -> None:
    """Make room for images and masks in the dataset's own file."""
    create_stack(file, schema.IMAGE, (n_rows, *shape), dtype)
    create_stack(file, schema.MASK, (n_rows, *shape), np.dtype(np.uint8))
    describe_images(file)


def show_segments(
    file: h5py.File, segments: Sequence[Segment], *, shape: tuple[int, int], dtype: np.dtype[Any]
) -> None:
    """Say where the segments are, and let viewers see them as one stack."""
    write_segment_table(file, segments)
    write_virtual_stacks(file, segments, shape=shape, dtype=dtype)
    describe_images(file)


def describe_images(file: h5py.File) -> None:
    """Say what images and masks are, and let viewers find them."""
    for path in (schema.IMAGE, schema.MASK):
        file[path].attrs["units"] = "1"
    file[schema.MASK].attrs["meaning"] = "1 where the flat outline of the model is seen"
    file["entry/data"].attrs.update({"signal": "image", "axes": ["shot_id", ".", "."]})
    _link(file, "entry/data", "image", schema.IMAGE)
    _link(file, "entry/data", "shot_id", schema.SHOT_ID)


def _link(file: h5py.File, group: str, name: str, target: str) -> None:
    """Let viewers find a dataset; a soft link survives that the dataset is made anew."""
    if name not in file[group]:  # pyright: ignore[reportOperatorIssue]
        file[f"{group}/{name}"] = h5py.SoftLink(f"/{target}")


def create_references(file: h5py.File, views: tuple[ReferenceView, ...]) -> None:
    """Write the reference views, all at once."""
    group = file.create_group(schema.REFERENCES)
    group.attrs["NX_class"] = schema.OPTIONAL_GROUPS[schema.REFERENCES]
    arrays = reference_arrays(views)
    for name, array in arrays.items():
        chunks = (1, *array.shape[1:]) if array.ndim == 3 else None
        stack = group.create_dataset(name, data=array, chunks=chunks)
        stack.attrs["units"] = _REFERENCE_UNITS[name]
    group["trs_from_cam"].attrs.update(columns.pose_attributes("trs", "cam"))
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
        [columns.checksum(view) for view in zip(*arrays.values(), strict=True)], dtype="<u4"
    )


def create_drift(file: h5py.File, reflectors: tuple[str, ...], n_checks: int) -> None:
    """Make room for all planned drift checks, with the counter at 0."""
    group = file.create_group(schema.DRIFT)
    group.attrs.update(NX_class=schema.OPTIONAL_GROUPS[schema.DRIFT], reflectors=list(reflectors))
    for column in columns.DRIFT_COLUMNS:
        _create_rows(file, column, n_checks, row_shape=column.row_shape(len(reflectors)))
    crc32 = columns.Column(schema.DRIFT_CRC32, "1", "<u4")
    _create_rows(file, crc32, n_checks, row_shape=())
    file[schema.DRIFT_CRC32].attrs["order"] = [column.path for column in columns.DRIFT_COLUMNS]
    file.create_dataset(schema.N_DRIFT_CHECKS, data=np.int64(0)).attrs["units"] = "1"


def resize_drift(file: h5py.File, n_checks: int) -> None:
    """Make room for so many drift checks in all."""
    for path in (*(column.path for column in columns.DRIFT_COLUMNS), schema.DRIFT_CRC32):
        _resize(file, path, n_checks)


def resize_rows(file: h5py.File, n_rows: int) -> None:
    """Make room for so many rows in all, besides their images."""
    for column in columns.ROW_COLUMNS:
        _resize(file, column.path, n_rows)


def _write_entry(entry: h5py.Group, provenance: Provenance) -> None:
    entry.attrs["default"] = "data"
    entry["title"] = provenance.campaign_name
    entry["start_time"] = utc_now()
    create_text(entry, "end_time", "", SHORT_TEXT_BYTES)


def _write_recording(recording: h5py.Group, provenance: Provenance) -> None:
    recording["program"] = "tronlab"
    recording["version"] = __version__
    recording["plan_sha256"] = provenance.plan_sha256
    create_text(recording, "reason", "", REASON_BYTES)
    create_text(recording, "status", "running", SHORT_TEXT_BYTES)
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


def shortened(text: str, n_bytes: int) -> bytes:
    """Give a text as HDF5 can store it in so many bytes; an ellipsis says that there was more."""
    encoded = text.replace("\0", " ").encode(errors="replace")
    if len(encoded) <= n_bytes:
        return encoded
    ellipsis = b" ..."
    return encoded[: n_bytes - len(ellipsis)].decode(errors="ignore").encode() + ellipsis


def create_text(group: h5py.Group, name: str, text: str, n_bytes: int) -> None:
    """Fixed length, so that a later value overwrites it in place."""
    group.create_dataset(name, data=text, dtype=h5py.string_dtype("utf-8", n_bytes))


def _create_rows(
    file: h5py.File, column: columns.Column, n_rows: int, *, row_shape: tuple[int, ...]
) -> None:
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    rows = file.create_dataset(
        column.path,
        shape=(n_rows, *row_shape),
        dtype=column.dtype,
        dcpl=properties,
        fillvalue=None if np.dtype(column.dtype).kind == "S" else column.fill,
    )
    rows.attrs.update({"units": column.units, **column.attributes})


def _resize(file: h5py.File, path: str, n_rows: int) -> None:
    """Replace a column by a longer or shorter one: one that is contiguous cannot grow."""
    old = dataset_at(file, path)
    if len(old) == n_rows:
        return
    values, attributes, properties = old[:n_rows], dict(old.attrs), old.id.get_create_plist()
    del file[path]
    rows = file.create_dataset(
        path, shape=(n_rows, *values.shape[1:]), dtype=values.dtype, dcpl=properties
    )
    rows.attrs.update(attributes)
    rows[: len(values)] = values
