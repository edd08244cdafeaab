"""Scoring many shots: in this process, or in several that each have a dataset open."""

import multiprocessing
import signal
from collections.abc import Generator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path

from tronlab.errors import ScoreError, TronlabError
from tronlab.score.shot import CoreScore, ShotScorer

_scorers: dict[tuple[Path, tuple[str, ...]], ShotScorer] = {}
"""The scorer of this worker process, built by its first shot."""


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
    with _pool(n_workers) as pool:
        try:
            with interrupts_held():
                futures = {
                    pool.submit(_score_in_worker, dataset_path, core_names, i): i
                    for i in range(n_shots)
                }
            for future in as_completed(futures):
                answer = future.result()
                if isinstance(answer, TronlabError):
                    raise answer
                yield futures[future], answer
        except BrokenProcessPool as error:
            raise ScoreError(
                "a worker process died: out of memory, or a core that crashed;"
                " try again with fewer workers, or one core at a time"
            ) from error


def _score_in_worker(
    dataset_path: Path, core_names: tuple[str, ...], i: int
) -> list[CoreScore] | TronlabError:
    """Score one shot in a worker; an error comes back as an answer, so that it arrives whole."""
    key = (dataset_path, core_names)
    try:
        if key not in _scorers:
            _scorers[key] = ShotScorer(dataset_path, core_names)
        return _scorers[key].score(i)
    except TronlabError as error:
        return ScoreError(str(error))


def _start_worker() -> None:
    import cv2

    cv2.setNumThreads(1)


@contextmanager
def _pool(n_workers: int) -> Generator[ProcessPoolExecutor]:
    """Open worker processes, and end them at once when the work is done or given up."""
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        n_workers, mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker
    )
    try:
        yield pool
    except BaseException:
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


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
