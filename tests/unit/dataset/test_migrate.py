"""Migration of what tronlab wrote before layout 2."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from tronlab.dataset import columns, schema
from tronlab.dataset.migrate import migrate
from tronlab.dataset.reader import Dataset
from tronlab.dataset.validate import Examination, examine
from tronlab.errors import DatasetError, IntegrityError

NEW_GROUPS = ("entry/sessions", "entry/quality", "entry/timing", "entry/overview")
NEW_COLUMNS = (schema.SESSION, schema.N_FAILURES, schema.SUPERSEDES)


def as_of_layout_1(path: Path, *, minor: int) -> Path:
    """Take away what layout 1 did not have; its checksums took the columns in their order then."""
    with h5py.File(path, "r+") as file:
        del file[schema.UUID], file[schema.DRIFT_SESSION]
        for name in (*NEW_GROUPS, *NEW_COLUMNS):
            if name in file:
                del file[name]
        if minor < 2:
            del file[schema.DRIFT]
        else:
            names = [c.path for c in columns.DRIFT_COLUMNS if c.path in file]
            sign(file, schema.DRIFT_CRC32, names)
        sign(file, schema.VALUES_CRC32, [c.path for c in columns.COLUMNS if c.path in file])
        file.attrs[schema.SCHEMA_ATTRIBUTE] = f"1.{minor}"
    return path


def sign(file: h5py.File, crc32: str, paths: list[str]) -> None:
    rows = [file[path][()] for path in paths]
    file[crc32][...] = [
        columns.checksum(row[i : i + 1] for row in rows) for i in range(len(file[crc32]))
    ]
    file[crc32].attrs["order"] = paths


@pytest.mark.parametrize("minor", [0, 2])
def test_an_older_dataset_is_the_same_in_the_layout_of_today(
    small_dataset: Path, tmp_path: Path, minor: int
) -> None:
    old_path, new_path = as_of_layout_1(small_dataset, minor=minor), tmp_path / "new.h5"
    before = old_path.read_bytes()
    migrate(old_path, new_path)
    assert old_path.read_bytes() == before
    assert examine(old_path) == examine(new_path) == Examination((), ())
    with Dataset(old_path) as old, Dataset(new_path) as new:
        assert (old.schema_version, new.schema_version) == (f"1.{minor}", schema.VERSION_TEXT)
        assert new.provenance == old.provenance
        assert new.sessions == old.sessions
        assert new.truth_states == old.truth_states
        assert new.uuid
        assert new.n_references == 2
        for i in range(5):
            ours, theirs = new.shot(i), old.shot(i)
            for column in columns.COLUMNS:
                np.testing.assert_array_equal(column.value_of(ours), column.value_of(theirs))
            np.testing.assert_array_equal(ours.frame.image, theirs.frame.image)
            np.testing.assert_array_equal(ours.mask, theirs.mask)
            assert (ours.quality, ours.timing, ours.session) == (None, None, 1)


def test_a_dataset_of_today_has_nothing_to_migrate(small_dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"is of layout 2\.0 already: nothing to migrate"):
        migrate(small_dataset, tmp_path / "new.h5")


def test_damage_is_not_hidden_by_new_checksums(small_dataset: Path, tmp_path: Path) -> None:
    path = as_of_layout_1(small_dataset, minor=2)
    damages = {
        "entry/drift/max_shift_m": "drift check 1 is damaged",
        schema.MASK: "shot 0: mask is damaged",
        "entry/references/depth_m": "reference view 0 is damaged",
        "entry/truth/range_los_m": "values of shots 0 are damaged",
    }
    for where, message in damages.items():
        with h5py.File(path, "r+") as file:
            kept = file[where][0]
            file[where][0] = 0.5 * kept
        with pytest.raises(IntegrityError, match=message):
            migrate(path, tmp_path / "new.h5")
        with h5py.File(path, "r+") as file:
            file[where][0] = kept
    assert not list(tmp_path.glob("*new*"))


def test_an_empty_dataset_stays_empty(small_dataset: Path, tmp_path: Path) -> None:
    path = as_of_layout_1(small_dataset, minor=1)
    with h5py.File(path, "r+") as file:
        file[schema.N_COMMITTED][()] = 0
        file["entry/recording/status"][()] = b"running"
    migrate(path, tmp_path / "new.h5")
    with Dataset(tmp_path / "new.h5") as new:
        assert (new.n_shots, new.status) == (0, "running")
