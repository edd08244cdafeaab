"""The connection to a tracker controller: one command at a time, and all that comes in between.

Replies carry no number of their own, only their command's. So there is never a second command
before the reply to the first, and a connection whose reply is overdue is closed: nothing that
comes too late can be taken for the answer to a later command.
"""

import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Generator
from contextlib import contextmanager, suppress
from typing import Final, NoReturn, TypeVar

from drivers.leica import status as statuses
from drivers.leica.codes import Command, Event, PacketType, event_text
from drivers.leica.notices import Notice
from drivers.leica.packets import Packet, PacketBuffer, encode_request
from drivers.leica.wire import decode
from tronlab.errors import (
    AccessDeniedError,
    DeviceError,
    DeviceFaultError,
    DeviceTimeoutError,
    NotConnectedError,
    ProtocolError,
    TrackingLostError,
)

T = TypeVar("T")

_RESULTS: Final = frozenset(
    {PacketType.POINT, PacketType.POINT_EXTENDED, PacketType.POSE, PacketType.POSE_STREAM}
)
_SLICE_S: Final = 0.05
"""How long a wait for a result may overlook that it shall stop."""
_CHUNK: Final = 65536
_MOST_SHOWN: Final = 64
"""Bytes of nonsense that an error shows."""


class Connection:
    """A TCP connection to a tracker controller. Not for two threads at once, but ``interrupt``.

    Args:
        device: Name of the device, for errors.
        timeout_s: For an answer, where none is given.
        on_notice: Is told what the tracker says without being asked.
    """

    def __init__(
        self, *, device: str, timeout_s: float, on_notice: Callable[[Notice], None]
    ) -> None:
        self.call = "connect"
        """What the driver is doing; error messages begin with it."""
        self._device = device
        self._timeout_s = timeout_s
        self._on_notice = on_notice
        self._socket: socket.socket | None = None
        self._buffer = PacketBuffer()
        self._results: deque[Packet] = deque()
        self._error: int | None = None
        self._sent = b""
        self._was_answered = False
        self._interrupted = threading.Event()

    @property
    def is_open(self) -> bool:
        """Get whether there is a connection, as far as is known."""
        return self._socket is not None

    def open(self, host: str, port: int) -> None:
        """Connect.

        Raises:
            NotConnectedError: Nobody answers there.
        """
        self.close()
        where = f"{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), timeout=self._timeout_s)
        except OSError as error:
            reason = error.strerror or str(error) or type(error).__name__
            raise NotConnectedError(
                f"{self.call}: {where} cannot be reached: {reason}; check cable, address and that"
                " the controller runs",
                device=self._device,
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._buffer = PacketBuffer()
        self._was_answered = False
        self._forget()
        self.resume()

    def close(self) -> None:
        """Disconnect; nothing happens if there is no connection."""
        if self._socket is not None:
            with suppress(OSError):
                self._socket.close()
        self._socket = None

    def exchange(self, command: Command, *values: float, timeout_s: float | None = None) -> Packet:
        """Send a command and wait for its reply.

        Raises:
            DeviceError: No reply, or one whose status is not good; by ``status.error_of``.
        """
        with self._until_answered():
            deadline_s = self._send(command, values, timeout_s)
            return self._reply(command, deadline_s)

    def ask(self, layout: type[T], command: Command, *, timeout_s: float | None = None) -> T:
        """Send a question and read its answer."""
        return self.read(layout, self.exchange(command, timeout_s=timeout_s))

    def ask_list(self, layout: type[T], command: Command) -> tuple[T, ...]:
        """Send a question that is answered by one reply an entry, each with the number of all.

        An empty list is one reply that says so.
        """
        with self._until_answered():
            deadline_s = self._send(command, (), None)
            first = self._reply(command, deadline_s)
            n_all = int.from_bytes(first.body[:4], "little", signed=True)
            if n_all <= 0:
                return ()
            entries = [self.read(layout, first)]
            try:
                while len(entries) < n_all:
                    entries.append(self.read(layout, self._reply(command, deadline_s)))
            except DeviceError:
                self.close()  # what is left of the list would come while the next command waits
                raise
        return tuple(entries)

    def check_open(self) -> None:
        """Return if there is a connection, as far as is known.

        Raises:
            NotConnectedError: There is none.
        """
        self._connected()

    def drain(self) -> None:
        """Take in what has come since the last command, without waiting.

        Raises:
            NotConnectedError: The tracker has closed the connection.
        """
        while (packet := self._receive(time.monotonic())) is not None:
            self._take(packet)

    def wait(self, duration_s: float) -> None:
        """Take in what comes during a time."""
        end_s = time.monotonic() + duration_s
        while (packet := self._receive(end_s)) is not None:
            self._take(packet)

    def begin_measurement(self) -> None:
        """Forget results and errors of earlier measurements.

        Raises:
            DeviceError: ``interrupt`` came first.
        """
        self.drain()
        self._forget()
        if self._interrupted.is_set():
            raise self._stopped()

    def _forget(self) -> None:
        self._results.clear()
        self._error = None

    def result(self, *, timeout_s: float, fatal_events: Collection[Event] = ()) -> Packet:
        """Wait for the next result of the measurement that runs.

        Raises:
            TrackingLostError: The beam broke, or one of ``fatal_events`` came.
            DeviceError: Another error of the tracker; no result; or ``interrupt``.
        """
        deadline_s = time.monotonic() + timeout_s
        while True:
            if self._error is not None:
                self._abandon(statuses.error_of(self._error, self.call, device=self._device))
            if self._results:
                return self._good(self._results.popleft())
            if self._interrupted.is_set():
                self._abandon(self._stopped())
            packet = self._receive(min(deadline_s, time.monotonic() + _SLICE_S))
            if packet is None:
                if time.monotonic() >= deadline_s:
                    self._time_out("result", timeout_s)
                continue
            self._take(packet)
            if packet.type == PacketType.EVENT and packet.event in fatal_events:
                self._abandon(
                    TrackingLostError(
                        f"{self.call}: the tracker says '{event_text(packet.event)}' (event"
                        f" {packet.event}); check that the target faces the tracker",
                        device=self._device,
                    )
                )

    def read(self, layout: type[T], packet: Packet) -> T:
        """Read the body of a reply or a result."""
        return self.read_by(lambda body: decode(layout, body), packet)

    def read_by(self, read: Callable[[bytes], T], packet: Packet) -> T:
        """Read the body of a reply or a result; ``read`` raises ValueError if it cannot.

        Raises:
            ProtocolError: It is not what it should be; the connection is closed.
        """
        try:
            return read(packet.body)
        except ValueError as error:
            self._fail(str(error), packet.data)

    def refuse(self, problem: str, packet: Packet) -> NoReturn:
        """Raise the error of a packet that is well formed and yet cannot be."""
        raise ProtocolError(
            f"{self.call}: {problem}", device=self._device, sent=self._sent, received=packet.data
        )

    def interrupt(self) -> None:
        """End the measurement that another thread waits for; none begins until ``resume``."""
        self._interrupted.set()

    def resume(self) -> None:
        """Let measurements begin again."""
        self._interrupted.clear()

    @contextmanager
    def _until_answered(self) -> Generator[None]:
        """Close the connection if the wait for an answer ends without one: it would come later."""
        try:
            yield
        except DeviceError:
            raise  # answered, or closed already
        except BaseException:
            self.close()
            raise

    def _send(self, command: Command, values: tuple[float, ...], timeout_s: float | None) -> float:
        self.drain()
        self._sent = encode_request(command, *values)
        timeout_s = self._timeout_s if timeout_s is None else timeout_s
        sock = self._connected()
        sock.settimeout(timeout_s)
        try:
            sock.sendall(self._sent)
        except TimeoutError:
            self._time_out(command.title, timeout_s)
        except OSError as error:
            self._lose(error.strerror or str(error))
        return time.monotonic() + timeout_s

    def _reply(self, command: Command, deadline_s: float) -> Packet:
        while True:
            packet = self._receive(deadline_s)
            if packet is None:
                self._time_out(f"answer to {command.title}")
            if packet.type not in {PacketType.COMMAND, PacketType.ERROR}:
                self._take(packet)
            elif packet.command == command:
                self._was_answered = True
                return self._good(packet, of=command)
            else:
                self._take(packet)

    def _take(self, packet: Packet) -> None:
        """Deal with a packet that is not the reply waited for; pass over those of unknown type."""
        if packet.type == PacketType.EVENT:
            self._on_notice(Notice.of_event(packet.event))
        elif packet.type == PacketType.ERROR:
            self._take_error(packet)
        elif packet.type in _RESULTS:
            self._results.append(packet)
        elif packet.type == PacketType.COMMAND:
            self._fail(f"a reply to command {packet.command}, which was not sent", packet.data)

    def _take_error(self, packet: Packet) -> None:
        if packet.status == statuses.REFUSED_CONNECTION:
            self.close()
            raise statuses.error_of(packet.status, self.call, device=self._device)
        self._error = packet.status
        self._on_notice(Notice.of_error(packet.status))

    def _good(self, packet: Packet, *, of: Command | None = None) -> Packet:
        if packet.type == PacketType.ERROR or packet.status != statuses.OK:
            call = self.call if of is None else f"{self.call}: {of.title}"
            error = statuses.error_of(packet.status, call, device=self._device)
            if isinstance(error, NotConnectedError):
                self.close()
            raise error
        return packet

    def _receive(self, deadline_s: float) -> Packet | None:
        """Give the next packet; None when the time is up."""
        sock = self._connected()
        while True:
            try:
                packet = self._buffer.pop()
            except ValueError as error:
                self._fail(str(error), self._buffer.pending[:_MOST_SHOWN])
            if packet is not None:
                return packet
            sock.settimeout(max(0.0, deadline_s - time.monotonic()))
            try:
                data = sock.recv(_CHUNK)
            except (TimeoutError, BlockingIOError):
                return None
            except OSError as error:
                self._lose(error.strerror or str(error))
            if not data:
                self._lose("the tracker closed the connection")
            self._buffer.feed(data)

    def _connected(self) -> socket.socket:
        if self._socket is None:
            raise NotConnectedError(
                f"{self.call}: not connected; call connect() first", device=self._device
            )
        return self._socket

    def _stopped(self) -> DeviceError:
        return DeviceError(f"{self.call}: stopped by stop() or close()", device=self._device)

    def _abandon(self, error: DeviceError) -> NoReturn:
        """Stop the measurement, so that nothing of it comes later, and raise."""
        with suppress(DeviceFaultError):  # there may be nothing left to stop
            self.exchange(Command.STOP_MEASUREMENT)
        raise error

    def _time_out(self, what: str, timeout_s: float | None = None) -> NoReturn:
        self.close()
        within = "in time" if timeout_s is None else f"within {timeout_s:g} s"
        raise DeviceTimeoutError(
            f"{self.call}: no {what} {within}; the connection is closed", device=self._device
        )

    def _lose(self, reason: str) -> NoReturn:
        self.close()
        if self._was_answered:
            raise NotConnectedError(f"{self.call}: connection lost: {reason}", device=self._device)
        raise AccessDeniedError(
            f"{self.call}: the tracker closed the connection at once ({reason}): another client may"
            " hold it; close the other program",
            device=self._device,
        )

    def _fail(self, problem: str, received: bytes) -> NoReturn:
        """Give up a connection whose bytes make no sense."""
        self.close()
        raise ProtocolError(
            f"{self.call}: {problem}", device=self._device, sent=self._sent, received=received
        )
