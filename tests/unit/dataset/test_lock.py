import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tronlab.dataset.lock import lock_holder, run_lock
from tronlab.errors import DatasetError

HOLD = """
import sys
from pathlib import Path
from tronlab.dataset.lock import run_lock
with run_lock(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def hold(path: Path) -> subprocess.Popen[str]:
    """Start a process that holds the lock until its input ends."""
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    return holder


def test_the_second_process_is_told_who_records_and_a_dead_one_is_no_hindrance(
    tmp_path: Path,
) -> None:
    path = tmp_path / "dataset.h5"
    with hold(path) as holder:
        found = lock_holder(path)
        assert found is not None
        assert (found.pid, found.host) == (holder.pid, socket.gethostname())
        message = re.escape(f"is being recorded by {found}; wait until")
        with pytest.raises(DatasetError, match=message), run_lock(path):
            pass
        holder.kill()
    assert (tmp_path / "dataset.lock").exists()
    assert lock_holder(path) is None
    with run_lock(path):
        values = json.loads((tmp_path / "dataset.lock").read_text(encoding="utf-8"))
        assert values["pid"] == os.getpid()
        with pytest.raises(DatasetError, match=f"process {os.getpid()} on"), run_lock(path):
            pass
    assert list(tmp_path.iterdir()) == []


def test_a_lock_that_cannot_be_made_is_one_clear_error(tmp_path: Path) -> None:
    with (
        pytest.raises(DatasetError, match="the lock cannot be made: No such file"),
        run_lock(tmp_path / "nowhere/dataset.h5"),
    ):
        pass


def test_a_lock_file_of_rubbish_is_no_hindrance(tmp_path: Path) -> None:
    (tmp_path / "dataset.lock").write_bytes(b"\xff{")
    with run_lock(tmp_path / "dataset.h5"):
        assert lock_holder(tmp_path / "dataset.h5") is not None
