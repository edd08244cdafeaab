"""How compiled kernels are made and run.

Kernels release the interpreter lock and are run by plain threads, each on every n-th part of the
work. numba's own parallel loops would be as fast, but their thread pool is one for the whole
process: it breaks after a fork and when two threads use it at once.
"""

import logging
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

from numba import njit

logger = logging.getLogger(__name__)


_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
# Without numba's counting of references: handing on a tuple of arrays would cost several atomic
# operations an array and call, most of the time of a ray, more than comparing two descriptors.
_NO_ARRAYS: dict[str, Any] = {**_OPTIONS, "_nrt": False}

_MATCHING_SOURCES = ("nav/matching/*.py", "terrain/kernels.py")
_RENDERING_SOURCES = ("terrain/**/*.py", "render/**/*.py")


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function at its first call and keep the machine code on disk where possible.

    The code is cached beside the source or, where that is read-only, in the user's cache folder.
    Without a writable folder it is compiled anew in each process.
    """
    return _kept(function, _OPTIONS)


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Do what ``compiled`` does, for a function that makes no arrays: its calls cost less."""
    return _kept(function, _NO_ARRAYS)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function into each kernel that calls it: that saves copying its arguments."""
    return njit(forceinline=True, **_NO_ARRAYS)(function)


def _kept(function: Callable[..., Any], options: Mapping[str, Any]) -> Callable[..., Any]:
    try:
        kept: Any = njit(cache=True, **options)(function)
    except RuntimeError:
        return njit(**options)(function)
    # By itself numba compiles anew only when the kernel's own file has changed, not when another
    # one has that it calls into.
    is_of_matching = function.__module__.startswith("tronlab.nav.")
    sources = _MATCHING_SOURCES if is_of_matching else _RENDERING_SOURCES
    kept._cache._cache_file._source_stamp = _stamp(sources)  # noqa: SLF001
    return kept


@cache
def _stamp(patterns: tuple[str, ...]) -> tuple[tuple[int, int], ...]:
    """Give time and size of every file that may hold a kernel."""
    package = Path(__file__).parent.parent
    files = sorted(path for pattern in patterns for path in package.glob(pattern))
    return tuple((info.st_mtime_ns, info.st_size) for info in map(Path.stat, files))


def n_cores() -> int:
    """Give the number of processor cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_interleaved(kernel: Callable[..., Any], *arguments: Any, n_threads: int) -> None:
    """Run ``kernel(*arguments, first, step)`` for first = 0 .. step - 1, in threads.

    There are more parts than threads, so that a thread with easy parts takes over from others.
    """
    if not getattr(kernel, "signatures", True):
        logger.info("preparing %s (its first use ever takes some seconds)", kernel.__name__)
    n_parts = 8 * n_threads if n_threads > 1 else 1
    with ThreadPoolExecutor(n_threads) as pool:
        futures = [pool.submit(kernel, *arguments, part, n_parts) for part in range(n_parts)]
        for future in futures:
            future.result()
