"""Kills, full disks and cut-off files: what was committed is always there."""

import io
import json
import subprocess
import sys
import textwrap
from bisect import bisect_right
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from tronlab.dataset import reader, schema, writer
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import DriftRecord, Provenance, ReferenceView, ShotRecord
from tronlab.dataset.validate import validate

TESTS = Path(__file__).parents[2]


def run_script(script: str, *arguments: str) -> Any:
    """Run a script in its own process; what it prints is JSON."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script), str(TESTS), *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


KILL_WRITERS = """
    import json, os, random, signal, sys, time
    from dataclasses import replace
    from pathlib import Path
    sys.path.insert(0, sys.argv[1])
    import conftest
    from tronlab.dataset.writer import DatasetWriter

    shots = [conftest.fake_shot(i) for i in range(20)]

    def write(path, acknowledge):
        with DatasetWriter(path, conftest.fake_provenance(300)) as writer:
            writer.add_references([conftest.fake_view(0)])
            for i in range(300):
                writer.commit(replace(shots[i % 20], shot_id=i))
                os.write(acknowledge, b".")

    def kill_one(path, delay_s):
        receive, acknowledge = os.pipe()
        child = os.fork()
        if child == 0:
            write(path, acknowledge)
            os._exit(1)
        os.close(acknowledge)
        n = len(os.read(receive, 1))
        time.sleep(delay_s)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        while part := os.read(receive, 65536):
            n += len(part)
        return n

    rng = random.Random(5)
    folder = Path(sys.argv[2])
    print(json.dumps(
        [kill_one(folder / f"{k}.h5", rng.uniform(0.0, 0.1)) for k in range(int(sys.argv[3]))]
    ))
"""


def test_after_kill_9_every_acknowledged_shot_is_there(
    tmp_path: Path, make_shot: Callable[..., ShotRecord]
) -> None:
    acknowledged = run_script(KILL_WRITERS, str(tmp_path), "10")
    assert sum(acknowledged) > 24, "the kills came before there was anything to lose"
    for k, n_acknowledged in enumerate(acknowledged):
        path = tmp_path / f"{k}.h5"
        with Dataset(path) as dataset:
            assert n_acknowledged <= dataset.n_shots <= n_acknowledged + 1
            assert dataset.status == "running"
            assert dataset.n_references == 1
            last = dataset.n_shots - 1
            np.testing.assert_array_equal(dataset.image(last), make_shot(last % 20).frame.image)
            n_shots = dataset.n_shots
        assert validate(path) == [
            "the recording never ended (status running): it still runs, or was killed",
            f"{n_shots} of 300 planned shots are there",
        ]


FILL_DISK = """
    import json, resource, signal, sys
    from pathlib import Path
    sys.path.insert(0, sys.argv[1])
    import conftest
    from tronlab.dataset.writer import DatasetWriter
    from tronlab.errors import DatasetError

    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    path, last, stack = Path(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
    writer = DatasetWriter(path, conftest.fake_provenance(12))
    for i in range(last):
        writer.commit(conftest.fake_shot(i))
    if last:
        place = writer._row("entry/instrument/camera/" + stack).id.get_chunk_info(last).byte_offset
    else:
        place = path.stat().st_size
    resource.setrlimit(resource.RLIMIT_FSIZE, (place + 1000, place + 1000))
    messages = []
    for act in (
        lambda: writer.commit(conftest.fake_shot(last)),
        lambda: writer.finish("failed", "disk full"),
    ):
        try:
            act()
            messages.append("done")
        except DatasetError as error:
            messages.append(str(error))
    print(json.dumps(messages))
"""


@pytest.mark.parametrize(
    ("last", "stack"), [(0, "image"), (1, "image"), (7, "image"), (2, "mask"), (11, "mask")]
)
def test_when_the_disk_is_full_what_was_committed_stays_readable(
    tmp_path: Path, last: int, stack: str
) -> None:
    path = tmp_path / "a.h5"
    message, finished = run_script(FILL_DISK, str(path), str(last), stack)
    assert message.startswith(f"{path}: shot {last} could not be written: ")
    assert "File too large" in message
    with Dataset(path) as dataset:
        assert dataset.shot_ids.tolist() == list(range(last))
        assert dataset.status == ("failed" if finished == "done" else "running")
        for row in range(last):
            dataset.shot(row)


class RecordedFile(io.BytesIO):
    """A file that remembers every change made to it."""

    def __init__(self) -> None:
        super().__init__()
        self.changes: list[tuple[int, bytes | None]] = []

    def write(self, data: Any) -> int:
        self.changes.append((self.tell(), bytes(data)))
        return super().write(data)

    def truncate(self, size: int | None = None) -> int:
        size = self.tell() if size is None else size
        self.changes.append((size, None))
        return super().truncate(size)


def apply_change(content: bytearray, place: int, data: bytes | None) -> None:
    end = place if data is None else place + len(data)
    content.extend(bytes(max(0, end - len(content))))
    if data is None:
        del content[place:]
    else:
        content[place:end] = data


def record_writes(
    monkeypatch: pytest.MonkeyPatch,
    provenance: Provenance,
    shots: list[ShotRecord],
    views: list[ReferenceView],
    checks: list[DriftRecord],
) -> tuple[list[tuple[int, bytes | None]], list[int], list[int]]:
    """Write a dataset: a drift check, then a shot and a check in turns.

    Returns:
        Every change of the file, and how many there were at each commit of a shot, of a check.
    """
    recorded = RecordedFile()
    with monkeypatch.context() as patch:
        patch.setattr(writer, "_create", lambda _: h5py.File(recorded, "w"))
        patch.setattr(writer.DatasetWriter, "_sync", lambda self: self._file.flush())
        patch.setattr(writer.DatasetWriter, "_probe_room", lambda *_: None)
        at_shots: list[int] = []
        at_checks: list[int] = []
        with writer.DatasetWriter(Path("recorded.h5"), provenance) as recording:
            recording.add_references(views)
            recording.plan_drift_checks(tuple(checks[0].readings), len(checks) + 1)
            recording.commit_drift(checks[0])
            at_checks.append(len(recorded.changes))
            for shot, check in zip(shots, checks[1:], strict=True):
                recording.commit(shot)
                at_shots.append(len(recorded.changes))
                recording.commit_drift(check)
                at_checks.append(len(recorded.changes))
            recording.finish("aborted", "operator")
    return recorded.changes, at_shots, at_checks


def test_wherever_the_writing_stops_every_committed_shot_and_check_is_there(
    monkeypatch: pytest.MonkeyPatch,
    make_shot: Callable[..., ShotRecord],
    make_provenance: Callable[..., Provenance],
    make_view: Callable[[int], ReferenceView],
    make_drift: Callable[..., DriftRecord],
) -> None:
    shots = [make_shot(i) for i in range(2)]
    checks = [make_drift(n) for n in range(3)]
    changes, at_shots, at_checks = record_writes(
        monkeypatch, make_provenance(4), shots, [make_view(0)], checks
    )
    assert len(changes) > 2 * 40
    content = bytearray()
    for k, (place, data) in enumerate(changes, start=1):
        apply_change(content, place, data)
        n_shots, n_checks = bisect_right(at_shots, k), bisect_right(at_checks, k)
        if n_shots:  # the first one still changes the file's structure
            monkeypatch.setattr(
                reader, "open_dataset", lambda _: h5py.File(io.BytesIO(bytes(content)), "r")
            )
            with Dataset(Path("recorded.h5")) as dataset:
                assert dataset.n_shots >= n_shots, f"after change {k} of {len(changes)}"
                assert dataset.rows(schema.SHOT_ID).tolist() == list(range(dataset.n_shots))
                dataset.shot(dataset.n_shots - 1)
                done = [check.n_shots_before for check in dataset.drift_checks]
                assert done == list(range(len(done))), f"after change {k} of {len(changes)}"
                assert len(done) >= n_checks
                assert dataset.truth_states[: len(done) - 1] == ("good",) * (len(done) - 1)
