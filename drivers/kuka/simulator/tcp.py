"""A TCP server that serves so many clients at once and no more, each in its own thread."""

import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from tronlab.errors import ConfigError

_ACCEPT_TIMEOUT_S: Final = 0.05
_LEAVING_S: Final = 0.05
"""Who comes while another leaves waits so long for room."""
_N_PIECES: Final = 5
_BETWEEN_PIECES_S: Final = 0.001


class Server:
    """Serves until closed; who comes when it is full is closed at once.

    Args:
        host: Address to listen at.
        port: Port; 0 for any free one.
        serve: Serves one connection; when it returns or the connection breaks, it is closed.
        max_clients: How many at once; None for any number.

    Raises:
        ConfigError: Nothing can listen there.
    """

    def __init__(
        self,
        host: str,
        port: int,
        serve: Callable[[socket.socket], None],
        *,
        max_clients: int | None,
    ) -> None:
        self._serve = serve
        self._max_clients = max_clients
        self._clients: dict[socket.socket, threading.Thread] = {}
        self._change = threading.Condition()
        self._is_closing = threading.Event()
        self._listener = _listen(host, port)
        self._thread = threading.Thread(target=self._accept, daemon=True)
        self._thread.start()

    @property
    def address(self) -> tuple[str, int]:
        """Get host and port."""
        host, port = self._listener.getsockname()[:2]
        return str(host), int(port)

    def drop_clients(self) -> None:
        """Close every connection."""
        with self._change:
            for connection in self._clients:
                _shut(connection)

    def close(self) -> None:
        """Serve no more; every connection and thread is gone when this returns."""
        self._is_closing.set()
        self._thread.join()
        self._listener.close()
        self.drop_clients()
        with self._change:
            threads = list(self._clients.values())
        for thread in threads:
            thread.join()

    def _accept(self) -> None:
        while not self._is_closing.is_set():
            try:
                connection, _ = self._listener.accept()
            except TimeoutError:
                continue
            connection.settimeout(None)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._admit(connection)

    def _admit(self, connection: socket.socket) -> None:
        with self._change:
            if not self._change.wait_for(self._has_room, _LEAVING_S):
                connection.close()
                return
            thread = threading.Thread(target=self._attend, args=(connection,), daemon=True)
            self._clients[connection] = thread
            thread.start()

    def _has_room(self) -> bool:
        return self._max_clients is None or len(self._clients) < self._max_clients

    def _attend(self, connection: socket.socket) -> None:
        try:
            with suppress(OSError):  # the client is gone, or the server closes
                self._serve(connection)
        finally:
            with self._change:
                del self._clients[connection]
                self._change.notify_all()
            connection.close()


def send(connection: socket.socket, data: bytes, *, in_pieces: bool) -> None:
    """Send everything, in one piece or in several with pauses between them."""
    if not in_pieces:
        connection.sendall(data)
        return
    size = max(1, len(data) // _N_PIECES)
    for i in range(0, len(data), size):
        connection.sendall(data[i : i + size])
        time.sleep(_BETWEEN_PIECES_S)


def _listen(host: str, port: int) -> socket.socket:
    try:
        listener = socket.create_server((host, port))
    except OSError as error:
        raise ConfigError(
            f"cannot listen at {host}:{port}: {error.strerror}; choose another port, or 0 for any"
        ) from error
    listener.settimeout(_ACCEPT_TIMEOUT_S)
    return listener


def _shut(connection: socket.socket) -> None:
    with suppress(OSError):  # it is gone already
        connection.shutdown(socket.SHUT_RDWR)
