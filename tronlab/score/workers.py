"""Scoring many shots: in this process, or in several that each have a dataset open.

Every worker process has a pipe of its own. A pool of the standard library shares one between all,
and hangs if a worker is ended while it writes into that: a Ctrl-C would not end the scoring.
"""

import multiprocessing
import signal
from collections.abc import Generator, Iterable
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

from tronlab.errors import ScoreError, TronlabError
from tronlab.score.shot import CoreScore, ShotScorer


@dataclass(frozen=True, slots=True)
class _Worker:
    """A process that scores one shot at a time."""

    process: SpawnProcess
    connection: Connection


def score_shots(
    dataset_path: Path, core_names: tuple[str, ...], *, n_shots: int, n_workers: int
) -> Generator[tuple[int, list[CoreScore]]]:
    """Score every shot; give index and scores of each as it is done, in any order.

    Closing the iterator ends the worker processes.

    Raises:
        TronlabError: The dataset cannot be read, or a core cannot be built.
        ScoreError: A worker process died.
    """
    n_workers = min(n_workers, n_shots)
    if n_workers == 1:
        yield from _score_here(dataset_path, core_names, n_shots)
    else:
        yield from _score_in_processes(dataset_path, core_names, n_shots, n_workers=n_workers)


def _score_here(
    dataset_path: Path, core_names: tuple[str, ...], n_shots: int
) -> Generator[tuple[int, list[CoreScore]]]:
    with _one_opencv_thread(), ShotScorer(dataset_path, core_names) as scorer:
        for i in range(n_shots):
            yield i, scorer.score(i)


def _score_in_processes(
    dataset_path: Path, core_names: tuple[str, ...], n_shots: int, *, n_workers: int
) -> Generator[tuple[int, list[CoreScore]]]:
    todo = iter(range(n_shots))
    with _workers(n_workers, dataset_path, core_names) as workers:
        busy = {worker.connection: next(todo) for worker in workers}
        try:
            for connection, i in busy.items():
                connection.send(i)
            while busy:
                for connection in _ready(busy):
                    answer = connection.recv()
                    if isinstance(answer, TronlabError):
                        raise answer
                    i = busy.pop(connection)
                    if (following := next(todo, None)) is not None:
                        connection.send(following)
                        busy[connection] = following
                    yield i, answer
        except (EOFError, OSError) as error:
            raise ScoreError(
                "a worker process died: out of memory, or a core that crashed;"
                " try again with fewer workers, or one core at a time"
            ) from error


def _ready(connections: Iterable[Connection]) -> list[Connection]:
    """Wait until there is something to be read, and give the connections it is on."""
    connections = list(connections)
    ready = wait(connections)
    return [connection for connection in connections if connection in ready]


@contextmanager
def _workers(
    n_workers: int, dataset_path: Path, core_names: tuple[str, ...]
) -> Generator[list[_Worker]]:
    """Start worker processes, and end them at once when the work is done or given up."""
    workers: list[_Worker] = []
    try:
        with interrupts_held():
            for _ in range(n_workers):
                workers.append(_start_worker(dataset_path, core_names))
        yield workers
    finally:
        with interrupts_held():  # a second Ctrl-C must not leave one behind
            for worker in workers:
                worker.process.terminate()
            for worker in workers:
                worker.process.join()
                worker.connection.close()


def _start_worker(dataset_path: Path, core_names: tuple[str, ...]) -> _Worker:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs, dataset_path, core_names))
    process.start()
    theirs.close()  # so that a worker that dies is seen as the end of its pipe
    return _Worker(process, ours)


def _work(connection: Connection, dataset_path: Path, core_names: tuple[str, ...]) -> None:
    """Score the shots asked for; an error goes back as an answer, so that it arrives whole."""
    scorer: ShotScorer | None = None
    # The end of the pipe is the end of the work; if the other side is killed, at any moment.
    with _one_opencv_thread(), suppress(EOFError, ConnectionError):
        while True:
            i = connection.recv()
            try:
                scorer = scorer or ShotScorer(dataset_path, core_names)
                connection.send(scorer.score(i))
            except TronlabError as error:
                connection.send(ScoreError(str(error)))


@contextmanager
def interrupts_held() -> Generator[None]:
    """Hold Ctrl-C back for a while; processes started meanwhile inherit that and never see it."""
    held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)


@contextmanager
def _one_opencv_thread() -> Generator[None]:
    """Work as a worker process does, so that the numbers and the times are the same."""
    import cv2

    n_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(n_threads)
