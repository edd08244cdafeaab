"""Databases as files: what is written is read, and whatever is wrong with one is told."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import (
    DatasetError,
    IntegrityError,
    SchemaVersionError,
    ScoreError,
    TronlabError,
)
from tronlab.nav.database import LANDMARK_ARRAYS, Database, Landmarks, find_landmarks
from tronlab.nav.database import landmarks_of_view as landmarks_of
from tronlab.nav.database_file import (
    Counts,
    Pruning,
    Source,
    open_database,
    read_database_file,
    verify_database,
)
from tronlab.nav.database_writer import new_database, save_selection
from tronlab.nav.features import make_detector
from tronlab.nav.settings import DetectorSettings

AKAZE = DetectorSettings(n_max=300)
SOURCE = Source(kind="dataset", name="a.h5", identity="id a", camera={}, rig="twin")
N_VIEWS, N_OF_VIEW = 4, 40


def random_landmarks(i: int, n: int = N_OF_VIEW) -> Landmarks:
    rng = np.random.default_rng([5, i])
    return Landmarks(
        rng.normal(size=(n, 3)), rng.random(n) + 0.01, rng.integers(0, 256, (n, 61), np.uint8)
    )


def pose_of_view(i: int) -> RigidTransform:
    return RigidTransform.from_components([0.1 * i, 0, 3], Rotation.from_rotvec([3, 0.1 * i, 0]))


def write_random(path: Path) -> Path:
    """View 2 has no landmark."""
    with new_database(path, AKAZE) as writer:
        writer.sources.append(SOURCE)
        for i in range(N_VIEWS):
            writer.add(pose_of_view(i), random_landmarks(i, 0 if i == 2 else N_OF_VIEW), source=0)
    return path


@pytest.fixture
def database_path(tmp_path: Path) -> Path:
    return write_random(tmp_path / "landmarks.h5")


def rows_of(database: Database) -> list[np.ndarray]:
    return [getattr(database, name) for name in LANDMARK_ARRAYS]


@pytest.mark.opencv
def test_a_file_of_views_is_the_database_of_these_views(references, camera, tmp_path: Path) -> None:
    path = tmp_path / "landmarks.h5"
    detector = make_detector(AKAZE)
    with new_database(path, AKAZE) as writer:
        writer.sources.append(SOURCE)
        for view in references[:2]:
            writer.add(view.trs_from_cam, landmarks_of(view, camera, detector), source=0)
    opened, built = open_database(path), find_landmarks(references[:2], camera, AKAZE)
    for ours, theirs in zip(rows_of(opened), rows_of(built), strict=True):
        np.testing.assert_array_equal(ours, theirs)
        assert ours.dtype == theirs.dtype
    assert opened.detector == AKAZE
    assert opened.known_digest == opened.digest == built.digest


def test_everything_that_is_known_comes_back(database_path: Path) -> None:
    verify_database(database_path)
    file = read_database_file(database_path)
    assert file.about.sources == (SOURCE,)
    assert file.about.detector == AKAZE
    assert {"tronlab", "opencv"} <= set(file.about.software)
    assert file.counts is None
    assert file.database.pruned_by == ()
    np.testing.assert_array_equal(np.bincount(file.database.view), [40, 40, 0, 40])
    for i, trs_from_cam in enumerate(file.views_trs_from_cam):
        np.testing.assert_allclose(trs_from_cam.as_matrix(), pose_of_view(i).as_matrix())
        np.testing.assert_allclose(file.database.p_views_trs_m[i], trs_from_cam.translation)


def test_the_file_says_what_is_in_it(database_path: Path) -> None:
    with h5py.File(database_path) as file:
        assert file["landmarks/p_trs_m"].attrs["units"] == "m"
        assert file["views/trs_from_cam"].attrs["parent"] == "trs"
        for name in LANDMARK_ARRAYS:
            stored = file[f"landmarks/{name}"]
            assert stored.chunks is None
            assert stored.id.get_offset() % 4096 == 0 or stored.nbytes < 4096


def test_arrays_are_mapped_and_writing_to_them_stays_here(database_path: Path) -> None:
    before = database_path.read_bytes()
    database = open_database(database_path)
    assert all(array.base is not None and array.flags.writeable for array in rows_of(database))
    database.p_trs_m[0] = 7.0
    assert database_path.read_bytes() == before


def test_a_selection_keeps_views_poses_and_history(database_path: Path, tmp_path: Path) -> None:
    source = read_database_file(database_path)
    counts = Counts(np.arange(120, dtype=np.uint32), np.arange(120, dtype=np.uint32) // 2)
    for step, uuids in enumerate((("u1", "u2"), ("u2", "u3"))):
        pruning = Pruning(
            time_utc="2026-01-01T00:00:00+00:00",
            from_digest=source.database.digest,
            n_before=len(source.database),
            n_after=len(source.database) - 20,
            datasets=uuids,
            rules={"min_verified": 1},
        )
        path = tmp_path / f"pruned{step}.h5"
        chosen = np.arange(20, len(source.database))
        save_selection(
            source, chosen, source.database.p_trs_m[chosen], path, pruning=pruning, counts=counts
        )
        verify_database(path)
        pruned = read_database_file(path)
        for ours, theirs in zip(rows_of(pruned.database), rows_of(source.database), strict=True):
            np.testing.assert_array_equal(ours, theirs[20:])
        assert pruned.counts is not None
        np.testing.assert_array_equal(pruned.counts.n_verified, counts.n_verified[20:])
        assert len(pruned.views_trs_from_cam) == N_VIEWS
        assert pruned.about.prunings == (*source.about.prunings, pruning)
        source, counts = pruned, pruned.counts
    assert source.database.pruned_by == ("u1", "u2", "u3")


def test_too_few_landmarks_leave_no_file(tmp_path: Path) -> None:
    with (
        pytest.raises(ScoreError, match="1 reference views give 40 landmarks, at least 50"),
        new_database(tmp_path / "few.h5", AKAZE) as writer,
    ):
        writer.add(pose_of_view(0), random_landmarks(0), source=0)
    assert not list(tmp_path.iterdir())


def test_what_is_there_is_never_overwritten(database_path: Path) -> None:
    before = database_path.read_bytes()
    with pytest.raises(DatasetError, match="exists already"):
        write_random(database_path)
    assert database_path.read_bytes() == before


def cut_short(path: Path, error: type[BaseException]) -> None:
    with new_database(path, AKAZE) as writer:
        writer.add(pose_of_view(0), random_landmarks(0), source=0)
        raise error("now")


@pytest.mark.parametrize("error", [KeyboardInterrupt, IntegrityError])
def test_nothing_is_left_when_it_is_cut_short(error: type[BaseException], tmp_path: Path) -> None:
    with pytest.raises(error):
        cut_short(tmp_path / "cut.h5", error)
    assert not list(tmp_path.iterdir())


KILLED = """
import sys, time
from pathlib import Path
import numpy as np
from scipy.spatial.transform import RigidTransform
from tronlab.nav.database import Landmarks
from tronlab.nav.database_writer import new_database
from tronlab.nav.settings import DetectorSettings
with new_database(Path(sys.argv[1]), DetectorSettings()) as writer:
    found = Landmarks(np.zeros((9999, 3)), np.ones(9999), np.zeros((9999, 61), np.uint8))
    writer.add(RigidTransform.identity(), found, source=0)
    print("added", flush=True)
    time.sleep(60)
"""


def test_nothing_is_left_when_it_is_killed(tmp_path: Path) -> None:
    program = [sys.executable, "-c", KILLED, str(tmp_path / "killed.h5")]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "added\n"
        child.kill()
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_one_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(h5py, "File", full)
    with pytest.raises(DatasetError, match=r"full\.h5: cannot be made: .*No space left"):
        write_random(tmp_path / "full.h5")
    assert not list(tmp_path.iterdir())


def _cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def _no_hdf5(path: Path) -> None:
    path.write_text("landmarks")


def _other_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.attrs["tronlab_schema"] = "3.0"


def _newer(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file.attrs["tronlab_landmarks"] = "2.0"


def _no_digest(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file.attrs["digest"]


def _no_about(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file["about"]


def _other_pose(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file["views/trs_from_cam"][1, 0] += 1e-6


def _array_of_other_shape(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file["landmarks/size_m"]
        file["landmarks/size_m"] = np.ones(7)


def _compressed(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        sizes = file["landmarks/size_m"][:]
        del file["landmarks/size_m"]
        file.create_dataset("landmarks/size_m", data=sizes, compression="gzip")


@pytest.mark.parametrize(
    ("damage", "error", "text"),
    [
        (Path.unlink, DatasetError, "no such file; make one: tronlab database build"),
        (_cut, IntegrityError, "damaged or was copied incompletely"),
        (_no_hdf5, DatasetError, "is not an HDF5 file"),
        (_other_hdf5, DatasetError, "no database of landmarks"),
        (_newer, SchemaVersionError, "landmarks in layout 2.0; .* build the database again"),
        (_no_digest, IntegrityError, "has no digest"),
        (_no_about, IntegrityError, "about is missing or damaged"),
        (_other_pose, IntegrityError, "views/trs_from_cam is damaged: its checksum"),
        (_array_of_other_shape, IntegrityError, r"size_m is damaged: float64 of shape \(7,\), 120"),
        (_compressed, IntegrityError, "size_m is damaged: .* in one piece"),
    ],
)
def test_a_bad_file_is_one_clear_error(
    damage: Callable[[Path], None], error: type[TronlabError], text: str, database_path: Path
) -> None:
    damage(database_path)
    with pytest.raises(error, match=text) as caught:
        open_database(database_path)
    assert type(caught.value) is error
    assert str(database_path) in str(caught.value)


@pytest.mark.parametrize("name", LANDMARK_ARRAYS)
def test_one_wrong_bit_is_found_when_the_file_is_verified(name: str, database_path: Path) -> None:
    with h5py.File(database_path) as file:
        at = file[f"landmarks/{name}"].id.get_offset() + 11
    content = bytearray(database_path.read_bytes())
    content[at] ^= 4
    database_path.write_bytes(content)
    with pytest.raises(IntegrityError, match="do not fit the file's digest"):
        verify_database(database_path)
