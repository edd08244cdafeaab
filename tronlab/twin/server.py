"""One state for simulators in several processes: JSON lines over TCP, on loopback.

A request is one line ``{"do": "read" | "change" | "is_armed" | "strike" | "arm", ...}``, the answer
one line ``{"ok": value}`` or ``{"error": text}``. No code crosses the wire, only numbers and names.
"""

import json
import socket
import socketserver
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, is_dataclass
from typing import Any, BinaryIO, TypeAlias

from tronlab.errors import NotConnectedError
from tronlab.twin.state import FOR_EVER, StateStore, WorldState, value_from_json

DEVICE = "simulated world"
"""What errors call it."""
_PATIENCE_S = 5.0


class StateServer:
    """Serves a state to other processes until closed."""

    def __init__(self, state: StateStore, *, host: str = "127.0.0.1", port: int = 0) -> None:
        try:
            self._server = _Server((host, port), _answers(state))
        except OSError as error:
            raise NotConnectedError(
                f"cannot listen at {host}:{port}: {error.strerror}; does another simulated"
                " laboratory run?",
                device=DEVICE,
            ) from error
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    @property
    def address(self) -> tuple[str, int]:
        """Get host and port."""
        host, port = self._server.server_address[:2]
        return str(host), int(port)

    def close(self) -> None:
        """Serve no more."""
        self._server.shutdown()
        self._server.hang_up()
        self._server.server_close()
        self._thread.join()


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True

    def __init__(self, address: tuple[str, int], answers: "_Answers") -> None:
        self.answers = answers
        self.connections: set[socket.socket] = set()
        super().__init__(address, _Handler)

    def process_request(
        self, request: socket.socket | tuple[bytes, socket.socket], client_address: Any
    ) -> None:
        # Before its thread starts: close() must find every connection whose thread it waits for.
        if isinstance(request, socket.socket):
            self.connections.add(request)
        super().process_request(request, client_address)

    def hang_up(self) -> None:
        for connection in tuple(self.connections):
            with suppress(OSError):  # its client has just gone
                connection.shutdown(socket.SHUT_RDWR)


class _Handler(socketserver.StreamRequestHandler):
    server: _Server  # pyright: ignore[reportIncompatibleVariableOverride]  # made by no other

    def handle(self) -> None:
        try:
            for line in self.rfile:
                self.wfile.write(_answer(line, self.server.answers))
        except OSError:
            pass  # the client is gone
        finally:
            self.server.connections.discard(self.connection)


class RemoteState:
    """The state that a ``StateServer`` serves; connects when first asked, and anew when lost."""

    def __init__(self, host: str, port: int) -> None:
        self._address = host, port
        self._lock = threading.Lock()
        self._connection: socket.socket | None = None
        self._received: BinaryIO | None = None

    def read(self) -> WorldState:
        """Get the state now.

        Raises:
            NotConnectedError: Nobody serves it; likewise all other methods.
        """
        return WorldState.from_json(self._ask(do="read"))

    def change(self, **values: Any) -> None:
        """Change some fields at once."""
        self._ask(do="change", values={key: _plain(value) for key, value in values.items()})

    def is_armed(self, name: str) -> bool:
        """Look whether a fault is armed."""
        return bool(self._ask(do="is_armed", name=name))

    def strike(self, name: str) -> bool:
        """Use a fault up once."""
        return bool(self._ask(do="strike", name=name))

    def arm(self, name: str, *, times: int = FOR_EVER) -> None:
        """Arm a fault for so many strikes; 0 clears it."""
        self._ask(do="arm", name=name, times=times)

    def close(self) -> None:
        """Close the connection."""
        with self._lock:
            self._hang_up()

    def _ask(self, **request: Any) -> Any:
        with self._lock:
            line = self._exchange(json.dumps(request).encode() + b"\n")
        answer = json.loads(line)
        if "error" in answer:
            raise NotConnectedError(f"refused {request}: {answer['error']}", device=DEVICE)
        return answer["ok"]

    def _exchange(self, request: bytes) -> bytes:
        host, port = self._address
        try:
            connection, received = self._connected()
            connection.sendall(request)
            line = received.readline()
        except OSError as error:
            self._hang_up()
            raise NotConnectedError(
                f"nobody answers at {host}:{port} ({error}); start it: tronlab twin up RIG.yaml",
                device=DEVICE,
            ) from error
        if not line.endswith(b"\n"):
            self._hang_up()
            raise NotConnectedError(f"{host}:{port} closed the connection", device=DEVICE)
        return line

    def _connected(self) -> tuple[socket.socket, BinaryIO]:
        if self._connection is None or self._received is None:
            self._connection = socket.create_connection(self._address, timeout=_PATIENCE_S)
            self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._received = self._connection.makefile("rb")
        return self._connection, self._received

    def _hang_up(self) -> None:
        for end in (self._received, self._connection):
            if end is not None:
                end.close()
        self._connection = self._received = None


_Answers: TypeAlias = Mapping[str, Callable[[Mapping[str, Any]], Any]]


def _answers(state: StateStore) -> _Answers:
    def change(request: Mapping[str, Any]) -> None:
        values = request["values"]
        state.change(**{key: value_from_json(key, value) for key, value in values.items()})

    return {
        "read": lambda _request: state.read().as_json(),
        "change": change,
        "is_armed": lambda request: state.is_armed(request["name"]),
        "strike": lambda request: state.strike(request["name"]),
        "arm": lambda request: state.arm(request["name"], times=int(request["times"])),
    }


def _answer(line: bytes, answers: _Answers) -> bytes:
    try:
        request = json.loads(line)
        answer = {"ok": answers[request["do"]](request)}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        answer = {"error": repr(error)}
    return json.dumps(answer).encode() + b"\n"


def _plain(value: Any) -> Any:
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value
