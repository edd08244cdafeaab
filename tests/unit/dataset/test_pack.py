"""Packing: one file, nothing lost, nothing left of a failure."""

import resource
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from tronlab.dataset import columns, schema
from tronlab.dataset.compression import chunk_options, fill_stack
from tronlab.dataset.journal import Journal, read_journal
from tronlab.dataset.lock import run_lock
from tronlab.dataset.pack import pack
from tronlab.dataset.places import journal_path
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import DriftRecord, Provenance, ReferenceView, ShotRecord
from tronlab.dataset.sessions import only_session
from tronlab.dataset.validate import Examination, examine
from tronlab.dataset.writer import DatasetWriter
from tronlab.errors import DatasetError, IntegrityError

MakeShot = Callable[..., ShotRecord]
REFLECTORS = ("top_left", "bottom_left", "top_right")


@pytest.fixture
def recorded(
    tmp_path: Path,
    make_shot: MakeShot,
    make_provenance: Callable[..., Provenance],
    make_view: Callable[[int], ReferenceView],
    make_drift: Callable[..., DriftRecord],
) -> Path:
    """Five shots in segments of 2; shot 1 was taken again before the last drift check."""
    path, provenance = tmp_path / "dataset.h5", make_provenance(5)
    session = only_session(provenance, start_utc="2026-11-22T12:00:00.000+00:00")
    with DatasetWriter(
        path, provenance, session=session, segment_shots=2, n_spare_rows=3
    ) as writer:
        writer.add_references([make_view(0), make_view(1)])
        writer.plan_drift_checks(REFLECTORS, 3)
        writer.commit_drift(make_drift(0))
        for i in range(3):
            writer.commit(make_shot(i, dtype=np.uint16))
        writer.commit(make_shot(7, shot_id=1, attempt=2, dtype=np.uint16), replaces=True)
        writer.commit_drift(make_drift(4))
        for i in range(3, 5):
            writer.commit(make_shot(i, dtype=np.uint16))
        writer.commit_drift(make_drift(6, is_within=False))
        writer.finish("complete")
    Journal(path).write("note", "lamp: 4° \0 warmer", author="µ")
    with journal_path(path).open("a") as journal:
        journal.write('{"kind": "note", "te\0\0\0')  # a power cut
    return path


def assert_same(ours: ShotRecord, theirs: ShotRecord) -> None:
    for column in columns.COLUMNS:
        np.testing.assert_array_equal(column.value_of(ours), column.value_of(theirs))
    np.testing.assert_array_equal(ours.frame.image, theirs.frame.image)
    assert ours.frame.image.dtype == theirs.frame.image.dtype
    np.testing.assert_array_equal(ours.mask, theirs.mask)


def test_a_packed_dataset_is_the_same_in_one_file(recorded: Path, tmp_path: Path) -> None:
    target = tmp_path / "packed.h5"
    stages: list[str] = []
    packed = pack(recorded, target, on_stage=lambda stage, _, __: stages.append(stage))
    assert str(packed).endswith(f"packed into {packed.n_bytes / 1e6:.1f} MB (1/{packed.ratio:.2f})")
    assert list(dict.fromkeys(stages)) == ["images", "masks", "verified"]
    with Dataset(recorded) as old, Dataset(target) as new:
        assert new.provenance == old.provenance
        assert new.sessions == old.sessions
        assert (new.uuid, new.status) == (old.uuid, "complete")
        assert (new.start_time, new.end_time) == (old.start_time, old.end_time)
        assert new.shot_ids.tolist() == old.shot_ids.tolist() == [0, 2, 1, 3, 4]
        assert (new.n_rows, new.segments, new.superseded_rows) == (5, (), ())
        assert new.truth_states == old.truth_states == ("good",) * 3 + ("suspect",) * 2
        assert [check.n_shots_before for check in new.drift_checks] == [0, 3, 5]
        for i in range(5):
            assert_same(new.shot(i), old.shot(i))
        for ours, theirs in zip(new.references(), old.references(), strict=True):
            np.testing.assert_array_equal(ours.image, theirs.image)
            np.testing.assert_array_equal(ours.depth_m, theirs.depth_m)
    assert read_journal(target) == read_journal(recorded)
    assert [entry.text for entry in read_journal(target)][-1] == "lamp: 4° \0 warmer"
    assert examine(target) == Examination((), examine(recorded).notes[:1])


def test_superseded_rows_may_stay_and_a_packed_dataset_be_packed_again(
    recorded: Path, tmp_path: Path
) -> None:
    target = tmp_path / "packed.h5"
    pack(recorded, target, keeps_all_rows=True)
    with Dataset(recorded) as old, Dataset(target) as new:
        assert (new.n_rows, new.superseded_rows) == (6, (1,))
        assert_same(new.stored.shot(1), old.stored.shot(1))
        assert new.stored.column(schema.SUPERSEDES).tolist() == [-1, -1, -1, 1, -1, -1]
        assert new.truth_states == old.truth_states
    pack(target, tmp_path / "again.h5", level=9)
    with Dataset(tmp_path / "again.h5") as again, Dataset(recorded) as old:
        assert_same(again.shot(2), old.shot(2))
    assert examine(tmp_path / "again.h5").findings == ()
    assert read_journal(tmp_path / "again.h5") == read_journal(recorded)


def test_what_is_damaged_or_recorded_is_refused_and_nothing_is_left(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "packed.h5"
    with run_lock(recorded), pytest.raises(DatasetError, match="is being recorded by process"):
        pack(recorded, target)
    with pytest.raises(DatasetError, match="exists already and is never overwritten"):
        pack(recorded, recorded)

    def interrupt(stage: str, _: int, __: int) -> None:
        if stage == "masks":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pack(recorded, target, on_stage=interrupt)
    with monkeypatch.context() as patch:
        patch.setattr(
            "tronlab.dataset.compression.zlib.compress",
            lambda data, level, squeeze=zlib.compress: squeeze(bytes(len(data)), level),
        )
        with pytest.raises(IntegrityError, match="disk did not keep what was written"):
            pack(recorded, target)
    segment = recorded.parent / "dataset.images" / "0002.h5"
    with h5py.File(segment, "r+") as file:
        file[schema.SEGMENT_IMAGE][0, 3, 3] += 1
    with pytest.raises(IntegrityError, match="shot 2: image is damaged"):
        pack(recorded, target)
    with h5py.File(recorded, "r+") as file:
        file["entry/truth/range_los_m"][1] = 9.0
    with pytest.raises(IntegrityError, match="values of shots 1 are damaged"):
        pack(recorded, target, keeps_all_rows=True)
    assert not list(tmp_path.glob("*packed*"))


def test_a_full_disk_is_an_error_and_no_crash(recorded: Path, tmp_path: Path) -> None:
    target = tmp_path / "packed.h5"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_120_000, hard))
    try:
        with pytest.raises(DatasetError, match=rf"^{target}: cannot be made: .*File too large$"):
            pack(recorded, target)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.glob("*packed*"))


def test_what_a_newer_version_wrote_is_refused(recorded: Path, tmp_path: Path) -> None:
    with h5py.File(recorded, "r+") as file:
        file.attrs[schema.SCHEMA_ATTRIBUTE] = "2.99"
    with pytest.raises(DatasetError, match=r"layout 2\.99, this tronlab knows .* would lose"):
        pack(recorded, tmp_path / "packed.h5")


@settings(max_examples=10, deadline=None)
@given(
    images=arrays.arrays(
        st.sampled_from([np.uint8, np.uint16]),
        st.tuples(st.integers(1, 5), *[st.integers(1, 9)] * 2),
    ),
    level=st.sampled_from([None, 1, 9]),
)
def test_hdf5_reads_what_was_compressed_beside_it(images: np.ndarray, level: int | None) -> None:
    with h5py.File("any", "w", driver="core", backing_store=False) as file:
        stack = file.create_dataset(
            "images", images.shape, images.dtype, **chunk_options(images.shape, level)
        )
        assert list(fill_stack(stack, images))[-1] == len(images)
        np.testing.assert_array_equal(stack[()], images)
