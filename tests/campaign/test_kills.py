"""A run that is killed, or whose disk is full, again and again: nothing is lost, nothing twice.

``TRONLAB_KILLS=100 TRONLAB_FULL_DISKS=100 TRONLAB_SHOTS=200 pytest tests/campaign/test_kills.py``
is the figure the changelog names; by default it is a sample.
"""

import multiprocessing
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import pytest
from recording_child import go_on
from scipy.spatial.transform import Rotation

from tronlab.campaign.rig import load_rig
from tronlab.dataset.journal import read_journal
from tronlab.dataset.lock import lock_holder
from tronlab.dataset.reader import Dataset
from tronlab.dataset.validate import validate
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.renderer import Lamp

N_KILLS = int(os.environ.get("TRONLAB_KILLS", "2"))
N_FULL_DISKS = int(os.environ.get("TRONLAB_FULL_DISKS", "2"))
N_SHOTS = int(os.environ.get("TRONLAB_SHOTS", "24"))
SEED = int(os.environ.get("TRONLAB_SEED", "1"))
MASTER_BYTES = 250_000
"""About what each session writes before its first shot."""
COMMAND = [sys.executable, "-c", "from tronlab.cli import main; main()", "run"]
FULL_DISK_C = Path(__file__).parents[1] / "support/full_disk.c"


@pytest.fixture
def scattered(campaign_path: Path, edit_yaml: Callable[..., None], tmp_path: Path) -> Path:
    """The small campaign with poses so different that an image belongs to one of them only."""
    rng = np.random.default_rng(SEED)
    downwards = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    rows = ["x,y,z,qx,qy,qz,qw"]
    for _ in range(N_SHOTS):
        place = rng.uniform([0.8, 1.6, 1.6], [1.4, 2.6, 2.4])
        turn = Rotation.from_rotvec(rng.normal(0.0, 0.04, 3)) * downwards
        rows.append(",".join(f"{v:.9f}" for v in (*place, *turn.as_quat())))
    (tmp_path / "poses.csv").write_text("\n".join(rows) + "\n")
    edit_yaml(campaign_path, "trajectory", {"kind": "file", "path": "poses.csv"})
    edit_yaml(campaign_path, "recording", {"segment_shots": 8})
    return campaign_path


@pytest.fixture
def full_disk(tmp_path: Path) -> Path:
    """A library that makes the disk full; see its source."""
    library = tmp_path / "full_disk.so"
    compiler = shutil.which("cc") or pytest.skip("no C compiler")
    subprocess.run(
        [compiler, "-shared", "-fPIC", "-O1", "-o", library, FULL_DISK_C, "-ldl"], check=True
    )
    return library


def arguments(campaign_path: Path, out: Path) -> Sequence[object]:
    if (out / "dataset.h5").exists():
        return [*COMMAND, "--resume", out]
    return [*COMMAND, campaign_path, "--out", out]


def session(
    command: Sequence[object], environment: Mapping[str, str] = os.environ
) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [str(word) for word in command],
        check=False,
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
    )


def n_shots_of(path: Path) -> int:
    """Open the dataset, if there is one: after whatever happened it must be readable."""
    if not path.exists():
        return 0
    with Dataset(path) as dataset:
        ids = dataset.shot_ids
        assert len(set(ids)) == len(ids)
        for i in range(max(0, dataset.n_shots - 3), dataset.n_shots):
            dataset.shot(i)
        return dataset.n_shots


def check_complete(path: Path, rig_path: Path) -> None:
    """See that every shot is there once, undamaged, and shows what its pose sees."""
    assert [finding for finding in validate(path) if "unchecked" not in finding] == []
    with Dataset(path) as dataset:
        assert sorted(dataset.shot_ids) == list(range(1, N_SHOTS + 1))
        assert (dataset.status, dataset.n_rows) == ("complete", N_SHOTS)
        shown = np.array([outline(dataset.image(i)) for i in range(N_SHOTS)])
        rig = load_rig(rig_path)
        renderer = HeightfieldRenderer(rig.load_heightmap())
        lamp = Lamp(p_trs_m=np.array(rig.config.laboratory.lamp.p_trs_m), intensity=1.0)
        for i in range(N_SHOTS):
            pose = dataset.truth(i).trs_from_cam
            seen = renderer.render(dataset.camera, pose, lamp).radiance
            assert int(np.argmax(shown @ outline(seen))) == i, f"row {i} shows another pose"


def outline(image: np.ndarray) -> np.ndarray:
    """Give an image as a vector of length one whose mean does not count."""
    values = image.astype(np.float64).ravel()
    values -= values.mean()
    return values / np.linalg.norm(values)


@pytest.mark.timeout(7200)
def test_killed_at_random_moments(scattered: Path, rig_path: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(SEED)
    children = multiprocessing.get_context("forkserver")
    children.set_forkserver_preload(["recording_child"])
    out, n_kills, n_done, n_before_kill = tmp_path / "out", 0, 0, []
    while n_kills < N_KILLS and n_done < N_SHOTS:
        process = children.Process(target=go_on, args=(scattered, out))
        process.start()
        is_early = rng.random() < 0.3
        n_more = 0 if is_early else rng.geometric(min(1.0, 1.5 * N_KILLS / N_SHOTS))
        wait_for_shots(out, process, n_more=int(n_more))
        time.sleep(rng.uniform(0.0, 1.0 if is_early else 0.03))
        process.kill()
        process.join()
        n_kills += 1
        n_now = n_shots_of(out / "dataset.h5")
        assert n_now >= n_done, "a shot was lost"
        n_done = n_now
        n_before_kill.append(n_now)
    last = session(arguments(scattered, out))
    assert last.returncode == 0, last.stderr
    print(f"{n_kills} kills, with so many shots committed: {n_before_kill}")
    check_complete(out / "dataset.h5", rig_path)


def wait_for_shots(out: Path, process: BaseProcess, *, n_more: int) -> None:
    """Wait until the process has stored so many shots; for none, until it has the lock."""
    path, give_up_s = out / "dataset.h5", 120.0
    wanted = n_shots_of(path) + n_more
    while process.is_alive() and give_up_s > 0:
        if n_more == 0 and lock_holder(path) is not None:
            return
        if n_more > 0 and n_shots_of(path) >= wanted:
            return
        time.sleep(0.02)
        give_up_s -= 0.02


@pytest.mark.timeout(7200)
def test_disk_full_at_random_moments(
    scattered: Path, rig_path: Path, full_disk: Path, tmp_path: Path
) -> None:
    rng = np.random.default_rng(SEED)
    out, n_done, n_failures = tmp_path / "out", 0, 0
    while n_failures < N_FULL_DISKS and n_done < N_SHOTS:
        n_more = max(4.0, 2 * N_SHOTS / N_FULL_DISKS)
        budget = int(rng.uniform(0.0, 1.5) * (MASTER_BYTES + 64 * 64 * 2 * n_more))
        disk = {"DISK_BUDGET": str(budget), "DISK_FOLDER": str(out)}
        environment = {**os.environ, "LD_PRELOAD": str(full_disk), **disk}
        ended = subprocess.run(
            arguments(scattered, out),
            check=False,
            env=environment,
            capture_output=True,
            text=True,
            timeout=600,
        )
        # h5py itself prints what it cannot raise while it lets go of a file that was being made.
        assert not re.search(r'File ".*/tronlab/', ended.stderr), ended.stderr
        n_failures += ended.returncode != 0
        n_now = n_shots_of(out / "dataset.h5")
        assert n_now >= n_done, "a shot was lost"
        n_done = n_now
    assert n_failures, "the disk never was full"
    last = subprocess.run(
        arguments(scattered, out), check=False, capture_output=True, text=True, timeout=600
    )
    assert last.returncode == 0, last.stderr
    print(f"{n_failures} full disks, {n_done} shots before the last resume")
    check_complete(out / "dataset.h5", rig_path)
    assert any(entry.kind == "session" for entry in read_journal(out / "dataset.h5"))
