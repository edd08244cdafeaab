"""Scoring on a Dask cluster: two workers against one, beside worker processes without Dask.

    python benchmarks/cluster.py DATASET [--shots 60] [--core akaze-refined --core brisk-refined]
                                         [--rounds 3]

Starts two clusters on this computer, of one worker and of two, and scores the first shots of the
dataset on each in turns, without a cache. A first round, in which workers open the dataset and make
the databases of the cores, is told apart. Processes without Dask score the same shots in the same
turns; they begin anew each round, and one is this process itself. Prints the median of the rounds,
and how many times faster two are than one. It takes two processors that are free: the client and
the scheduler work as well.
"""

import argparse
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from distributed import LocalCluster
from rich.console import Console
from rich.table import Table

from tronlab.nav.specs import parse_cores
from tronlab.score.rescoring.cluster import DaskExecutor
from tronlab.score.rescoring.job import ScoreJob, Scoring
from tronlab.score.rescoring.unit import Unit
from tronlab.score.rescoring.workers import Executor, ProcessExecutor

CORES = ("akaze-refined", "brisk-refined")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--shots", type=int, default=60)
    parser.add_argument("--core", action="append")
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    units = units_of(arguments.dataset, arguments.core or CORES)[: arguments.shots]
    print(f"{len(units)} shots of {arguments.dataset}")
    with ExitStack() as stack:
        clusters = [stack.enter_context(local_cluster(n)) for n in (1, 2)]
        on_dask = [DaskExecutor(cluster.scheduler_address) for cluster in clusters]
        here = [ProcessExecutor(n) for n in (1, 2)]
        first_s = [took_s(executor, units) for executor in on_dask]
        rounds_s = np.array(
            [
                [took_s(executor, units) for executor in (*on_dask, *here)]
                for _ in range(arguments.rounds)
            ]
        )
    table = Table("", "1 worker [s]", "2 workers [s]", "2 are faster by")
    dask_s, here_s = np.median(rounds_s, axis=0).reshape(2, 2)
    for name, (one_s, two_s) in (
        ("Dask, first round", first_s),
        ("Dask", dask_s),
        ("processes, begun anew", here_s),
    ):
        table.add_row(name, f"{one_s:.2f}", f"{two_s:.2f}", f"{one_s / two_s:.2f}")
    Console().print(table)


def units_of(dataset: Path, cores: Sequence[str]) -> list[Unit]:
    with TemporaryDirectory() as folder:
        job = ScoreJob(dataset, parse_cores(cores), Path(folder))
        return Scoring(job, 0, announce=print).units()


def local_cluster(n_workers: int) -> LocalCluster:
    return LocalCluster(
        n_workers=n_workers,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
    )


def took_s(executor: Executor, units: Sequence[Unit]) -> float:
    start_s = time.perf_counter()
    with closing(executor.run(units)) as working:
        n_answers = sum(len(done.answers) for done in working)
    assert n_answers == sum(unit.n_answers for unit in units)
    return time.perf_counter() - start_s


if __name__ == "__main__":
    main()
