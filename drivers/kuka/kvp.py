"""KUKAVARPROXY and C3 Bridge on the wire: variables of the controller are read and written by name.

Big-endian. A message is u16 tag, u16 length of what follows, u8 kind, then texts with a u16 length
before each; a reply ends in u16 error code and u8 success (C3 Bridge Interface Protocol 1.5,
KUKAVARPROXY). KUKAVARPROXY drops clients that were silent for 30 s.
"""

import socket
import struct
import threading
import time
from dataclasses import dataclass
from typing import Final

from drivers.kuka.connection import open_connection, shut
from tronlab.errors import (
    DeviceFaultError,
    DeviceTimeoutError,
    NotConnectedError,
    ProtocolError,
)

READ: Final = 0
WRITE: Final = 1
IDLE_S: Final = 25.0
"""After a silence as long as this the server may be about to hang up."""

_HEADER = struct.Struct(">HH")
_REPLY_HEAD = struct.Struct(">BH")
_FOOTER = struct.Struct(">HB")
_ERRORS = {
    0: "general error",
    2: "access denied",
    3: "bad argument",
    4: "out of memory",
    5: "bad pointer",
    6: "unexpected",
    7: "not implemented",
    8: "no interface",
    9: "protocol error",
    10: "answer too long",
}


@dataclass(frozen=True, slots=True)
class Reply:
    """One reply of the server."""

    tag: int
    kind: int
    value: str
    code: int
    """Of the C3 Bridge; KUKAVARPROXY leaves it 0 or 1."""
    is_success: bool


def read_request(tag: int, name: str) -> bytes:
    """Write the request to read a variable."""
    return _request(tag, READ, name)


def write_request(tag: int, name: str, value: str) -> bytes:
    """Write the request to set a variable."""
    return _request(tag, WRITE, name, value)


def decode_reply(message: bytes) -> Reply:
    """Read one whole reply.

    Raises:
        ValueError: Its lengths contradict each other.
    """
    tag, _ = _HEADER.unpack_from(message)
    body = message[_HEADER.size :]
    if len(body) < _REPLY_HEAD.size + _FOOTER.size:
        raise ValueError(f"has {len(body)} bytes after its header, expected 6 or more")
    kind, n_chars = _REPLY_HEAD.unpack_from(body)
    value = body[_REPLY_HEAD.size : -_FOOTER.size]
    if len(value) != n_chars:
        raise ValueError(f"has a value of {len(value)} bytes, but says {n_chars}")
    code, success = _FOOTER.unpack(body[-_FOOTER.size :])
    return Reply(tag, kind, value.decode("latin-1"), code, success != 0)


class KvpClient:
    """A client with one request at a time; several threads may use it."""

    def __init__(
        self, host: str, port: int, *, timeout_s: float, device: str, idle_s: float = IDLE_S
    ) -> None:
        self._host = host
        self._port = port
        self._timeout_s = timeout_s
        self._device = device
        self._idle_s = idle_s
        self._lock = threading.Lock()
        self._connection: socket.socket | None = None
        self._received = b""
        self._unanswered: set[int] = set()
        self._tag = 0
        self._last_use_s = 0.0

    def connect(self, *, call: str) -> None:
        """Open the connection.

        Raises:
            NotConnectedError: Nobody answers there.
        """
        with self._lock:
            self._disconnect()
            self._open(call)

    def close(self) -> None:
        """Close the connection."""
        with self._lock:
            self._disconnect()

    def read(self, name: str, *, call: str) -> str:
        """Read a variable.

        Raises:
            ProtocolError: The answer is empty: there is no such variable.
        """
        request, reply = self._ask(READ, name, None, call)
        if not reply.value.strip():
            raise ProtocolError(
                f"{call}: {name} has no value; is it declared? (drivers/kuka/README.md, set-up)",
                device=self._device,
                sent=request,
                received=b"",
            )
        return reply.value

    def write(self, name: str, value: str, *, call: str) -> None:
        """Set a variable."""
        self._ask(WRITE, name, value, call)

    def _ask(self, kind: int, name: str, value: str | None, call: str) -> tuple[bytes, Reply]:
        with self._lock:
            if self._connection is None:
                raise NotConnectedError(
                    f"{call}: not connected; call connect() first", device=self._device
                )
            if time.monotonic() - self._last_use_s > self._idle_s:
                self._disconnect()
                self._open(call)
            self._tag = (self._tag + 1) % 0x10000
            request = (
                read_request(self._tag, name)
                if value is None
                else write_request(self._tag, name, value)
            )
            reply = self._exchange(request, kind, f"{call}: {name}")
        if not reply.is_success:
            what = _ERRORS.get(reply.code, "an unknown error")
            raise DeviceFaultError(
                f"{call}: the controller refuses to {'read' if kind == READ else 'write'}"
                f" {name}: {what}",
                device=self._device,
                code=reply.code,
            )
        return request, reply

    def _exchange(self, request: bytes, kind: int, what: str) -> Reply:
        give_up_s = time.monotonic() + self._timeout_s
        self._unanswered.add(self._tag)
        try:
            self._open_connection.sendall(request)
            while True:
                message = self._receive(give_up_s)
                reply = self._decode(request, message, what)
                is_late = reply.tag in self._unanswered and reply.tag != self._tag
                self._unanswered.discard(reply.tag)
                if reply.tag == self._tag and reply.kind == kind:
                    self._last_use_s = time.monotonic()
                    return reply
                if not is_late:
                    raise self._protocol_error(f"{what}: answer to no question", request, message)
        except TimeoutError as error:
            raise DeviceTimeoutError(
                f"{what}: no answer in {self._timeout_s:g} s", device=self._device
            ) from error
        except OSError as error:
            self._disconnect()
            raise NotConnectedError(
                f"{what}: the connection is lost ({error})", device=self._device
            ) from error

    def _decode(self, request: bytes, message: bytes, what: str) -> Reply:
        try:
            return decode_reply(message)
        except ValueError as error:
            raise self._protocol_error(f"{what}: the answer {error}", request, message) from None

    def _receive(self, give_up_s: float) -> bytes:
        """Wait for one whole message, however TCP has split or joined it."""
        while True:
            if len(self._received) >= _HEADER.size:
                end = _HEADER.size + _HEADER.unpack_from(self._received)[1]
                if len(self._received) >= end:
                    message, self._received = self._received[:end], self._received[end:]
                    return message
            connection = self._open_connection
            connection.settimeout(max(give_up_s - time.monotonic(), 1e-3))
            chunk = connection.recv(65_536)
            if not chunk:
                raise ConnectionResetError("closed by the controller")
            self._received += chunk

    @property
    def _open_connection(self) -> socket.socket:
        if self._connection is None:
            raise ConnectionResetError("closed here")
        return self._connection

    def _open(self, call: str) -> None:
        self._connection = open_connection(
            self._host, self._port, timeout_s=self._timeout_s, device=self._device, call=call
        )
        self._received = b""
        self._unanswered.clear()
        self._last_use_s = time.monotonic()

    def _disconnect(self) -> None:
        if self._connection is not None:
            shut(self._connection)
            self._connection = None

    def _protocol_error(self, what: str, sent: bytes, received: bytes) -> ProtocolError:
        return ProtocolError(what, device=self._device, sent=sent, received=received)


def _request(tag: int, kind: int, *texts: str) -> bytes:
    body = bytes([kind])
    for text in texts:
        encoded = text.encode("ascii")
        body += struct.pack(">H", len(encoded)) + encoded
    return _HEADER.pack(tag, len(body)) + body
