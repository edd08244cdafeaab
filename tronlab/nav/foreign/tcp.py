"""A core that listens on a socket, on another computer perhaps."""

import socket
import weakref

from tronlab.nav.foreign.channel import Channel, Ends
from tronlab.nav.foreign.transport import MAX_ANSWER_SIZE, UnreachableError


class CoreSocket:
    """A connection to a core; the core itself goes on when the connection ends."""

    can_share_memory = False
    stray_bytes_hint = "where a message was due"

    def __init__(self, address: str, *, limit_s: float) -> None:
        """Connect to ``host:port``; an IPv6 address stands in square brackets.

        Raises:
            UnreachableError: Nobody answers there within the limit.
        """
        host, _, port = address.rpartition(":")
        try:
            connection = socket.create_connection((host.strip("[]"), int(port)), timeout=limit_s)
        # Refused, unknown, not reachable, timed out; no name that a computer can have.
        except (OSError, UnicodeError) as error:
            raise UnreachableError(
                f"cannot be reached at tcp://{address}: {_reason(error, limit_s)}"
            ) from error
        tune(connection)
        self._end = weakref.finalize(self, connection.close)
        self._channel = Channel(
            Ends(connection.fileno(), connection.fileno()), max_payload=MAX_ANSWER_SIZE
        )

    @property
    def channel(self) -> Channel:
        """Get the stream of messages."""
        return self._channel

    def how_it_ended(self) -> str:
        """Say nothing: how the program ended is known on the other computer."""
        return ""

    def last_words(self) -> str:
        """Say nothing, for the same reason."""
        return ""

    def close(self) -> None:
        """Close the connection."""
        self._end()

    def kill(self) -> None:
        """Close the connection; more cannot be done from here."""
        self._end()


def _reason(error: OSError | UnicodeError, limit_s: float) -> str:
    if isinstance(error, TimeoutError):
        return f"no answer within {limit_s:g} s"
    return str(error if isinstance(error, UnicodeError) else error.strerror)


def tune(connection: socket.socket) -> None:
    """Have small messages sent at once, and a lost computer noticed within half a minute."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 4)):
        if hasattr(socket, option):  # not everywhere
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
