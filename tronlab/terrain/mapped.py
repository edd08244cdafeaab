"""Large files of float32 as arrays, of which never much stays in this process's memory."""

import mmap
import threading
import time
import weakref
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.config import MAX_SAMPLES_IN_MEMORY

RESIDENT_BYTES = 2_000_000_000
"""When more of all files is in this process's memory, it is let go and read again when needed."""

_STATM = Path("/proc/self/statm")
_LOOKS_EVERY_S = 0.05


def map_floats(path: Path, shape: Sequence[int], *, offset: int = 0) -> NDArray[np.float32]:
    """Map a file into memory: only what is used of it is ever read.

    Compiled kernels tell read-only arrays from others, so the array is not marked as one; but it
    must not be written to: the file does not change, and the change may be lost at any time.

    Args:
        path: A file of float32 in C order.
        shape: Of the array.
        offset: Bytes before the first value.

    Raises:
        OSError: The file cannot be read, or there is no address space for it.
    """
    with path.open("rb") as file:
        mapping = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    size = int(np.prod(shape))
    if size > MAX_SAMPLES_IN_MEMORY and hasattr(mapping, "madvise") and _STATM.exists():
        _keeper.watch(mapping)
    return np.frombuffer(mapping, np.float32, size, offset).reshape(shape)


def release(mapping: mmap.mmap) -> None:
    """Take a mapped file out of this process's memory; it stays in the system's."""
    if hasattr(mapping, "madvise"):
        mapping.madvise(mmap.MADV_DONTNEED)


class _Keeper:
    """Lets go of mapped pages when there are many, from a thread that lives as long as the maps.

    The system would do so itself when memory runs out; until then pages of files in which rays
    once looked for the ground would look like memory that this process needs.
    """

    def __init__(self) -> None:
        self._mappings = weakref.WeakSet[mmap.mmap]()
        self._lock = threading.Lock()
        self._is_running = False

    def watch(self, mapping: mmap.mmap) -> None:
        with self._lock:
            self._mappings.add(mapping)
            if not self._is_running:
                self._is_running = True
                threading.Thread(target=self._run, name="mapped pages", daemon=True).start()

    def _run(self) -> None:
        while self._look():
            time.sleep(_LOOKS_EVERY_S)

    def _look(self) -> bool:
        """Let go of pages if there are too many; False if there are no maps any more."""
        with self._lock:
            mappings = list(self._mappings)
            self._is_running = bool(mappings)
        if _resident_file_bytes() > RESIDENT_BYTES:
            for mapping in mappings:
                release(mapping)
        return bool(mappings)


def _resident_file_bytes() -> int:
    """Give how much of this process's memory is mapped from files (man 5 proc, statm)."""
    return int(_STATM.read_text(encoding="ascii").split()[2]) * mmap.PAGESIZE


_keeper = _Keeper()
