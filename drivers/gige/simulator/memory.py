"""The camera's memory as an application sees it: words of 32 bits, big-endian."""

import struct
from collections.abc import Iterable
from typing import Final

from drivers.gige.simulator.bootstrap import Content
from drivers.gige.simulator.features import Access
from drivers.gige.simulator.gvcp import RefusedError, Status

WORD: Final = 4
_READABLE: Final = 1
_WRITABLE: Final = 2
_ACCESS: Final[dict[Access, int]] = {
    "RO": _READABLE,
    "WO": _WRITABLE,
    "RW": _READABLE | _WRITABLE,
}


class Memory:
    """Registers, and which of them exist, can be read and can be written."""

    def __init__(self, contents: Iterable[Content]) -> None:
        blocks = tuple(contents)
        size = max(block.address + len(block.data) for block in blocks)
        self._data = bytearray(-(-size // WORD) * WORD)
        self._access = bytearray(len(self._data) // WORD)
        for block in blocks:
            end = block.address + len(block.data)
            self._data[block.address : end] = block.data
            n = -(-len(block.data) // WORD)
            first = block.address // WORD
            self._access[first : first + n] = bytes([_ACCESS[block.access]]) * n

    def read(self, address: int, n_bytes: int) -> bytes:
        """Read for an application.

        Raises:
            RefusedError: Not whole words, not all of them exist, or one is only written.
        """
        if not all(access & _READABLE for access in self._accesses(address, n_bytes)):
            raise RefusedError(Status.ACCESS_DENIED)
        return bytes(self._data[address : address + n_bytes])

    def require_writable(self, address: int) -> None:
        """Return if an application may write that word.

        Raises:
            RefusedError: It is no word, does not exist, or is only read.
        """
        if not all(access & _WRITABLE for access in self._accesses(address, WORD)):
            raise RefusedError(Status.WRITE_PROTECTED)

    def word(self, address: int) -> int:
        """Get a word, for the camera itself."""
        return struct.unpack_from(">I", self._data, address)[0]

    def set_word(self, address: int, value: int) -> None:
        """Set a word, by the camera itself."""
        struct.pack_into(">I", self._data, address, value)

    def head(self, n_bytes: int) -> bytes:
        """Get the first bytes, for the camera itself."""
        return bytes(self._data[:n_bytes])

    def _accesses(self, address: int, n_bytes: int) -> bytes:
        """Give the access of some words that all exist."""
        if address % WORD or n_bytes % WORD:
            raise RefusedError(Status.BAD_ALIGNMENT)
        accesses = bytes(self._access[address // WORD : (address + n_bytes) // WORD])
        if not accesses or len(accesses) * WORD != n_bytes or 0 in accesses:
            raise RefusedError(Status.INVALID_ADDRESS)
        return accesses
