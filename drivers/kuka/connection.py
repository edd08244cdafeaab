"""TCP connections to the controller, with errors that say where and what to do."""

import contextlib
import select
import socket

from tronlab.errors import NotConnectedError


def open_connection(
    host: str, port: int, *, timeout_s: float, device: str, call: str
) -> socket.socket:
    """Connect to a port of the controller.

    Raises:
        NotConnectedError: Nobody answers there.
    """
    try:
        connection = socket.create_connection((host, port), timeout=timeout_s)
    except OSError as error:
        reason = f"no answer in {timeout_s:g} s" if isinstance(error, TimeoutError) else error
        raise NotConnectedError(
            f"{call}: {host}:{port}: {reason}; is the controller on, its program started and the"
            " network as in drivers/kuka/README.md?",
            device=device,
        ) from error
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def is_closed_by_peer(connection: socket.socket) -> bool:
    """Look, without waiting, whether the other side has closed a connection."""
    readable, _, _ = select.select([connection], [], [], 0.0)
    if not readable:
        return False
    try:
        return connection.recv(1, socket.MSG_PEEK) == b""
    except OSError:
        return True


def shut(connection: socket.socket) -> None:
    """Close a connection, and wake who waits at it."""
    with contextlib.suppress(OSError):  # the other side was faster
        connection.shutdown(socket.SHUT_RDWR)
    connection.close()
