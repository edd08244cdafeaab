"""Scoring on a Dask cluster: as in this process, whatever becomes of the workers."""

import os
import signal
import sys
import time
from collections.abc import Generator, Sequence
from contextlib import closing
from pathlib import Path
from types import ModuleType

import dask
import numpy as np
import pytest
from distributed import LocalCluster
from scipy.spatial.transform import RigidTransform

from tronlab.errors import ScoreError
from tronlab.nav.database import Landmarks
from tronlab.nav.database_file import Source, open_database
from tronlab.nav.database_writer import new_database
from tronlab.nav.settings import DetectorSettings
from tronlab.nav.specs import CoreSpec
from tronlab.score.rescoring import cluster as cluster_module
from tronlab.score.rescoring.cluster import DaskExecutor
from tronlab.score.rescoring.opening import ScoredCore
from tronlab.score.rescoring.unit import Answer, Unit
from tronlab.score.rescoring.workers import ProcessExecutor

CORES = '''
"""Cores that run in the process that scores; workers import this, too."""

import os
import time

from scipy.spatial.transform import RigidTransform

from tronlab.nav.core import NavigationResult
from tronlab.score.rescoring.opening import ScoredCore


class Grey:
    name = "grey"

    def __init__(self, seed):
        self.seed = seed

    def locate(self, frame):
        z_m = float(frame.image.mean()) / 3.0 + self.seed
        return NavigationResult("ok", RigidTransform.from_translation([0.1, 0.2, z_m]))


class GreyCore(ScoredCore):
    def open(self, context, *, limit_s):
        return Grey(context.seed)


class SlowCore(ScoredCore):
    def open(self, context, *, limit_s):
        time.sleep(0.2)
        return Grey(context.seed)


class DeadlyCore(ScoredCore):
    def open(self, context, *, limit_s):
        os._exit(7)


class LostCore(ScoredCore):
    def open(self, context, *, limit_s):
        raise ZeroDivisionError("a mistake of ours")
'''


@pytest.fixture(scope="module")
def cores(tmp_path_factory: pytest.TempPathFactory) -> Generator[ModuleType]:
    folder = tmp_path_factory.mktemp("cores")
    (folder / "cluster_cores.py").write_text(CORES)
    sys.path.insert(0, str(folder))  # worker processes get the same path
    import cluster_cores  # pyright: ignore[reportMissingImports]

    yield cluster_cores
    sys.path.remove(str(folder))


@pytest.fixture(scope="module")
def cluster(cores: ModuleType) -> Generator[LocalCluster]:
    settings = {
        "distributed.scheduler.allowed-failures": 0,  # what a lost worker had is tried alone
        "distributed.logging": {"distributed": "critical"},
        "distributed.worker.multiprocessing-method": "forkserver",  # starts sooner than spawn
    }
    with (
        dask.config.set(settings),
        LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
        ) as two_workers,
    ):
        yield two_workers


def units(dataset: Path, *cores: type[ScoredCore], seed: int = 0) -> list[Unit]:
    """Each shot with all cores, as built-in ones are scored."""
    scored = tuple(
        core(CoreSpec(core.__name__, "installed", core.__name__, seed=seed), core.__name__)
        for core in cores
    )
    return [Unit(dataset, scored, (i,)) for i in range(5)]


def answers(executor: DaskExecutor | ProcessExecutor, work: Sequence[Unit]) -> list[Answer]:
    with closing(executor.run(work)) as working:
        found = [answer for done in working for answer in done.answers]
    return sorted(found, key=lambda answer: (answer.core, answer.shot))


def test_answers_are_those_of_this_process(
    cluster: LocalCluster, cores: ModuleType, small_dataset: Path
) -> None:
    work = units(small_dataset, cores.GreyCore, seed=3)
    found = answers(DaskExecutor(cluster.scheduler_address), work)
    assert found == answers(ProcessExecutor(1), work)
    assert len({answer.packed for answer in found}) == 5


def test_a_unit_that_kills_workers_is_an_error_and_the_others_go_on(
    cluster: LocalCluster, cores: ModuleType, small_dataset: Path
) -> None:
    innocent = units(small_dataset, cores.GreyCore)
    work = [units(small_dataset, cores.GreyCore, cores.DeadlyCore)[0], *innocent[1:]]
    found = answers(DaskExecutor(cluster.scheduler_address), work)
    assert [answer for answer in found if answer.core == "GreyCore"] == answers(
        ProcessExecutor(1), innocent
    )
    (dead,) = (answer for answer in found if answer.core == "DeadlyCore")
    assert (dead.shot, dead.result.status) == (0, "error")
    assert "every worker of the cluster that was given this image died" in dead.result.reason


def test_what_a_lost_worker_was_at_is_done_by_another(
    cluster: LocalCluster, cores: ModuleType, small_dataset: Path
) -> None:
    work = units(small_dataset, cores.SlowCore)
    cluster.wait_for_workers(2, timeout=60)
    victim = next(nanny.pid for nanny in cluster.workers.values() if nanny.pid)
    found: list[Answer] = []
    with closing(DaskExecutor(cluster.scheduler_address).run(work)) as working:
        for done in working:
            if not found:
                os.kill(victim, signal.SIGKILL)
            found.extend(done.answers)
    expected = answers(ProcessExecutor(1), work)
    assert sorted(found, key=lambda answer: answer.shot) == expected


def test_closing_it_leaves_nothing_on_the_cluster(
    cluster: LocalCluster, cores: ModuleType, small_dataset: Path
) -> None:
    working = DaskExecutor(cluster.scheduler_address).run(units(small_dataset, cores.SlowCore))
    next(working)
    working.close()
    until_s = time.monotonic() + 30.0
    while cluster.scheduler.tasks and time.monotonic() < until_s:
        time.sleep(0.02)
    assert not cluster.scheduler.tasks


def test_a_mistake_of_ours_on_a_worker_is_told(
    cluster: LocalCluster, cores: ModuleType, small_dataset: Path
) -> None:
    with pytest.raises(ScoreError, match=r"tcp://.*: ZeroDivisionError: a mistake of ours"):
        answers(DaskExecutor(cluster.scheduler_address), units(small_dataset, cores.LostCore))


def test_a_worker_with_other_software_is_named(
    cluster: LocalCluster,
    cores: ModuleType,
    small_dataset: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here = cluster_module.software_here()
    monkeypatch.setattr(cluster_module, "software_here", lambda: {**here, "numpy": "0.1"})
    with pytest.raises(ScoreError, match=r"other software: numpy 2\..*, here 0\.1; install"):
        answers(DaskExecutor(cluster.scheduler_address), units(small_dataset, cores.GreyCore))


def test_a_worker_that_sees_another_dataset_is_named(
    cluster: LocalCluster,
    cores: ModuleType,
    small_dataset: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(cluster_module, "_identity", lambda path: "another")
    expected = r"worker tcp://.*dataset\.h5: is another dataset there; .*the same path"
    with pytest.raises(ScoreError, match=expected):
        answers(DaskExecutor(cluster.scheduler_address), units(small_dataset, cores.GreyCore))


def test_a_worker_that_sees_other_landmarks_says_which(tmp_path: Path) -> None:
    path = tmp_path / "landmarks.h5"
    missing = cluster_module.look_around({}, {path: "digest"}).problems
    assert [text.partition(": no such file")[0] for text in missing] == [str(path)]
    with new_database(path, DetectorSettings()) as writer:
        writer.sources.append(Source(kind="dataset", name="a.h5", identity="id", camera={}))
        rows = np.ones((60, 3)), np.ones(60), np.ones((60, 61), np.uint8)
        writer.add(RigidTransform.identity(), Landmarks(*rows), source=0)
    digest = open_database(path).digest
    assert cluster_module.look_around({}, {path: digest}).problems == ()
    (problem,) = cluster_module.look_around({}, {path: "digest"}).problems
    assert problem == f"{path}: is another database there"


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "scheduler", "tcp://no port:x"])
def test_a_scheduler_that_does_not_answer_is_told(address: str, small_dataset: Path) -> None:
    with pytest.raises(ScoreError, match=r"(?s)Dask scheduler.*dask scheduler"):
        answers(DaskExecutor(address, timeout_s=0.3), units(small_dataset))


def test_without_dask_the_extra_is_named(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ScoreError, match=r"pip install 'tronlab\[cluster\]'"):
        answers(DaskExecutor("tcp://127.0.0.1:1"), units(small_dataset))


def test_a_scheduler_without_workers_is_told(small_dataset: Path) -> None:
    with (
        LocalCluster(
            n_workers=0, processes=True, host="127.0.0.1", dashboard_address="127.0.0.1:0"
        ) as nobody,
        pytest.raises(ScoreError, match=r"has no workers; start some with: dask worker tcp://"),
    ):
        answers(DaskExecutor(nobody.scheduler_address, timeout_s=1.5), units(small_dataset))
