import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from tronlab.dataset import columns, schema

PAGE = (Path(__file__).parents[3] / "docs/reference/dataset.md").read_text(encoding="utf-8")


def all_objects(path: Path) -> dict[str, tuple[str, Any]]:
    """Give name -> (group or dataset type, attributes) of everything in a file."""
    found: dict[str, tuple[str, Any]] = {}

    def visit(name: str, item: h5py.Group | h5py.Dataset) -> None:
        kind = "group" if isinstance(item, h5py.Group) else item.dtype.kind
        found[name] = (kind, dict(item.attrs))

    with h5py.File(path) as file:
        file.visititems(visit)
    return found


def test_every_group_has_its_nexus_class(small_dataset: Path) -> None:
    groups = {name: a for name, (kind, a) in all_objects(small_dataset).items() if kind == "group"}
    classes = {name: attributes.get("NX_class") for name, attributes in groups.items()}
    optional = {schema.REFERENCES: "NXcollection", schema.DRIFT: "NXcollection"}
    assert classes == {**schema.GROUPS, **optional}


def test_every_number_has_units(small_dataset: Path) -> None:
    numbers = {
        name: attributes
        for name, (kind, attributes) in all_objects(small_dataset).items()
        if kind in "iuf"
    }
    assert len(numbers) > 30
    assert [name for name, attributes in numbers.items() if "units" not in attributes] == []


def test_the_default_chain_leads_to_the_images(small_dataset: Path) -> None:
    with h5py.File(small_dataset) as file:
        assert file.attrs["NX_class"] == "NXroot"
        plot = file[file.attrs["default"]]
        plot = plot[plot.attrs["default"]]
        assert plot.attrs["NX_class"] == "NXdata"
        signal = plot[plot.attrs["signal"]]
        assert signal.shape == (5, 48, 64)
        axes = list(plot.attrs["axes"])
        assert len(axes) == signal.ndim
        assert plot[axes[0]].shape == signal.shape[:1]


def test_poses_say_their_frames_and_order(small_dataset: Path) -> None:
    with h5py.File(small_dataset) as file:
        poses = {
            "entry/truth/trs_from_cam": ("trs", "cam"),
            "entry/shots/trs_from_cam_nominal": ("trs", "cam"),
            "entry/instrument/tracker/trk_from_tmac": ("trk", "tmac"),
            "entry/instrument/robot/base_from_flange": ("base", "flange"),
            "entry/references/trs_from_cam": ("trs", "cam"),
        }
        for path, frames in poses.items():
            attributes = file[path].attrs
            assert (attributes["parent"], attributes["child"]) == frames
            assert attributes["quaternion_order"] == "x y z w"
            assert list(attributes["units"]) == ["m", "m", "m", "1", "1", "1", "1"]
        assert file["entry/truth/trs_from_cam_covariance"].attrs["parent"] == "trs"


def test_the_file_is_of_the_oldest_format_that_reopens_after_a_kill(small_dataset: Path) -> None:
    with h5py.File(small_dataset) as file:
        assert file.libver[0] == "earliest"
        assert file.id.get_create_plist().get_version()[0] == 0


def test_the_checksum_depends_on_every_value_and_their_order() -> None:
    a, b = np.arange(3.0), np.arange(4, dtype=np.int64)
    values = {columns.checksum(v) for v in ([a, b], [b, a], [a], [a, b + 1], [a + 1e-16, b])}
    assert len(values) == 5
    assert columns.checksum([a, b]) == columns.checksum([a.copy(), b.copy()])


def test_the_page_has_every_path_with_its_class_and_no_other(small_dataset: Path) -> None:
    written = set(re.findall(r"^\| `(entry[^`]*)`", PAGE, flags=re.MULTILINE))
    of_rows = {column.path for column in (*columns.ROW_COLUMNS, *columns.DRIFT_COLUMNS)}
    checksums = {schema.REFERENCES_CRC32, schema.DRIFT_CRC32}
    others = {schema.IMAGE, schema.MASK, schema.N_COMMITTED, schema.N_DRIFT_CHECKS} | checksums
    others |= {schema.UUID, schema.JOURNAL}
    groups = {**schema.GROUPS, **schema.OPTIONAL_GROUPS}
    assert written == of_rows | others | set(groups)
    for path, nx_class in groups.items():
        assert f"`{path}` ({nx_class})" in PAGE


def test_the_page_names_the_version_of_the_layout() -> None:
    assert f"this page describes {'.'.join(map(str, schema.SCHEMA_VERSION))}." in PAGE


def test_the_example_on_the_page_runs(small_dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    assert len(example.strip().splitlines()) <= 14
    monkeypatch.chdir(small_dataset.parent)
    names: dict[str, Any] = {}
    exec(example, names)  # noqa: S102
    assert names["shot_ids"].tolist() == [0, 1, 2, 3, 4]
    assert names["image"].shape == names["mask"].shape == (48, 64)
    np.testing.assert_allclose(names["trs_from_cam"].translation, [1.1, 2.1, 4.0], atol=1e-12)
