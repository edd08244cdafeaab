"""The camera's UDP sockets."""

import socket
from contextlib import ExitStack
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network
from typing import Final, Self

from tronlab.errors import NotConnectedError

_LOOPBACK: Final = IPv4Network("127.0.0.0/8")
_BROADCASTS: Final = ("127.255.255.255", "255.255.255.255")
_SEND_BUFFER_BYTES: Final = 8 << 20


@dataclass(frozen=True)
class Endpoints:
    """What a camera listens at and sends from."""

    address: tuple[str, int]
    """Host and port of the control channel."""
    control: socket.socket
    """Hears commands, and answers all of them."""
    broadcasts: tuple[socket.socket, ...]
    """Hear broadcast commands; only a camera on loopback has any, and heeds only loopback."""
    stream: socket.socket

    @classmethod
    def open(cls, host: str, port: int) -> Self:
        """Open them; port 0 is any free one.

        Raises:
            NotConnectedError: One cannot be bound.
        """
        _check_host(host)
        with ExitStack() as stack:
            control = stack.enter_context(_bound_socket(host, port))
            address = control.getsockname()
            stream = stack.enter_context(_bound_socket(host, 0))
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
            broadcasts = tuple(
                stack.enter_context(_bound_socket(broadcast, address[1], is_shared=True))
                for broadcast in _BROADCASTS
                if is_loopback(host)
            )
            for listener in (control, *broadcasts):
                listener.setblocking(False)
            stack.pop_all()
        return cls(address, control, broadcasts, stream)

    def close(self) -> None:
        """Close all."""
        for endpoint in (self.control, *self.broadcasts, self.stream):
            endpoint.close()


def is_loopback(host: str) -> bool:
    """Tell whether an address is this computer's alone."""
    return IPv4Address(host) in _LOOPBACK


def _check_host(host: str) -> None:
    """Return if the camera can tell others that address as its own."""
    try:
        is_one_host = not IPv4Address(host).is_unspecified
    except ValueError:
        is_one_host = False
    if not is_one_host:
        raise NotConnectedError(
            f"cannot listen at '{host}': a camera has one IPv4 address, such as 127.0.0.1",
            device="camera",
        )


def _bound_socket(host: str, port: int, *, is_shared: bool = False) -> socket.socket:
    endpoint = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        if is_shared:
            endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        endpoint.bind((host, port))
    except (OSError, OverflowError) as error:
        endpoint.close()
        reason = getattr(error, "strerror", None) or error
        raise NotConnectedError(
            f"cannot listen at {host}:{port}: {reason}; does another simulator run?",
            device="camera",
        ) from error
    return endpoint
