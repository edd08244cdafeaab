"""Images in segments, and sessions that add to them."""

import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from tronlab.dataset import schema
from tronlab.dataset.journal import read_journal
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import DriftRecord, Provenance, Session, ShotRecord
from tronlab.dataset.segments import Segment, plan_segments
from tronlab.dataset.writer import DatasetWriter
from tronlab.errors import DatasetError, IntegrityError

MakeShot = Callable[..., ShotRecord]
MakeSession = Callable[..., Session]
MakeProvenance = Callable[..., Provenance]
REFLECTORS = ("top_left", "bottom_left", "top_right")


def segment(dataset_path: Path, number: int) -> Path:
    return dataset_path.parent / f"dataset.images/{number:04d}.h5"


def flip_byte(path: Path, where: str, row: int) -> None:
    """Damage the first byte of a row, whatever it means."""
    with h5py.File(path, "r") as file:
        item = file[where]
        place = item.id.get_offset() + row * item.dtype.itemsize * int(np.prod(item.shape[1:]))
    with path.open("r+b") as file:
        file.seek(place)
        byte = file.read(1)
        file.seek(place)
        file.write(bytes([byte[0] ^ 0xFF]))


def test_rows_are_divided_and_what_is_begun_stays() -> None:
    path = Path("out/dataset.h5")
    planned = plan_segments(path, (), n_rows=7, segment_shots=3)
    assert [(s.name, s.first_row, s.n_rows) for s in planned] == [
        ("dataset.images/0001.h5", 0, 3),
        ("dataset.images/0002.h5", 3, 3),
        ("dataset.images/0003.h5", 6, 1),
    ]
    again = plan_segments(path, planned[:2], n_rows=12, segment_shots=4)
    assert again[:2] == planned[:2]
    assert again[2:] == (
        Segment("dataset.images/0003.h5", 6, 4),
        Segment("dataset.images/0004.h5", 10, 2),
    )


def test_everything_of_a_shot_comes_back_from_its_segment(
    segmented_dataset: Path, make_shot: MakeShot, make_session: MakeSession
) -> None:
    with Dataset(segmented_dataset) as dataset:
        assert dataset.can_go_on
        assert (dataset.n_shots, dataset.n_rows) == (5, 5)
        assert dataset.sessions == (make_session(1),)
        for i in range(5):
            given, found = make_shot(i, has_quality=True), dataset.shot(i)
            np.testing.assert_array_equal(found.frame.image, given.frame.image)
            np.testing.assert_array_equal(found.mask, given.mask)
            for name in ("quality", "timing", "n_failures", "session"):
                assert getattr(found, name) == getattr(given, name)
                if name != "session":
                    assert getattr(dataset, name)(i) == getattr(given, name)


def test_a_full_segment_is_not_touched_again(
    segmented_dataset: Path, make_shot: MakeShot, make_session: MakeSession
) -> None:
    before = [segment(segmented_dataset, k).read_bytes() for k in (1, 2)]
    with DatasetWriter.reopen(
        segmented_dataset, make_session(2, "retake"), n_rows=4, segment_shots=2
    ) as writer:
        for i in range(4):
            writer.commit(make_shot(i + 10, shot_id=i), replaces=True)
        writer.finish("complete")
    assert [segment(segmented_dataset, k).read_bytes() for k in (1, 2)] == before


def test_viewers_see_one_stack(segmented_dataset: Path, make_shot: MakeShot) -> None:
    with h5py.File(segmented_dataset) as file:
        plot = file["entry/data"]
        for i in range(5):
            np.testing.assert_array_equal(plot["image"][i], make_shot(i).frame.image)
        assert plot["shot_id"][:].tolist() == [0, 1, 2, 3, 4, -1, -1, -1]
        overview = file["entry/overview"]
        assert overview[overview.attrs["signal"]][:5].tolist() == pytest.approx(
            [4.0, 3.95, 3.9, 3.85, 3.8]
        )
        assert np.isnan(overview[overview.attrs["signal"]][5:]).all()
    with h5py.File(segment(segmented_dataset, 1)) as file:
        plot = file[file.attrs["default"]]
        plot = plot[plot.attrs["default"]]
        assert plot[plot.attrs["signal"]].shape == (2, 48, 64)


def test_a_missing_segment_is_named_and_the_others_can_be_read(segmented_dataset: Path) -> None:
    gone = segment(segmented_dataset, 2)
    gone.unlink()
    with Dataset(segmented_dataset) as dataset:
        with pytest.raises(IntegrityError, match=rf"rows 2 to 3 are in {gone}, which is missing"):
            dataset.image(2)
        dataset.shot(1)
        dataset.shot(4)


def test_a_segment_of_another_dataset_is_not_taken_for_ours(
    segmented_dataset: Path, tmp_path: Path, make_provenance: MakeProvenance, make_shot: MakeShot
) -> None:
    other = tmp_path / "other/dataset.h5"
    other.parent.mkdir()
    with DatasetWriter(other, make_provenance(4), segment_shots=2) as writer:
        writer.commit(make_shot(7))
    shutil.copy(segment(other, 1), segment(segmented_dataset, 1))
    shutil.copy(segment(segmented_dataset, 2), segment(segmented_dataset, 3))
    segment(segmented_dataset, 2).write_bytes(b"\x89HDF\r\n\x1a\n" + b"\xff" * 500)
    with Dataset(segmented_dataset) as dataset:
        with pytest.raises(IntegrityError, match="belongs to another dataset"):
            dataset.image(0)
        with pytest.raises(IntegrityError, match="cannot be opened"):
            dataset.image(2)
        with pytest.raises(IntegrityError, match="is another segment: its first row is 2"):
            dataset.image(4)


def test_images_of_another_dataset_are_never_overwritten(
    segmented_dataset: Path, make_provenance: MakeProvenance, make_shot: MakeShot
) -> None:
    segmented_dataset.unlink()
    before = segment(segmented_dataset, 1).read_bytes()
    message = r"0001\.h5: is there already and does not belong"
    with pytest.raises(DatasetError, match=message):
        DatasetWriter(segmented_dataset, make_provenance(4), segment_shots=2)
    images = segmented_dataset.with_suffix(".images")
    images.rename(images.with_name("elsewhere"))
    with DatasetWriter(segmented_dataset, make_provenance(4), segment_shots=2) as writer:
        images.with_name("elsewhere").rename(images)
        with pytest.raises(DatasetError, match=message):
            writer.commit(make_shot(0))
        writer.finish("failed")
    assert segment(segmented_dataset, 1).read_bytes() == before
    assert not segmented_dataset.exists()
    assert not list(segmented_dataset.parent.glob(".*"))


def test_a_session_goes_on_where_the_last_one_ended(
    segmented_dataset: Path,
    make_shot: MakeShot,
    make_session: MakeSession,
    make_drift: Callable[..., DriftRecord],
) -> None:
    session = make_session(2, "resume")
    with DatasetWriter.reopen(
        segmented_dataset, session, n_rows=9, segment_shots=4, n_shots_planned=12
    ) as writer:
        assert writer.committed_ids == {0, 1, 2, 3, 4}
        writer.plan_drift_checks(REFLECTORS, 2)
        writer.commit_drift(make_drift(0))
        with pytest.raises(DatasetError, match="shot 3 is already committed"):
            writer.commit(make_shot(13, shot_id=3))
        writer.commit(make_shot(13, shot_id=3), replaces=True)
        for i in range(5, 12):
            writer.commit(make_shot(i))
        writer.commit_drift(make_drift(7, is_within=False))
        writer.finish("complete")
    with Dataset(segmented_dataset) as dataset:
        assert dataset.shot_ids.tolist() == [0, 1, 2, 4, 3, *range(5, 12)]
        assert (dataset.n_rows, dataset.superseded_rows) == (13, (3,))
        assert dataset.provenance.n_shots_planned == 12
        assert (dataset.status, dataset.reason) == ("complete", "")
        assert dataset.sessions == (make_session(1), session)
        assert [dataset.session(i) for i in range(12)] == [1] * 4 + [2] * 8
        assert [check.n_shots_before for check in dataset.drift_checks] == [0, 5, 5, 13]
        assert [check.session for check in dataset.drift_checks] == [1, 1, 2, 2]
        assert dataset.truth_states == ("good",) * 4 + ("suspect",) * 8
        for i, shot_id in enumerate(dataset.shot_ids.tolist()):
            drawn = 13 if shot_id == 3 else shot_id
            np.testing.assert_array_equal(dataset.image(i), make_shot(drawn).frame.image)
        np.testing.assert_array_equal(dataset.stored.image(3), make_shot(3).frame.image)
        assert dataset.shots_with_damaged_values() == ()
        assert [(s.first_row, s.n_rows) for s in dataset.segments] == [
            (0, 2),
            (2, 2),
            (4, 2),
            (6, 4),
            (10, 4),
        ]


def test_a_session_without_a_shot_leaves_the_dataset_as_it_was_but_for_its_ending(
    segmented_dataset: Path, make_session: MakeSession
) -> None:
    before = segmented_dataset.read_bytes()
    with DatasetWriter.reopen(segmented_dataset, make_session(2), n_rows=4, segment_shots=2):
        assert segmented_dataset.read_bytes() == before
    assert segmented_dataset.read_bytes() == before
    writer = DatasetWriter.reopen(segmented_dataset, make_session(2), n_rows=4, segment_shots=2)
    writer.finish("complete")
    with Dataset(segmented_dataset) as dataset:
        assert (dataset.n_shots, dataset.status, len(dataset.sessions)) == (5, "complete", 2)


def test_what_a_power_cut_damaged_is_dropped_and_the_journal_says_so(
    segmented_dataset: Path, make_shot: MakeShot, make_session: MakeSession
) -> None:
    """An image, the values of a shot, and a retake whose older row counts again."""
    writer = DatasetWriter.reopen(segmented_dataset, make_session(2), n_rows=4, segment_shots=2)
    writer.commit(make_shot(11, shot_id=1), replaces=True)
    writer.commit(make_shot(5))
    writer.finish("aborted")
    flip_byte(segment(segmented_dataset, 2), schema.SEGMENT_IMAGE, 1)
    flip_byte(segmented_dataset, f"{schema.TRUTH}/range_los_m", 4)
    flip_byte(segmented_dataset, schema.VALUES_CRC32, 5)
    writer = DatasetWriter.reopen(segmented_dataset, make_session(3), n_rows=4, segment_shots=2)
    assert writer.committed_ids == {0, 1, 2, 5}
    dropped = [entry.fields for entry in read_journal(segmented_dataset)]
    assert dropped == [{"shot_id": i, "row": row} for i, row in ((3, 3), (4, 4), (1, 5))]
    for i in (3, 4):
        writer.commit(make_shot(i))
    writer.finish("complete")
    with Dataset(segmented_dataset) as dataset:
        assert dataset.shot_ids.tolist() == [0, 1, 2, 5, 3, 4]
        assert (dataset.void_rows, dataset.superseded_rows) == ((3, 4, 5), ())
        np.testing.assert_array_equal(dataset.image(1), make_shot(1).frame.image)
        for i in range(6):
            dataset.shot(i)
    # What was dropped once is not told again.
    DatasetWriter.reopen(segmented_dataset, make_session(4), n_rows=1, segment_shots=2).finish(
        "complete"
    )
    assert len(read_journal(segmented_dataset)) == 3


def test_a_missing_segment_is_no_reason_to_drop_shots(
    segmented_dataset: Path, make_session: MakeSession
) -> None:
    before = segmented_dataset.read_bytes()
    segment(segmented_dataset, 3).unlink()
    with pytest.raises(IntegrityError, match="is missing; copy it to"):
        DatasetWriter.reopen(segmented_dataset, make_session(2), n_rows=4, segment_shots=2)
    assert segmented_dataset.read_bytes() == before


def test_the_shots_of_a_full_segment_that_is_lost_can_be_taken_again(
    segmented_dataset: Path, make_shot: MakeShot, make_session: MakeSession
) -> None:
    segment(segmented_dataset, 2).unlink()
    session = make_session(2, "retake")
    with DatasetWriter.reopen(segmented_dataset, session, n_rows=2, segment_shots=2) as writer:
        assert writer.committed_ids == {0, 1, 2, 3, 4}
        for i in (2, 3):
            writer.commit(make_shot(i), replaces=True)
        writer.finish("complete")
    with Dataset(segmented_dataset) as dataset:
        assert (dataset.shot_ids.tolist(), dataset.superseded_rows) == ([0, 1, 4, 2, 3], (2, 3))
        for i in range(5):
            dataset.shot(i)
    assert read_journal(segmented_dataset) == ()


def test_only_a_recorded_dataset_of_this_layout_goes_on(
    small_dataset: Path, segmented_dataset: Path, make_session: MakeSession
) -> None:
    with pytest.raises(DatasetError, match=r"nothing can be added: .* has 0 segments"):
        DatasetWriter.reopen(small_dataset, make_session(2), n_rows=1, segment_shots=2)
    with pytest.raises(DatasetError, match="session 4 cannot follow session 1"):
        DatasetWriter.reopen(segmented_dataset, make_session(4), n_rows=1, segment_shots=2)
    with h5py.File(segmented_dataset, "r+") as file:
        file.attrs[schema.SCHEMA_ATTRIBUTE] = "2.7"
    with pytest.raises(DatasetError, match=r"it is of layout 2\.7"):
        DatasetWriter.reopen(segmented_dataset, make_session(2), n_rows=1, segment_shots=2)


def test_other_reflectors_than_before_are_refused(
    segmented_dataset: Path, make_session: MakeSession
) -> None:
    with (
        DatasetWriter.reopen(
            segmented_dataset, make_session(2), n_rows=1, segment_shots=2
        ) as writer,
        pytest.raises(DatasetError, match="reflectors left, those of earlier sessions are top_"),
    ):
        writer.plan_drift_checks(["left"], 2)


def test_a_flag_without_a_name_is_damage(segmented_dataset: Path) -> None:
    with h5py.File(segmented_dataset, "r+") as file:
        file[schema.QUALITY_FLAGS][2] = 1 << 20
    with Dataset(segmented_dataset) as dataset:
        assert dataset.quality(3).flags == ("saturation", "brightness")
        with pytest.raises(IntegrityError, match="shot 2: entry/quality/flags is 1048576, but"):
            dataset.quality(2)
