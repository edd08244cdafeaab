import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from tronlab.dataset import schema
from tronlab.dataset.drift import doubts, truth_states
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import DriftRecord, Provenance, ShotRecord
from tronlab.dataset.validate import validate
from tronlab.dataset.writer import DatasetWriter
from tronlab.errors import DatasetError, IntegrityError

MakeDrift = Callable[..., DriftRecord]
REFLECTORS = ("top_left", "bottom_left", "top_right")
G, S, U = "good", "suspect", "unchecked"


@pytest.fixture
def writer(tmp_path: Path, make_provenance: Callable[..., Provenance]) -> DatasetWriter:
    writer = DatasetWriter(tmp_path / "a.h5", make_provenance(4))
    writer.plan_drift_checks(REFLECTORS, 3)
    return writer


@pytest.mark.parametrize(
    ("checks", "expected"),
    [
        ([], [U, U, U, U]),
        ([(0, True)], [U, U, U, U]),
        ([(0, True), (4, True)], [G, G, G, G]),
        ([(0, True), (2, True)], [G, G, U, U]),
        ([(0, True), (2, False)], [S, S, S, S]),
        ([(0, True), (2, True), (4, False)], [G, G, S, S]),
        ([(0, True), (1, False), (3, True), (4, True)], [S, S, S, G]),
        ([(0, False), (2, True), (4, True)], [S, S, G, G]),
        ([(2, True), (4, True)], [U, U, G, G]),
    ],
)
def test_a_shot_is_as_good_as_the_checks_beside_it(
    make_drift: MakeDrift, checks: Sequence[tuple[int, bool]], expected: list[str]
) -> None:
    records = [make_drift(n, is_within=is_within) for n, is_within in checks]
    assert list(truth_states(range(4), [1] * 4, records, {1: "record"})) == expected


def test_doubts_name_their_shots_as_spans() -> None:
    ids = [1, 3, 7, 8, 20, 2]  # shot 2 was taken again
    assert doubts(ids, [G] * 6) == ()
    suspect, unchecked = doubts(ids, [S, S, G, S, U, S])
    assert suspect.startswith("truth of shots 1-3, 8 is suspect: ")
    assert unchecked.startswith("truth of shots 20 is unchecked: ")


def test_checks_come_back_as_they_were(
    writer: DatasetWriter, make_drift: MakeDrift, make_shot: Callable[..., ShotRecord]
) -> None:
    given = [make_drift(0), make_drift(1, is_within=False)]
    writer.commit_drift(given[0])
    writer.commit(make_shot(0))
    writer.commit_drift(given[1])
    writer.finish("aborted")
    with Dataset(writer.path) as dataset:
        found = dataset.drift_checks
    for ours, theirs in zip(given, found, strict=True):
        assert list(ours.readings) == list(theirs.readings)
        for name, reading in ours.readings.items():
            np.testing.assert_array_equal(reading.p_trk_m, theirs.readings[name].p_trk_m)
            np.testing.assert_array_equal(
                reading.covariance_m2, theirs.readings[name].covariance_m2
            )
            assert reading.time_s == theirs.readings[name].time_s
        np.testing.assert_array_equal(ours.shift, theirs.shift)
        plain = ("n_shots_before", "time_s", "max_shift_m", "limit_m", "is_within")
        assert [getattr(ours, name) for name in plain] == [getattr(theirs, name) for name in plain]


def test_checks_do_not_disturb_the_shots_between_them(
    writer: DatasetWriter, make_drift: MakeDrift, make_shot: Callable[..., ShotRecord]
) -> None:
    writer.commit_drift(make_drift(0))
    for i in range(4):
        writer.commit(make_shot(i))
        if i == 1:
            writer.commit_drift(make_drift(2))
    writer.commit_drift(make_drift(4, is_within=False))
    writer.finish("complete")
    with Dataset(writer.path) as dataset:
        assert dataset.truth_states == (G, G, S, S)


def test_a_killed_run_keeps_its_checks_and_its_last_shots_are_unchecked(
    writer: DatasetWriter, make_drift: MakeDrift, make_shot: Callable[..., ShotRecord]
) -> None:
    writer.commit_drift(make_drift(0))
    writer.commit(make_shot(0))
    writer.commit_drift(make_drift(1))
    writer.commit(make_shot(1))
    # What a kill leaves is what the operating system was given so far.
    killed = writer.path.with_name("killed.h5")
    killed.write_bytes(writer.path.read_bytes())
    writer.finish("aborted")
    with Dataset(killed) as dataset:
        assert dataset.status == "running"
        assert [check.n_shots_before for check in dataset.drift_checks] == [0, 1]
        assert dataset.truth_states == (G, U)


def test_a_check_cut_short_is_not_counted(
    writer: DatasetWriter,
    make_drift: MakeDrift,
    make_shot: Callable[..., ShotRecord],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    writer.commit_drift(make_drift(0))
    writer.commit(make_shot(0))
    with monkeypatch.context() as patch:
        patch.setattr(writer._master, "write", interrupt)
        with pytest.raises(KeyboardInterrupt):
            writer.commit_drift(make_drift(2))
    writer.finish("aborted")
    with Dataset(writer.path) as dataset:
        assert [check.n_shots_before for check in dataset.drift_checks] == [0]


def test_what_was_not_planned_is_refused(writer: DatasetWriter, make_drift: MakeDrift) -> None:
    with pytest.raises(DatasetError, match="already planned"):
        writer.plan_drift_checks(REFLECTORS, 3)
    check = make_drift(0)
    others = {name: reading for name, reading in check.readings.items() if name != "top_left"}
    with pytest.raises(DatasetError, match=r"of reflectors bottom_left, top_right, expected top_"):
        writer.commit_drift(replace(check, readings=others))
    with pytest.raises(DatasetError, match=r"after 0 shots: drift/max_shift_m: is not finite"):
        writer.commit_drift(replace(check, max_shift_m=float("nan")))
    for n in range(3):
        writer.commit_drift(make_drift(n))
    with pytest.raises(DatasetError, match="one more than the 3 drift checks planned"):
        writer.commit_drift(make_drift(3))


def test_a_plan_of_nothing_is_refused(
    tmp_path: Path, make_provenance: Callable[..., Provenance]
) -> None:
    with (
        DatasetWriter(tmp_path / "b.h5", make_provenance(4)) as writer,
        pytest.raises(DatasetError, match="0 drift checks of 3 reflectors"),
    ):
        writer.plan_drift_checks(REFLECTORS, 0)


def test_a_changed_verdict_is_found(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        file["entry/drift/max_shift_m"][1] = 1e-9
    with Dataset(small_dataset) as dataset, pytest.raises(IntegrityError, match="drift check 2 is"):
        _ = dataset.drift_checks
    assert any("drift check 2 is damaged" in finding for finding in validate(small_dataset))


def test_a_check_after_more_shots_than_there_are_is_found(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        file[schema.N_COMMITTED][()] = 4
    assert "drift: the checks were after 0, 5 shots, which cannot be" in validate(small_dataset)


def test_older_files_have_no_checks_and_are_valid(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        del file[schema.DRIFT]
        file.attrs[schema.SCHEMA_ATTRIBUTE] = "1.1"
    assert validate(small_dataset) == []
    with Dataset(small_dataset) as dataset:
        assert dataset.drift_checks == ()
        assert set(dataset.truth_states) == {U}


def test_what_was_accepted_is_in_the_provenance(
    tmp_path: Path,
    make_shot: Callable[..., ShotRecord],
    make_provenance: Callable[..., Provenance],
) -> None:
    accepted = ("record.json: expired", "other camera")
    provenance = replace(make_provenance(), accepted=accepted)
    with DatasetWriter(tmp_path / "c.h5", provenance) as writer:
        writer.commit(make_shot(0))
    with Dataset(tmp_path / "c.h5") as dataset:
        assert dataset.provenance.accepted == accepted
        assert json.loads(dataset.provenance.calibration_json)


def test_checks_against_one_record_say_nothing_of_shots_of_another(make_drift: MakeDrift) -> None:
    checks = [replace(make_drift(n), session=k) for n, k in ((0, 1), (2, 2), (4, 2))]
    same, other = {1: "a", 2: "a"}, {1: "a", 2: "b"}
    assert truth_states(range(4), [1, 1, 2, 2], checks, same) == (G, G, G, G)
    assert truth_states(range(4), [1, 1, 2, 2], checks, other) == (U, U, G, G)
