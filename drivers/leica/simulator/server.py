"""The simulated tracker on the network: one client at a time."""

import asyncio
import logging
import socket
import threading
from contextlib import suppress
from typing import Final

from drivers.leica.simulator import packets
from drivers.leica.simulator.codes import Command, Status
from drivers.leica.simulator.connection import Connection
from drivers.leica.simulator.faults import REFUSE_CLIENT
from drivers.leica.simulator.scene import Scene
from drivers.leica.simulator.session import Session
from drivers.leica.simulator.tracker import Machine, Tracker
from tronlab.errors import DeviceFaultError, DeviceTimeoutError, TrackingLostError
from tronlab.twin.state import Faults

_LOG = logging.getLogger(__name__)
_LAST_WORDS_S: Final = 1.0
_CLEARING_S: Final = 0.1
"""A client that has just gone may not be noticed yet when the next one comes."""


class TrackerServer:
    """A simulated AT901-MR that listens; it has a thread of its own until it is closed.

    Args:
        scene: What stands before the tracker.
        faults: Those of ``FAULTS`` that it shall have.
        host: Address to listen at.
        port: Likewise; 0 for any free one.
        machine: How fast and how well adjusted it is.

    Raises:
        OSError: It cannot listen there.
    """

    def __init__(
        self,
        scene: Scene,
        faults: Faults,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        machine: Machine | None = None,
    ) -> None:
        self.tracker = Tracker(scene, faults, machine or Machine())
        self._faults = faults
        self._listener = socket.create_server((host, port))
        self._listener.setblocking(False)
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        """Host and port."""
        self._seat = asyncio.Lock()
        """Of the one client."""
        self._writers: set[asyncio.StreamWriter] = set()
        """To every client."""
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="simulated tracker", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Hang up and stop listening; may be called twice."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join()

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        """Meet clients until told to stop; then hang up on all of them."""
        loop = asyncio.get_running_loop()
        async with asyncio.TaskGroup() as meetings:
            loop.add_reader(self._listener, self._accept, meetings)
            await self._stop.wait()
            loop.remove_reader(self._listener)
            self._listener.close()
            for writer in self._writers:
                writer.close()

    def _accept(self, meetings: asyncio.TaskGroup) -> None:
        with suppress(BlockingIOError, ConnectionAbortedError):
            client, _ = self._listener.accept()
            meetings.create_task(self._meet(client))

    async def _meet(self, client: socket.socket) -> None:
        """Serve one client, whatever happens: the next one finds a tracker."""
        try:
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            reader, writer = await asyncio.open_connection(sock=client)
        except OSError:
            client.close()
            return
        self._writers.add(writer)
        try:
            if not self._stop.is_set():
                await self._admit(reader, writer)
        except OSError:
            _LOG.debug("the client has gone", exc_info=True)
        except Exception:
            _LOG.exception("the client is dropped")
        finally:
            self._writers.discard(writer)
            writer.close()
            with suppress(OSError):
                await writer.wait_closed()

    async def _admit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._faults.strike(REFUSE_CLIENT):
            await _turn_away(reader, writer, Status.ONE_CONNECTION_ONLY)
            return
        try:
            async with asyncio.timeout(_CLEARING_S):
                await self._seat.acquire()
        except TimeoutError:
            await _turn_away(reader, writer, Status.ONE_CONNECTION_ONLY)
            return
        try:
            await self._serve_client(reader, writer)
        finally:
            self._seat.release()

    async def _serve_client(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Serve the client, unless the scene's script has other plans with it."""
        try:
            self.tracker.scene.begin("connect")
        except DeviceTimeoutError:
            await _ignore(reader)
        except TrackingLostError:
            await _turn_away(reader, writer, Status.BEAM_BROKEN)
        except DeviceFaultError as fault:
            await _turn_away(reader, writer, fault.code)
        else:
            connection = Connection(reader, writer, self._faults)
            await Session(connection, self.tracker, self._faults).run()


async def _turn_away(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, status: int
) -> None:
    """Say why, then wait for the client to go: closed at once, the words might be lost."""
    writer.write(packets.error(Command.UNKNOWN, status))
    await writer.drain()
    writer.write_eof()
    with suppress(TimeoutError):
        async with asyncio.timeout(_LAST_WORDS_S):
            await _ignore(reader)


async def _ignore(reader: asyncio.StreamReader) -> None:
    while await reader.read(packets.MOST_BYTES):
        pass
