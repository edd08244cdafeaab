"""How much memory a step takes, its processes together."""

import ctypes
import gc
import os
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

LOOK_S: Final = 0.5
"""Between two looks at the processes."""
_PROC = Path("/proc")
_PSS = "Pss:"


@dataclass(slots=True)
class PeakMemory:
    """The most that was held at a time."""

    mb: float | None = None
    """None where the operating system does not tell."""

    def look(self) -> None:
        """Take what is held now into account."""
        held = held_mb()
        if held is not None:
            self.mb = max(held, self.mb or 0.0)


@contextmanager
def watched_memory() -> Generator[PeakMemory]:
    """Watch this process and all below it, in a thread, while this is open."""
    peak, is_over = PeakMemory(), threading.Event()
    peak.look()

    def watch() -> None:
        while not is_over.wait(LOOK_S):
            peak.look()

    thread = threading.Thread(target=watch, name="memory of a step", daemon=True)
    thread.start()
    try:
        yield peak
    finally:
        is_over.set()
        thread.join()


def held_mb() -> float | None:
    """Give the memory of this process and all below it, 1e6 bytes; None if nobody tells.

    What processes share, such as a mapped terrain model, is counted once: each has its part.
    """
    if not (_PROC / "self/smaps_rollup").exists():
        return None
    return sum(_pss_kib(pid) for pid in _with_descendants(os.getpid())) * 1024 / 1e6


def release_memory() -> None:
    """Give back what a step does not need any more, before the next one asks for it."""
    gc.collect()
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another C library has no such call
            ctypes.CDLL("libc.so.6").malloc_trim(0)


def _with_descendants(pid: int) -> list[int]:
    """Give a process and all that it and its children started."""
    found = [pid]
    for one in found:
        for tasks in (_PROC / str(one) / "task").glob("*/children"):
            with suppress(OSError):  # it has ended meanwhile
                found += map(int, tasks.read_text(encoding="ascii").split())
    return found


def _pss_kib(pid: int) -> int:
    with suppress(OSError, ValueError):  # it has ended meanwhile
        for line in (_PROC / str(pid) / "smaps_rollup").read_text(encoding="ascii").splitlines():
            if line.startswith(_PSS):
                return int(line.split()[1])
    return 0
