"""KUKAVARPROXY and C3 Bridge on the wire: a server of variables by name, TCP 7000.

Bytes are big-endian, C3's wide text UTF-16LE: C3 Bridge Interface Protocol 1.5. What only one of
the two does is here too: KUKAVARPROXY's ten clients and patience of 30 s, C3's further messages.
Nothing of it moves the robot but variables: C3's own motion commands are not implemented.
"""

import socket
import struct
import sys
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Final

from drivers.kuka.simulator import faults as f
from drivers.kuka.simulator.controller import Controller
from drivers.kuka.simulator.tcp import Server, send
from drivers.kuka.simulator.variables import ReadOnlyError, Variables
from tronlab.errors import TronlabError
from tronlab.twin.state import Faults

MAX_CLIENTS: Final = 10
IDLE_S: Final = 30.0

_SUBMIT_INTERPRETER: Final = 0


class MessageType(IntEnum):
    """What a request asks for."""

    READ_ASCII = 0
    WRITE_ASCII = 1
    READ = 4
    WRITE = 5
    READ_MULTIPLE = 6
    WRITE_MULTIPLE = 7
    PROGRAM_CONTROL = 10
    CONFIRM_ALL = 63


class ErrorCode(IntEnum):
    """What the footer of a reply says."""

    GENERAL = 0
    SUCCESS = 1
    ACCESS = 2
    ARGUMENT = 3
    NOT_IMPLEMENTED = 7
    PROTOCOL = 9
    LONG_ANSWER = 10


class KvpServer:
    """A server of a controller's variables; runs until closed.

    Args:
        controller: The robot.
        faults: What is armed.
        host: Address to listen at.
        port: Port; 0 for any free one.
        idle_s: A client that says nothing for so long is closed.
        max_clients: How many are served at once.
    """

    def __init__(
        self,
        controller: Controller,
        faults: Faults,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        idle_s: float = IDLE_S,
        max_clients: int = MAX_CLIENTS,
    ) -> None:
        self._controller = controller
        self._variables = Variables(controller)
        self._faults = faults
        self._idle_s = idle_s
        self._answers: Mapping[int, Callable[[_Request], bytes]] = {
            MessageType.READ_ASCII: lambda request: self._read(request, _ASCII),
            MessageType.WRITE_ASCII: lambda request: self._write(request, _ASCII),
            MessageType.READ: lambda request: self._read(request, _WIDE),
            MessageType.WRITE: lambda request: self._write(request, _WIDE),
            MessageType.READ_MULTIPLE: self._read_multiple,
            MessageType.WRITE_MULTIPLE: self._write_multiple,
            MessageType.PROGRAM_CONTROL: _control_program,
            MessageType.CONFIRM_ALL: self._confirm_all,
        }
        self._server = Server(host, port, self._serve, max_clients=max_clients)

    @property
    def address(self) -> tuple[str, int]:
        """Get host and port."""
        return self._server.address

    def close(self) -> None:
        """Serve no more; the robot goes on."""
        self._server.close()

    def _serve(self, connection: socket.socket) -> None:
        self._controller.confirm()
        connection.settimeout(self._idle_s)
        with connection.makefile("rb") as stream:
            try:
                while len(header := stream.read(4)) == 4:
                    tag, length = struct.unpack(">HH", header)
                    body = stream.read(length)
                    if len(body) < length or not self._reply(connection, tag, body):
                        return
            except TimeoutError:
                return  # idle for too long
            except TronlabError as error:  # the laboratory around it is gone
                print(f"robot: KVP connection closed: {error}", file=sys.stderr, flush=True)

    def _reply(self, connection: socket.socket, tag: int, body: bytes) -> bool:
        """Answer one request; False if the connection is to be closed instead."""
        if self._faults.strike(f.DISCONNECT):
            self._server.drop_clients()
            return False
        answer = self._answer(body)
        if not self._faults.is_armed(f.SILENT):
            data = struct.pack(">HH", tag, len(answer)) + answer
            send(connection, data, in_pieces=self._faults.is_armed(f.SPLIT))
        return True

    def _answer(self, body: bytes) -> bytes:
        if not body:
            return _footer(ErrorCode.PROTOCOL)
        kind, request = body[:1], _Request(body[1:])
        make = self._answers.get(body[0])
        if make is None:
            return kind + _footer(ErrorCode.NOT_IMPLEMENTED)
        try:
            answer = make(request)
        except _BrokenRequestError:
            return kind + _footer(ErrorCode.PROTOCOL)
        is_too_long = len(kind) + len(answer) > 0xFFFF
        return kind + (_footer(ErrorCode.LONG_ANSWER) if is_too_long else answer)

    def _read(self, request: "_Request", text: "_TextForm") -> bytes:
        name = request.text(text)
        request.end()
        return text.pack(self._variables.read(name)) + _footer(ErrorCode.SUCCESS)

    def _write(self, request: "_Request", text: "_TextForm") -> bytes:
        name, value = request.text(text), request.text(text)
        request.end()
        code = self._write_variable(name, value)
        return text.pack(value if code is ErrorCode.SUCCESS else "") + _footer(code)

    def _write_variable(self, name: str, value: str) -> ErrorCode:
        try:
            self._variables.write(name, value)
        except ReadOnlyError:
            return ErrorCode.ACCESS
        except ValueError:
            return ErrorCode.ARGUMENT
        return ErrorCode.SUCCESS

    def _read_multiple(self, request: "_Request") -> bytes:
        names = [request.text(_WIDE) for _ in range(request.byte())]
        request.end()
        items = [
            bytes([ErrorCode.SUCCESS]) + _WIDE.pack(self._variables.read(name)) for name in names
        ]
        return bytes([len(names)]) + b"".join(items) + _footer(ErrorCode.SUCCESS)

    def _write_multiple(self, request: "_Request") -> bytes:
        pairs = [(request.text(_WIDE), request.text(_WIDE)) for _ in range(request.byte())]
        request.end()
        items = [
            bytes([self._write_variable(name, value)]) + _WIDE.pack(value) for name, value in pairs
        ]
        return bytes([len(pairs)]) + b"".join(items) + _footer(ErrorCode.SUCCESS)

    def _confirm_all(self, request: "_Request") -> bytes:
        request.end()
        self._controller.confirm()
        return _footer(ErrorCode.SUCCESS)


class _BrokenRequestError(Exception):
    """The parts of a request do not fit its length."""


class _TextForm:
    """How text is written: its length in characters, then the characters."""

    def __init__(self, encoding: str, width: int) -> None:
        self._encoding = encoding
        self.width = width

    def pack(self, text: str) -> bytes:
        return struct.pack(">H", len(text)) + text.encode(self._encoding)

    def unpack(self, data: bytes) -> str:
        return data.decode(self._encoding, errors="replace")


_ASCII = _TextForm("latin-1", 1)
_WIDE = _TextForm("utf-16-le", 2)


class _Request:
    """What comes after the type of a request, taken from the front."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def byte(self) -> int:
        return self._take(1)[0]

    def word(self) -> int:
        return int.from_bytes(self._take(2))

    def text(self, form: _TextForm) -> str:
        return form.unpack(self._take(self.word() * form.width))

    def end(self) -> None:
        if self._data:
            raise _BrokenRequestError

    def _take(self, n: int) -> bytes:
        if len(self._data) < n:
            raise _BrokenRequestError
        taken, self._data = self._data[:n], self._data[n:]
        return taken


def _control_program(request: _Request) -> bytes:
    """Agree to everything about the submit interpreter; the robot's is not controlled this way."""
    command, interpreter = request.byte(), request.word()
    is_simulated = command in range(1, 5) and interpreter == _SUBMIT_INTERPRETER
    code = ErrorCode.SUCCESS if is_simulated else ErrorCode.NOT_IMPLEMENTED
    return bytes([command]) + _footer(code)


def _footer(code: ErrorCode) -> bytes:
    return struct.pack(">HB", code, code is ErrorCode.SUCCESS)
