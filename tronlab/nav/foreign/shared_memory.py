"""Memory that a program on this machine maps, so that images need not travel."""

import mmap
import os
import sys
from collections.abc import Mapping
from contextlib import suppress

import numpy as np

from tronlab.nav.foreign.messages import AnyArray, Buffer, describe_part, wire_array

_ALIGNMENT = 64
IS_POSSIBLE = sys.platform == "linux"


class SharedFrame:
    """Room for the arrays of one frame.

    The memory has no name in any folder (memfd_create(2)): it is reached through this process's
    open file and is gone with the last process that maps it, however both end. Its size is sealed,
    for a program that cut it short would take us down with a bus error.
    """

    def __init__(self, size: int) -> None:
        """Make it.

        Raises:
            OSError: There is no such memory here, or no more of it.
        """
        import fcntl  # not everywhere

        self.size = size
        self._fd = os.memfd_create("tronlab-frame", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        try:
            os.posix_fallocate(self._fd, 0, size)
            seals = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL
            fcntl.fcntl(self._fd, fcntl.F_ADD_SEALS, seals)
            self._memory = mmap.mmap(self._fd, size)
        except BaseException:
            os.close(self._fd)
            raise

    @property
    def path(self) -> str:
        """Get what a program of the same user opens."""
        return f"/proc/{os.getpid()}/fd/{self._fd}"

    def put(self, arrays: Mapping[str, AnyArray]) -> list[object] | None:
        """Write the arrays of a frame; give their entries in ``parts``, or None if too large."""
        entries: list[object] = []
        end = 0
        for name, array in arrays.items():
            wire = wire_array(array)
            begin = end + -end % _ALIGNMENT
            end = begin + wire.nbytes
            if end > self.size:
                return None
            room = np.frombuffer(self._memory, wire.dtype, wire.size, begin).reshape(wire.shape)
            np.copyto(room, wire)
            entries.append(describe_part(name, wire, offset=begin, where="shared_memory"))
        return entries

    def close(self) -> None:
        """Let go of it; a program that still maps it keeps its own hold."""
        with suppress(BufferError):
            self._memory.close()
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class MappedFrame:
    """The same memory as the core sees it, to be read only."""

    def __init__(self, path: str, size: int) -> None:
        """Map it.

        Raises:
            OSError: It cannot be opened.
            ValueError: It is not that large.
        """
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            self._memory = mmap.mmap(fd, size, prot=mmap.PROT_READ)
        finally:
            os.close(fd)

    @property
    def data(self) -> Buffer:
        """Get the bytes; they change with every frame."""
        return memoryview(self._memory)


def room_for(shape: tuple[int, int]) -> int:
    """Give the bytes that an image of 16 bit and its mask take."""
    n_pixels = shape[0] * shape[1]
    return 2 * n_pixels + -(2 * n_pixels) % _ALIGNMENT + n_pixels
