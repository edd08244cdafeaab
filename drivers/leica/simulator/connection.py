"""One client's connection: whole requests in, whole packets out."""

import asyncio
import struct
from typing import Final

import numpy as np

from drivers.leica.simulator.faults import SPLIT
from drivers.leica.simulator.packets import MOST_BYTES, SIZE_BYTES
from tronlab.twin.state import Faults

_SMALLEST_REQUEST: Final = 12
_MOST_PACKETS_WAITING: Final = 10_000
_LONGEST_PIECE: Final = 7


class HangUpError(Exception):
    """The connection is over."""


class Connection:
    """Packets of one client, in the order they are sent."""

    def __init__(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, faults: Faults
    ) -> None:
        self._reader = reader
        self._writer = writer
        self._faults = faults
        self._waiting: asyncio.Queue[bytes] = asyncio.Queue()
        self._piece_sizes = np.random.default_rng(0)

    async def receive(self) -> bytes:
        """Wait for the next request, however it is split, and give all of it.

        Raises:
            HangUpError: The client has gone, or what it sent is no packet.
        """
        try:
            head = await self._reader.readexactly(SIZE_BYTES)
            (size,) = struct.unpack("<i", head)
            if not _SMALLEST_REQUEST <= size <= MOST_BYTES:
                raise HangUpError(f"size {size}, allowed {_SMALLEST_REQUEST} to {MOST_BYTES}")
            return head + await self._reader.readexactly(size - SIZE_BYTES)
        except (asyncio.IncompleteReadError, OSError) as error:
            raise HangUpError("the client has gone") from error

    def send(self, packet: bytes) -> None:
        """Send a packet soon.

        Raises:
            HangUpError: The client has not read for long.
        """
        if self._waiting.qsize() >= _MOST_PACKETS_WAITING:
            raise HangUpError("the client does not read")
        self._waiting.put_nowait(packet)

    async def pump(self) -> None:
        """Write what is to be sent, for ever.

        Raises:
            HangUpError: The client has gone.
        """
        while True:
            packet = await self._waiting.get()
            try:
                for piece in self._pieces(packet):
                    self._writer.write(piece)
                    await self._writer.drain()
            except OSError as error:
                raise HangUpError("the client has gone") from error
            finally:
                self._waiting.task_done()

    async def flush(self) -> None:
        """Wait until everything is written."""
        await self._waiting.join()

    def _pieces(self, packet: bytes) -> list[bytes]:
        if not self._faults.is_armed(SPLIT):
            return [packet]
        sizes = self._piece_sizes.integers(1, _LONGEST_PIECE, len(packet), endpoint=True)
        ends = np.cumsum(sizes)
        starts = ends - sizes
        return [packet[a:b] for a, b in zip(starts, ends, strict=True) if a < len(packet)]
