import errno
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Provenance, ReferenceView, ShotRecord
from tronlab.dataset.validate import validate
from tronlab.dataset.writer import DatasetWriter
from tronlab.errors import DatasetError

MakeShot = Callable[..., ShotRecord]
MakeProvenance = Callable[..., Provenance]
MakeView = Callable[[int], ReferenceView]


@pytest.fixture
def writer(tmp_path: Path, make_provenance: MakeProvenance) -> DatasetWriter:
    return DatasetWriter(tmp_path / "new.h5", make_provenance(3))


def committed_ids(path: Path) -> list[int]:
    with Dataset(path) as dataset:
        for i in range(dataset.n_shots):
            dataset.shot(i)
        return dataset.shot_ids.tolist()


def test_an_existing_file_is_never_overwritten(
    small_dataset: Path, make_provenance: MakeProvenance
) -> None:
    before = small_dataset.read_bytes()
    with pytest.raises(DatasetError, match=r"exists already.*choose another --out"):
        DatasetWriter(small_dataset, make_provenance())
    assert small_dataset.read_bytes() == before


def test_a_missing_directory_is_named(tmp_path: Path, make_provenance: MakeProvenance) -> None:
    with pytest.raises(
        DatasetError, match=r"nowhere/a\.h5: the directory .*nowhere does not exist"
    ):
        DatasetWriter(tmp_path / "nowhere" / "a.h5", make_provenance())


def test_a_plan_without_shots_is_refused(tmp_path: Path, make_provenance: MakeProvenance) -> None:
    with pytest.raises(DatasetError, match="0 shots planned"):
        DatasetWriter(tmp_path / "a.h5", make_provenance(0))
    assert not (tmp_path / "a.h5").exists()


def test_a_seed_beyond_64_bit_is_refused(tmp_path: Path, make_provenance: MakeProvenance) -> None:
    with pytest.raises(DatasetError, match="64-bit"):
        DatasetWriter(tmp_path / "a.h5", replace(make_provenance(), seed=2**64))


def test_a_text_hdf5_cannot_store_is_one_clear_error(
    tmp_path: Path, make_provenance: MakeProvenance
) -> None:
    with pytest.raises(DatasetError, match="cannot be set up"):
        DatasetWriter(tmp_path / "a.h5", replace(make_provenance(), rig_yaml="a\0b"))


def test_shots_come_in_any_order_and_ids(writer: DatasetWriter, make_shot: MakeShot) -> None:
    writer.commit(make_shot(0, shot_id=17, attempt=3))
    writer.commit(make_shot(1, shot_id=4))
    assert writer.n_committed == 2
    writer.finish("aborted", "operator")
    assert committed_ids(writer.path) == [17, 4]


def test_nothing_is_written_after_finish(writer: DatasetWriter, make_shot: MakeShot) -> None:
    writer.commit(make_shot(0))
    writer.finish("aborted")
    for act in (
        lambda: writer.commit(make_shot(1)),
        lambda: writer.finish("complete"),
        lambda: writer.add_references([]),
    ):
        with pytest.raises(DatasetError, match="is finished"):
            act()
    assert committed_ids(writer.path) == [0]


def test_an_unknown_status_is_refused(writer: DatasetWriter) -> None:
    with pytest.raises(DatasetError, match="'done' is not one of complete, aborted, failed"):
        writer.finish("done")  # pyright: ignore[reportArgumentType]


SPOILT: list[tuple[Callable[[ShotRecord], Any], str]] = [
    (lambda s: replace(s, shot_id=0), "shot 0 is already committed"),
    (
        lambda s: replace(s, frame=replace(s.frame, image=s.frame.image[:-1])),
        r"image: shape is \(47, 64\), the camera's images have \(48, 64\)",
    ),
    (
        lambda s: replace(s, frame=replace(s.frame, image=s.frame.image.astype(np.uint16))),
        "image: type is uint16, expected uint8",
    ),
    (lambda s: replace(s, mask=s.mask[:, :-1]), r"mask: shape is \(48, 63\)"),
    (lambda s: replace(s, mask=s.mask.astype(np.uint8)), "mask: type is uint8, expected bool"),
    (
        lambda s: replace(s, truth=replace(s.truth, range_los_m=float("nan"))),
        "shot 1: truth/range_los_m: is not finite: nan",
    ),
    (
        lambda s: replace(s, truth=replace(s.truth, covariance=np.full((6, 6), np.inf))),
        "truth/trs_from_cam_covariance: is not finite",
    ),
    (
        lambda s: replace(s, frame=replace(s.frame, device_time_s=float("inf"))),
        "camera/device_time_s: is not finite: inf",
    ),
    (
        lambda s: replace(s, tracker=replace(s.tracker, covariance=np.eye(3))),
        r"trk_from_tmac_covariance: shape is \(3, 3\), expected \(6, 6\)",
    ),
    (
        lambda s: replace(s, frame=replace(s.frame, pixel_format="BayerRG12PackedTight")),
        "pixel_format: .* is longer than 16 bytes",
    ),
    (
        lambda s: replace(s, frame=replace(s.frame, frame_id=2**70)),
        "camera/frame_id: 1180591620717411303424",
    ),
]


def test_a_shot_that_contradicts_the_dataset_is_refused_and_harms_nothing(
    writer: DatasetWriter, make_shot: MakeShot
) -> None:
    writer.commit(make_shot(0))
    for spoil, message in SPOILT:
        with pytest.raises(DatasetError, match=message):
            writer.commit(spoil(make_shot(1)))
    writer.commit(make_shot(2))
    writer.finish("aborted")
    assert committed_ids(writer.path) == [0, 2]


def test_the_first_image_must_be_8_or_16_bit(writer: DatasetWriter, make_shot: MakeShot) -> None:
    shot = make_shot(0)
    image = shot.frame.image.astype(np.float32)
    with pytest.raises(DatasetError, match="type is float32, expected uint8 or uint16"):
        writer.commit(replace(shot, frame=replace(shot.frame, image=image)))  # pyright: ignore


def test_more_shots_than_planned_are_refused(writer: DatasetWriter, make_shot: MakeShot) -> None:
    for i in range(3):
        writer.commit(make_shot(i))
    with pytest.raises(DatasetError, match="shot 3 is one more than the 3 shots planned"):
        writer.commit(make_shot(3))
    writer.finish("complete")
    assert validate(writer.path) == []


def test_a_reference_view_that_does_not_fit_is_refused(
    writer: DatasetWriter, make_view: MakeView
) -> None:
    view = make_view(1)
    for spoilt, message in (
        (replace(view, image=view.image[1:]), "reference view 1: image: shape"),
        (replace(view, depth_m=view.depth_m.astype(float)), "depth_m: type is float64"),  # pyright: ignore
        (replace(view, mask=view.mask.T), "mask: shape"),
    ):
        with pytest.raises(DatasetError, match=message):
            writer.add_references([make_view(0), spoilt])
    writer.add_references([make_view(0)])


def test_reference_views_are_stored_once(writer: DatasetWriter, make_view: MakeView) -> None:
    with pytest.raises(DatasetError, match="no reference views were given"):
        writer.add_references([])
    writer.add_references([make_view(0)])
    with pytest.raises(DatasetError, match="already stored"):
        writer.add_references([make_view(1)])


@pytest.mark.parametrize(
    ("error", "status", "reason"),
    [
        (RuntimeError("beam broken"), "failed", "RuntimeError: beam broken"),
        (KeyboardInterrupt(), "aborted", "KeyboardInterrupt"),
    ],
)
def test_an_exception_in_the_block_is_recorded_and_passed_on(
    tmp_path: Path,
    make_provenance: MakeProvenance,
    make_shot: MakeShot,
    error: BaseException,
    status: str,
    reason: str,
) -> None:
    def record() -> None:
        with DatasetWriter(tmp_path / "a.h5", make_provenance()) as writer:
            writer.commit(make_shot(0))
            raise error

    with pytest.raises(type(error)):
        record()
    with Dataset(tmp_path / "a.h5") as dataset:
        assert (dataset.status, dataset.reason) == (status, reason)
        assert dataset.n_shots == 1


def test_leaving_the_block_without_finish_leaves_it_running(
    tmp_path: Path, make_provenance: MakeProvenance, make_shot: MakeShot
) -> None:
    with DatasetWriter(tmp_path / "a.h5", make_provenance()) as writer:
        writer.commit(make_shot(0))
    with Dataset(tmp_path / "a.h5") as dataset:
        assert (dataset.status, dataset.end_time, dataset.n_shots) == ("running", "", 1)


def test_ctrl_c_at_the_very_end_of_a_commit_leaves_a_consistent_file(
    writer: DatasetWriter, make_shot: MakeShot, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer.commit(make_shot(0))
    write = writer._write

    def write_and_be_interrupted(*arguments: Any) -> None:
        write(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(writer, "_write", write_and_be_interrupted)
    with pytest.raises(KeyboardInterrupt):
        writer.commit(make_shot(1))
    writer.finish("aborted", "operator")
    assert committed_ids(writer.path) == [0, 1]


def test_a_write_error_names_path_and_shot_and_spares_the_shots_before(
    tmp_path: Path,
    make_provenance: MakeProvenance,
    make_shot: MakeShot,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / "a.h5"
    with DatasetWriter(path, make_provenance()) as writer:
        writer.commit(make_shot(0))
        with monkeypatch.context() as patch:
            patch.setattr(writer, "_write", _raise_no_space)
            with pytest.raises(
                DatasetError, match=r"a\.h5: shot 1 could not be written.*the 1 shots"
            ):
                writer.commit(make_shot(1))
        writer.commit(make_shot(1))
        writer.finish("aborted")
    assert committed_ids(path) == [0, 1]


def test_a_disk_too_small_for_the_plan_is_told_at_the_first_shot(
    writer: DatasetWriter, make_shot: MakeShot, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = type("Usage", (), {"free": 1000})
    monkeypatch.setattr("tronlab.dataset.places.shutil.disk_usage", lambda _: usage)
    with pytest.raises(DatasetError, match=r"shot 0 could not be written.*0 MB free; free some"):
        writer.commit(make_shot(0))
    writer.finish("failed", "disk full")
    assert list(writer.path.parent.iterdir()) == []


def test_a_refused_reservation_harms_nothing(
    writer: DatasetWriter, make_view: MakeView, make_shot: MakeShot, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("tronlab.dataset.places.os.ftruncate", _raise_no_space)
        with pytest.raises(DatasetError, match="reference views could not be written"):
            writer.add_references([make_view(0)])
    writer.add_references([make_view(0)])
    writer.commit(make_shot(0))
    writer.finish("aborted")
    assert committed_ids(writer.path) == [0]


def _raise_no_space(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_recording_without_shots_leaves_nothing(
    tmp_path: Path, make_provenance: MakeProvenance, make_view: MakeView
) -> None:
    path = tmp_path / "a.h5"
    for ending in ("failed", "aborted", None):
        with DatasetWriter(path, make_provenance(), segment_shots=2) as writer:
            writer.add_references([make_view(0)])
            if ending:
                writer.finish(ending)
        assert list(tmp_path.iterdir()) == []


def test_the_file_has_its_name_with_the_first_shot(
    writer: DatasetWriter, make_shot: MakeShot
) -> None:
    assert not writer.path.exists()
    writer.commit(make_shot(0))
    assert committed_ids(writer.path) == [0]
    writer.finish("aborted")


def test_structure_is_fixed_once_there_are_shots(
    writer: DatasetWriter, make_shot: MakeShot, make_view: MakeView
) -> None:
    writer.commit(make_shot(0))
    with pytest.raises(DatasetError, match="has shots already; its structure is fixed"):
        writer.add_references([make_view(0)])
    writer.commit(make_shot(1))
    writer.finish("aborted")
    assert committed_ids(writer.path) == [0, 1]


def test_a_long_reason_is_shortened_at_a_whole_character(
    writer: DatasetWriter, make_shot: MakeShot
) -> None:
    writer.commit(make_shot(0))
    writer.finish("failed", "µ" * 5000)
    with Dataset(writer.path) as dataset:
        assert dataset.reason == "µ" * 2046 + " ..."
