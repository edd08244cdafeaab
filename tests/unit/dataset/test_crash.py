"""Kills, full disks and power cuts: what was committed is there, and the recording goes on.

``TRONLAB_KILLS`` and ``TRONLAB_POWER_CUTS`` set how many there are; the default is few.
"""

import errno
import json
import os
import resource
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import DriftRecord, Provenance, ReferenceView, Session, ShotRecord
from tronlab.dataset.writer import DatasetWriter
from tronlab.errors import DatasetError

TESTS = Path(__file__).parents[2]
N_KILLS = int(os.environ.get("TRONLAB_KILLS", "3"))
N_POWER_CUTS = int(os.environ.get("TRONLAB_POWER_CUTS", "2"))

MakeShot = Callable[..., ShotRecord]
MakeSession = Callable[..., Session]
MakeProvenance = Callable[..., Provenance]
MakeDrift = Callable[..., DriftRecord]


@contextmanager
def files_no_longer_than(n_bytes: int) -> Generator[None]:
    """Let the operating system refuse to write further, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def run_script(script: str, *arguments: str) -> Any:
    """Run a script in its own process; what it prints is JSON."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script), str(TESTS), *arguments],
        capture_output=True,
        text=True,
        timeout=1800,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


KILL_SESSIONS = """
    import json, os, random, signal, struct, sys, time
    from dataclasses import replace
    from pathlib import Path
    sys.path.insert(0, sys.argv[1])
    import conftest
    from tronlab.dataset.journal import read_journal
    from tronlab.dataset.lock import run_lock
    from tronlab.dataset.reader import Dataset
    from tronlab.dataset.writer import DatasetWriter

    path, n_kills, n_shots = Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
    shots = [conftest.fake_shot(i, has_quality=True) for i in range(10)]

    def record(acknowledge):
        with run_lock(path):
            if path.exists():
                with Dataset(path) as dataset:
                    number = len(dataset.sessions) + 1
                session = conftest.fake_session(number, "resume", start_utc="t")
                writer = DatasetWriter.reopen(path, session, n_rows=n_shots, segment_shots=7)
            else:
                writer = DatasetWriter(
                    path, conftest.fake_provenance(n_shots), session=conftest.fake_session(1),
                    segment_shots=7,
                )
                writer.add_references([conftest.fake_view(0)])
            writer.plan_drift_checks(conftest.REFLECTORS, 2)
            writer.commit_drift(conftest.fake_drift(0))
            for i in range(n_shots):
                if i not in writer.committed_ids:
                    writer.commit(replace(shots[i % 10], shot_id=i))
                    os.write(acknowledge, struct.pack("<i", i))
            writer.finish("complete")

    def live_and_die(delay_s, is_timed_from_first_shot):
        receive, acknowledge = os.pipe()
        child = os.fork()
        if child == 0:
            record(acknowledge)
            os._exit(0)
        os.close(acknowledge)
        told = os.read(receive, 4) if is_timed_from_first_shot else b""
        if delay_s is not None:
            time.sleep(delay_s)
            os.kill(child, signal.SIGKILL)
        while part := os.read(receive, 65536):
            told += part
        _, status = os.waitpid(child, 0)
        assert delay_s is not None or status == 0, status
        os.close(receive)
        return {i for (i,) in struct.iter_unpack("<i", told)}

    rng = random.Random(5)
    acknowledged = set()
    n_killed_between = 0
    for k in range(n_kills):
        new = live_and_die(rng.uniform(0.0, 0.06), is_timed_from_first_shot=k % 2 == 1)
        acknowledged |= new
        n_killed_between += 0 < len(acknowledged) < n_shots
        if path.exists():
            with Dataset(path) as dataset:
                assert acknowledged <= set(dataset.shot_ids.tolist())
                for i in range(dataset.n_shots):
                    dataset.shot(i)
        else:
            assert not acknowledged
    live_and_die(None, is_timed_from_first_shot=False)
    with Dataset(path) as dataset:
        n_wrong = sum(
            dataset.image(i).tobytes() != shots[shot_id % 10].frame.image.tobytes()
            for i, shot_id in enumerate(dataset.shot_ids.tolist())
        )
        print(json.dumps({
            "ids": sorted(dataset.shot_ids.tolist()), "n_wrong": n_wrong,
            "n_sessions": len(dataset.sessions), "n_killed_between": n_killed_between,
            "status": dataset.status, "journal": len(read_journal(path)),
            "left": sorted(entry.name for entry in path.parent.iterdir()),
        }))
"""


def test_however_often_it_is_killed_every_shot_is_there_once(tmp_path: Path) -> None:
    n_shots = 25 * N_KILLS
    found = run_script(KILL_SESSIONS, str(tmp_path / "dataset.h5"), str(N_KILLS), str(n_shots))
    assert found["ids"] == list(range(n_shots))
    assert found["n_wrong"] == 0
    assert found["status"] == "complete"
    assert found["n_killed_between"] >= 1, "the kills came before there was anything to lose"
    assert found["n_sessions"] >= 2
    assert found["journal"] == 0, "a kill, other than a power cut, damages nothing"
    assert found["left"] == ["dataset.h5", "dataset.images"]


class Disk:
    """Remembers in which order the bytes of a recording were handed to the operating system."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.log: list[tuple[Path, int, bytes | None]] = []
        """File, place and bytes; None instead of bytes: the file was forced to the disk."""
        self.n_writes_left: int | None = None
        """Until the disk is full."""
        self._pwrite, self._fsync = os.pwrite, os.fsync
        monkeypatch.setattr(os, "pwrite", self.pwrite)
        monkeypatch.setattr(os, "fsync", self.fsync)

    def pwrite(self, descriptor: int, data: Any, offset: int) -> int:
        if self.n_writes_left is not None:
            if self.n_writes_left <= 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            self.n_writes_left -= 1
            data = data[: max(1, len(data) // 2)]  # a disk that fills up takes a part first
        self.log.append((self._path(descriptor), offset, bytes(data)))
        return self._pwrite(descriptor, data, offset)

    def fsync(self, descriptor: int) -> None:
        self.log.append((self._path(descriptor), 0, None))

    def _path(self, descriptor: int) -> Path:
        return Path(os.readlink(f"/proc/self/fd/{descriptor}"))


def start(
    path: Path, provenance: Provenance, session: Session, drift: DriftRecord
) -> DatasetWriter:
    """Begin a recording that has room for its drift checks."""
    path.parent.mkdir(exist_ok=True)
    writer = DatasetWriter(path, provenance, session=session, segment_shots=20)
    writer.plan_drift_checks(tuple(drift.readings), 3)
    writer.commit_drift(drift)
    return writer


def apply(change: tuple[Path, int, bytes | None], folder: Path, copy: Path) -> None:
    """Make one change to a copy of the folder it was made in."""
    path, offset, data = change
    if data is not None:
        with (copy / path.relative_to(folder)).open("r+b") as file:
            file.seek(offset)
            file.write(data)


def test_wherever_the_writing_stops_every_committed_shot_and_check_is_there(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    make_shot: MakeShot,
    make_provenance: MakeProvenance,
    make_session: MakeSession,
    make_drift: MakeDrift,
) -> None:
    folder, copy = tmp_path / "recorded", tmp_path / "copy"
    writer = start(folder / "a.h5", make_provenance(4), make_session(1), make_drift(0))
    writer.commit(make_shot(0))
    shutil.copytree(folder, copy)
    disk = Disk(monkeypatch)
    writer.commit(make_shot(10, shot_id=0), replaces=True)
    n_of_shot = len(disk.log)
    writer.commit_drift(make_drift(2))
    n_of_check = len(disk.log)
    assert n_of_shot > 50
    for k, change in enumerate(disk.log):
        apply(change, folder, copy)
        if k % 15 and not n_of_shot - 4 < k < n_of_shot + 2 and k < n_of_check - 4:
            continue
        with Dataset(copy / "a.h5") as dataset:
            is_there = dataset.n_rows == 2
            assert is_there or k < n_of_shot - 1, f"after change {k} of {len(disk.log)}"
            image = make_shot(10 if is_there else 0).frame.image
            np.testing.assert_array_equal(dataset.shot(0).frame.image, image)
            counts = [check.n_shots_before for check in dataset.drift_checks]
            assert counts == [0, 2][: len(counts)]
            assert len(counts) == 2 or k < n_of_check - 1
    writer.finish("aborted")


@pytest.mark.parametrize("seed", range(N_POWER_CUTS))
def test_after_a_power_cut_what_was_forced_to_the_disk_is_there_and_nothing_is_wrong(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    make_shot: MakeShot,
    make_provenance: MakeProvenance,
    make_session: MakeSession,
    make_drift: MakeDrift,
    seed: int,
) -> None:
    """Any of the writes since a file was last forced to the disk may be lost."""
    rng = np.random.default_rng(seed)
    monkeypatch.setattr("tronlab.dataset.writer._SYNC_EVERY_S", 1e9)
    monkeypatch.setattr("tronlab.dataset.writer._SYNC_EVERY_ROWS", 4)
    folder, copy = tmp_path / "recorded", tmp_path / "copy"
    writer = start(folder / "a.h5", make_provenance(12), make_session(1), make_drift(0))
    writer.commit(make_shot(0))
    shutil.copytree(folder, copy)
    disk = Disk(monkeypatch)
    n_safe = 1
    for i in range(1, 12):
        n_before = len(disk.log)
        writer.commit(make_shot(i))
        if any(data is None and path.name == "a.h5" for path, _, data in disk.log[n_before:]):
            n_safe = i + 1
    assert 1 < n_safe < 12
    monkeypatch.undo()
    last_sync = {path: k for k, (path, _, data) in enumerate(disk.log) if data is None}
    for k, change in enumerate(disk.log):
        if k < last_sync.get(change[0], 0) or rng.random() < 0.9:
            apply(change, folder, copy)
    writer = DatasetWriter.reopen(copy / "a.h5", make_session(2), n_rows=12, segment_shots=20)
    missing = sorted(set(range(12)) - writer.committed_ids)
    assert all(i >= n_safe for i in missing)
    for i in missing:
        writer.commit(make_shot(i))
    writer.finish("complete")
    with Dataset(copy / "a.h5") as dataset:
        assert sorted(dataset.shot_ids.tolist()) == list(range(12))
        for k, i in enumerate(dataset.shot_ids.tolist()):
            shot, given = dataset.shot(k), make_shot(i)
            np.testing.assert_array_equal(shot.frame.image, given.frame.image)
            np.testing.assert_array_equal(shot.truth.covariance, given.truth.covariance)


def test_when_the_disk_fills_up_what_was_committed_stays_and_the_recording_can_go_on(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    make_shot: MakeShot,
    make_provenance: MakeProvenance,
    make_session: MakeSession,
    make_drift: MakeDrift,
) -> None:
    path = tmp_path / "recorded/a.h5"
    writer = start(path, make_provenance(4), make_session(1), make_drift(0))
    writer.commit(make_shot(0))
    writer.commit(make_shot(1))
    for n_writes in (0, 1, 3, 30, 64):
        with monkeypatch.context() as patch:
            Disk(patch).n_writes_left = n_writes
            with pytest.raises(
                DatasetError,
                match=r"shot 2 could not be written: .*No space left.*; the 2 shots before it",
            ):
                writer.commit(make_shot(2))
        with Dataset(path) as dataset:
            assert (dataset.shot_ids.tolist(), dataset.status) == ([0, 1], "running")
            for i in range(2):
                dataset.shot(i)
    with monkeypatch.context() as patch:
        Disk(patch).n_writes_left = 0
        with pytest.raises(DatasetError, match=r"could not be finished: .*No space left"):
            writer.finish("failed", "disk full")
    with DatasetWriter.reopen(path, make_session(2), n_rows=2, segment_shots=20) as writer:
        for i in (2, 3):
            writer.commit(make_shot(i))
        writer.finish("complete")
    with Dataset(path) as dataset:
        assert dataset.shot_ids.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("n_bytes", "segment_shots", "n_views", "what"),
    [
        (1_000_000, 100, 0, "cannot be set up"),
        (1_600_000, 100, 200, "the reference views could not be written"),
        (1_650_000, 100, 0, "shot 0 could not be written"),
        (1_650_000, None, 0, "shot 0 could not be written"),
    ],
)
def test_a_disk_that_is_full_from_the_beginning_is_one_clear_error_and_leaves_nothing(
    tmp_path: Path,
    make_shot: MakeShot,
    make_provenance: MakeProvenance,
    make_view: Callable[[int], ReferenceView],
    n_bytes: int,
    segment_shots: int | None,
    n_views: int,
    what: str,
) -> None:
    path, views = tmp_path / "a.h5", [make_view(0)] * n_views
    message = rf"^{path}: {what}: .*File too large"

    def record() -> None:
        with DatasetWriter(path, make_provenance(150), segment_shots=segment_shots) as writer:
            if views:
                writer.add_references(views)
            writer.commit(make_shot(0))

    with files_no_longer_than(n_bytes), pytest.raises(DatasetError, match=message):
        record()
    assert not list(tmp_path.iterdir())


def test_what_a_kill_left_before_the_first_shot_is_cleared_away_and_nothing_else(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    make_shot: MakeShot,
    make_provenance: MakeProvenance,
    make_session: MakeSession,
    make_drift: MakeDrift,
) -> None:
    def killed_before_publishing(folder: Path) -> None:
        path = tmp_path / "alive/a.h5"
        writer = start(path, make_provenance(4), make_session(1), make_drift(0))
        with monkeypatch.context() as patch:
            patch.setattr(writer._master, "publish", lambda: shutil.copytree(path.parent, folder))
            writer.commit(make_shot(0))
        writer.finish("aborted")
        shutil.rmtree(path.parent)

    left = tmp_path / "left"
    killed_before_publishing(left)
    assert sorted(entry.name for entry in left.iterdir()) == [".a.h5.part", "a.images"]
    writer = start(left / "a.h5", make_provenance(4), make_session(1), make_drift(0))
    writer.commit(make_shot(0))
    writer.finish("aborted")
    # A copy left by a killed session does not give its segments away, even if the file is gone.
    writer = DatasetWriter.reopen(left / "a.h5", make_session(2), n_rows=2, segment_shots=20)
    shutil.copytree(left, tmp_path / "moved")
    writer.finish("aborted")
    (tmp_path / "moved/a.h5").unlink()
    images = (tmp_path / "moved/a.images/0001.h5").read_bytes()
    with pytest.raises(DatasetError, match="is there already and does not belong"):
        start(tmp_path / "moved/a.h5", make_provenance(4), make_session(1), make_drift(0))
    assert (tmp_path / "moved/a.images/0001.h5").read_bytes() == images


def test_two_that_begin_at_the_same_place_do_not_disturb_each_other(
    tmp_path: Path,
    make_shot: MakeShot,
    make_provenance: MakeProvenance,
    make_session: MakeSession,
    make_drift: MakeDrift,
) -> None:
    path = tmp_path / "recorded/a.h5"
    writer = start(path, make_provenance(4), make_session(1), make_drift(0))
    with pytest.raises(DatasetError, match="is being written by another process; wait until"):
        start(path, make_provenance(4), make_session(1), make_drift(0))
    writer.commit(make_shot(0))
    with pytest.raises(DatasetError, match="exists already and is never overwritten"):
        start(path, make_provenance(4), make_session(1), make_drift(0))
    with pytest.raises(OSError, match="unable to lock file"):
        h5py.File(path, "r+")
    writer.commit(make_shot(1))
    writer.finish("aborted")
    with Dataset(path) as dataset:
        assert dataset.shot_ids.tolist() == [0, 1]
