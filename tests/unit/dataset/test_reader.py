import fcntl
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.dataset import columns, schema
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Provenance, ReferenceView, ShotRecord
from tronlab.dataset.validate import validate
from tronlab.dataset.writer import DatasetWriter
from tronlab.devices.readings import AirReading
from tronlab.errors import DatasetError, IntegrityError, SchemaVersionError

MakeShot = Callable[..., ShotRecord]
MakeProvenance = Callable[..., Provenance]


def assert_same(a: Any, b: Any, where: str = "") -> None:
    """Compare records field by field: exactly, but poses to rounding."""
    assert type(a) is type(b), where
    if isinstance(a, RigidTransform):
        np.testing.assert_allclose(a.as_matrix(), b.as_matrix(), rtol=0, atol=1e-14, err_msg=where)
    elif is_dataclass(a):
        for field in fields(a):
            name = field.name
            assert_same(getattr(a, name), getattr(b, name), f"{where}.{name}")
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype, where
        np.testing.assert_array_equal(a, b, err_msg=where)
    else:
        assert a == b, where


def write(path: Path, provenance: Provenance, shots: list[ShotRecord]) -> None:
    with DatasetWriter(path, provenance) as writer:
        for shot in shots:
            writer.commit(shot)
        writer.finish("complete")


def set_attribute(path: Path, where: str, name: str, value: Any) -> None:
    with h5py.File(path, "r+") as file:
        file[where].attrs[name] = value


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_everything_of_a_shot_comes_back(
    tmp_path: Path, make_shot: MakeShot, make_provenance: MakeProvenance, dtype: type
) -> None:
    shots = [make_shot(i, shot_id=10 - i, attempt=i + 1, dtype=dtype) for i in range(3)]
    write(tmp_path / "a.h5", make_provenance(3), shots)
    with Dataset(tmp_path / "a.h5") as dataset:
        assert dataset.n_shots == 3
        assert dataset.shot_ids.dtype == np.int64
        assert dataset.image_dtype == dtype
        for i, shot in enumerate(shots):
            assert_same(dataset.shot(i), shot)
            assert_same(dataset.truth(i), shot.truth)
            assert_same(dataset.mask(i), shot.mask)


def test_provenance_and_reference_views_come_back(
    small_dataset: Path, make_provenance: MakeProvenance, make_view: Callable[[int], ReferenceView]
) -> None:
    with Dataset(small_dataset) as dataset:
        assert dataset.provenance == make_provenance(5)
        assert dataset.camera == make_provenance(5).camera
        assert dataset.status == "complete"
        assert dataset.reason == ""
        assert dataset.start_time <= dataset.end_time
        assert dataset.n_references == 2
        for i, view in enumerate(dataset.references()):
            assert_same(view, make_view(i))


texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=40)
names = st.text(
    st.characters(exclude_characters="\0", exclude_categories=["Cs"]), min_size=1, max_size=20
)
reusing_tmp_path = settings(
    max_examples=4, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@reusing_tmp_path
@given(
    campaign_name=texts,
    campaign_yaml=texts,
    calibration_json=texts,
    seed=st.integers(-(2**63), 2**63 - 1),
    software=st.dictionaries(names, texts, max_size=5),
    devices=st.dictionaries(names, texts, max_size=5),
)
def test_any_provenance_comes_back(
    tmp_path: Path, make_shot: MakeShot, make_provenance: MakeProvenance, **changes: Any
) -> None:
    path = tmp_path / "a.h5"
    path.unlink(missing_ok=True)
    provenance = replace(make_provenance(1), **changes)
    with DatasetWriter(path, provenance) as writer:
        writer.commit(make_shot(0))
    with Dataset(path) as dataset:
        assert dataset.provenance == provenance


coordinates = st.floats(-1e4, 1e4)
quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 1e-3)


@reusing_tmp_path
@given(xyz=st.tuples(coordinates, coordinates, coordinates), quat_xyzw=quaternions)
def test_any_pose_comes_back(
    tmp_path: Path,
    make_shot: MakeShot,
    make_provenance: MakeProvenance,
    xyz: tuple[float, ...],
    quat_xyzw: tuple[float, ...],
) -> None:
    path = tmp_path / "a.h5"
    path.unlink(missing_ok=True)
    pose = RigidTransform.from_components(xyz, Rotation.from_quat(quat_xyzw))
    write(path, make_provenance(1), [make_shot(0, trs_from_cam=pose)])
    with Dataset(path) as dataset:
        back = dataset.truth(0).trs_from_cam
        np.testing.assert_array_equal(back.translation, pose.translation)
        assert (back.rotation.inv() * pose.rotation).magnitude() < 1e-15 * 10


@pytest.mark.parametrize("i", [-1, 5, 1000])
def test_an_index_out_of_range_is_refused(small_dataset: Path, i: int) -> None:
    with Dataset(small_dataset) as dataset:
        for read in (dataset.image, dataset.mask, dataset.truth, dataset.shot):
            with pytest.raises(DatasetError, match=f"no shot with index {i}; allowed: 0 to 4"):
                read(i)


def test_a_dataset_without_shots_can_be_read(empty_dataset: Path) -> None:
    with Dataset(empty_dataset) as dataset:
        assert dataset.n_shots == 0
        assert dataset.references() == ()
        with pytest.raises(DatasetError, match="none, it holds no shots"):
            dataset.image(0)


def test_rows_beyond_the_counter_do_not_exist(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        file[schema.N_COMMITTED][()] = 3
    with Dataset(small_dataset) as dataset:
        assert dataset.shot_ids.tolist() == [0, 1, 2]
        with pytest.raises(DatasetError, match="allowed: 0 to 2"):
            dataset.image(3)


def test_a_counter_beyond_the_rows_is_damage(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        file[schema.N_COMMITTED][()] = 6
    with pytest.raises(IntegrityError, match=r"6 shots are counted as committed.*room for 5"):
        Dataset(small_dataset)


def test_a_closed_dataset_says_so(small_dataset: Path) -> None:
    dataset = Dataset(small_dataset)
    dataset.close()
    dataset.close()
    with pytest.raises(DatasetError, match="is closed"):
        dataset.image(0)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"a\.h5: no such file"):
        Dataset(tmp_path / "a.h5")


def test_a_directory(small_dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"is a directory.*did you mean .*dataset\.h5\?"):
        Dataset(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match=r"is a directory.*name the \.h5 file"):
        Dataset(tmp_path / "empty")


@pytest.mark.parametrize(
    ("content", "kind", "message"),
    [
        (b"", IntegrityError, "is empty"),
        (b"shot_id,x,y\n1,2,3\n" * 100, DatasetError, "is not an HDF5 file"),
        (b"\x89HDF\r\n\x1a\n" + b"\xff" * 500, IntegrityError, "is damaged and cannot be opened"),
    ],
)
def test_not_a_dataset(
    tmp_path: Path, content: bytes, kind: type[DatasetError], message: str
) -> None:
    path = tmp_path / "a.h5"
    path.write_bytes(content)
    with pytest.raises(kind, match=message):
        Dataset(path)


def test_another_hdf5_file(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = 1
    with pytest.raises(DatasetError, match="is an HDF5 file but not a tronlab dataset"):
        Dataset(tmp_path / "a.h5")


@pytest.mark.parametrize("part", [0.05, 0.5, 0.99])
def test_a_truncated_file(small_dataset: Path, part: float) -> None:
    content = small_dataset.read_bytes()
    small_dataset.write_bytes(content[: int(part * len(content))])
    with pytest.raises(IntegrityError, match=r"is truncated: it has \d+ bytes.*copy it again"):
        Dataset(small_dataset)


@pytest.mark.parametrize(
    ("version", "advice"), [("3.0", "install a newer tronlab"), ("0.9", "use an older tronlab")]
)
def test_another_layout(small_dataset: Path, version: str, advice: str) -> None:
    set_attribute(small_dataset, "/", schema.SCHEMA_ATTRIBUTE, version)
    message = rf"written in dataset layout {version}; .* reads layouts 1\.x to 2\.x; {advice}"
    with pytest.raises(SchemaVersionError, match=message):
        Dataset(small_dataset)


def test_a_newer_minor_layout_is_read(small_dataset: Path) -> None:
    set_attribute(small_dataset, "/", schema.SCHEMA_ATTRIBUTE, "2.99")
    with Dataset(small_dataset) as dataset:
        assert dataset.schema_version == "2.99"
        assert dataset.n_shots == 5


def test_a_layout_that_is_no_version(small_dataset: Path) -> None:
    set_attribute(small_dataset, "/", schema.SCHEMA_ATTRIBUTE, "new")
    with pytest.raises(IntegrityError, match=r"'new', expected major\.minor"):
        Dataset(small_dataset)


def test_a_file_being_written(
    tmp_path: Path, make_provenance: MakeProvenance, make_shot: MakeShot
) -> None:
    path = tmp_path / "a.h5"
    with DatasetWriter(path, make_provenance()) as writer:
        writer.commit(make_shot(0))
        with Dataset(path) as dataset:
            writer.commit(make_shot(1))
            assert (dataset.n_shots, dataset.status) == (1, "running")
        with path.open("rb") as other, pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    with path.open("rb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(DatasetError, match="is being written by another process; try again"):
            Dataset(path)
    with Dataset(path) as dataset:
        assert dataset.n_shots == 2


@pytest.mark.parametrize(
    "path", ["entry/recording/status", "entry/campaign/data", "entry/shots/shot_id"]
)
def test_a_missing_part_is_named(small_dataset: Path, path: str) -> None:
    with h5py.File(small_dataset, "r+") as file:
        del file[path]
    with pytest.raises(IntegrityError, match=f"{path} is missing"), Dataset(small_dataset) as data:
        assert data.status


def test_an_image_whose_bytes_changed_is_not_handed_out(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        file[schema.IMAGE][2, 10, 10] ^= 1
        file[schema.MASK][3, 10, 10] ^= 1
    with Dataset(small_dataset) as dataset:
        with pytest.raises(IntegrityError, match="shot 2: image is damaged: its checksum"):
            dataset.image(2)
        with pytest.raises(IntegrityError, match="shot 3: mask is damaged"):
            dataset.shot(3)
        dataset.shot(4)


@pytest.mark.parametrize("name", schema.REFERENCE_VALUES)
def test_a_reference_view_whose_bytes_changed_is_not_handed_out(
    small_dataset: Path, name: str
) -> None:
    with h5py.File(small_dataset, "r+") as file:
        column = file[f"{schema.REFERENCES}/{name}"]
        column[1] = column[1] * 5
        damaged_id = file[f"{schema.REFERENCES}/view_id"][1]
    with Dataset(small_dataset) as dataset:
        with pytest.raises(IntegrityError, match=rf"reference view {damaged_id} is damaged: its"):
            dataset.references()
        dataset.reference(0)


def test_reference_views_without_checksums_are_not_handed_out(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        del file[schema.REFERENCES_CRC32]
    with (
        Dataset(small_dataset) as dataset,
        pytest.raises(IntegrityError, match=r"entry/references/crc32 is missing"),
    ):
        dataset.references()


@pytest.mark.parametrize("i", [-1, 2])
def test_a_reference_view_out_of_range_is_refused(small_dataset: Path, i: int) -> None:
    with (
        Dataset(small_dataset) as dataset,
        pytest.raises(DatasetError, match=f"no reference view with index {i}; there are 2"),
    ):
        dataset.reference(i)


def test_a_pixel_format_that_is_no_text_is_damage(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        file[f"{schema.CAMERA}/pixel_format"][2] = b"M\xff\xfe8"
    with Dataset(small_dataset) as dataset:
        dataset.shot(1)
        with pytest.raises(
            IntegrityError, match=r"shot 2: pixel_format is damaged: .* is not text"
        ):
            dataset.shot(2)


def test_a_status_that_is_no_text_is_damage(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        file["entry/recording/status"][()] = b"\xff\xfe"
    with (
        Dataset(small_dataset) as dataset,
        pytest.raises(IntegrityError, match=r"entry/recording/status is damaged: .* is not text"),
    ):
        assert dataset.status


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("fx_px", "wide", "fx_px is 'wide', not a number"),
        ("fx_px", "48.0", "fx_px is '48.0', not a number"),
        ("distortion", "12345", "distortion is '12345', not a number"),
        ("distortion", [0.1] * 9, "camera model: "),
        ("width_px", np.inf, "cannot convert float infinity"),
    ],
)
def test_a_spoilt_camera_model_is_damage(
    small_dataset: Path, name: str, value: Any, message: str
) -> None:
    set_attribute(small_dataset, f"{schema.CAMERA}/model", name, value)
    with pytest.raises(IntegrityError, match=f"{schema.CAMERA}/model: {message}"):
        Dataset(small_dataset)


def test_five_distortion_coefficients_of_earlier_files_are_read(small_dataset: Path) -> None:
    set_attribute(small_dataset, f"{schema.CAMERA}/model", "distortion", [0.1, 0.2, 0.3, 0.4, 0.5])
    with Dataset(small_dataset) as dataset:
        assert dataset.camera.distortion == (0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, 0.0)


def test_a_spoilt_quaternion_is_not_handed_out(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        file["entry/truth/trs_from_cam"][1, 6] = 2.0
    with Dataset(small_dataset) as dataset:
        message = r"entry/truth/trs_from_cam\[1\]: pose: the quaternion's norm"
        with pytest.raises(IntegrityError, match=message):
            dataset.truth(1)


@pytest.mark.parametrize("start", range(0, 4000, 500))
def test_scrambled_metadata_is_a_clear_error_or_no_harm(small_dataset: Path, start: int) -> None:
    content = bytearray(small_dataset.read_bytes())
    for offset in range(start, start + 500, 7):
        content[offset] ^= 0xA5
    small_dataset.write_bytes(content)
    # Whatever else than a DatasetError comes out fails the test.
    with suppress(DatasetError), Dataset(small_dataset) as dataset:
        for i in range(dataset.n_shots):
            dataset.shot(i)
        dataset.references()
    assert small_dataset.read_bytes() == content


def test_optional_values_come_back_or_are_none(
    tmp_path: Path, make_shot: Callable[..., ShotRecord], make_provenance: Callable[..., Provenance]
) -> None:
    air = AirReading(temperature_k=294.0, pressure_pa=95_100.0, relative_humidity=0.3)
    bare = make_shot(0)
    full = replace(
        make_shot(1),
        tracker=replace(make_shot(1).tracker, air=air),
        frame=replace(make_shot(1).frame, device_time_s=12.5),
    )
    path = tmp_path / "d.h5"
    with DatasetWriter(path, make_provenance(2)) as writer:
        writer.commit(bare)
        writer.commit(full)
        writer.finish("complete")
    assert validate(path) == []
    with Dataset(path) as dataset:
        assert (dataset.shot(0).tracker.air, dataset.shot(0).frame.device_time_s) == (None, None)
        assert (dataset.shot(1).tracker.air, dataset.shot(1).frame.device_time_s) == (air, 12.5)


def checksum_in_order(file: h5py.File, order: list[str]) -> None:
    """Let the checksums of the five shots cover these columns."""
    crc32 = file[schema.VALUES_CRC32]
    crc32.attrs["order"] = order
    for i in range(5):
        crc32[i] = columns.checksum(file[path][i : i + 1] for path in order)


def test_a_file_of_a_newer_minor_layout_is_read_and_valid(small_dataset: Path) -> None:
    """It has more columns than this version knows, and its checksums cover them."""
    more = "entry/instrument/room/dust_kg_per_m3"
    with h5py.File(small_dataset, "r+") as file:
        file.attrs[schema.SCHEMA_ATTRIBUTE] = f"{schema.SCHEMA_VERSION[0]}.99"
        file[more] = np.arange(5.0)
        order = [more, *file[schema.VALUES_CRC32].attrs["order"]]
        checksum_in_order(file, order)
    assert validate(small_dataset) == []
    with Dataset(small_dataset) as dataset:
        assert dataset.shot(4).shot_id == 4


def test_checksums_without_their_order_are_a_finding(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        del file[schema.VALUES_CRC32].attrs["order"]
    assert validate(small_dataset) == ["entry/shots/values_crc32 does not say its order"]


def test_a_file_of_layout_1_0_is_read_and_valid(small_dataset: Path) -> None:
    """Layout 1.0 has no optional columns, and its checksums do not cover them."""
    with h5py.File(small_dataset, "r+") as file:
        file.attrs[schema.SCHEMA_ATTRIBUTE] = "1.0"
        kept = [column.path for column in columns.COLUMNS if not column.is_optional]
        for column in columns.COLUMNS:
            if column.is_optional:
                del file[column.path]
        checksum_in_order(file, kept)
    assert validate(small_dataset) == []
    with Dataset(small_dataset) as dataset:
        assert dataset.shot(0).tracker.air is None
        assert dataset.shot(0).frame.device_time_s is None
