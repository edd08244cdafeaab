"""A stream of bytes to and from a core, over which no wait is longer than allowed."""

import os
import selectors
from collections.abc import Sequence
from dataclasses import dataclass
from time import monotonic

from tronlab.nav.foreign.messages import (
    MAX_PAYLOAD_SIZE,
    PREFIX_SIZE,
    Buffer,
    Message,
    check_magic,
    decode_header,
    decode_prefix,
)

FOREVER = float("inf")
_CHUNK = 1 << 20
_MOST_UNASKED = 1 << 16
"""Bytes taken from a core that writes while it is written to."""


class ChannelError(Exception):
    """The stream carries no more messages; the text completes "the core ..."."""


class GoneError(ChannelError):
    """The other side has ended, or closed its end."""


class LateError(ChannelError):
    """The deadline has passed."""


@dataclass(frozen=True, slots=True)
class Ends:
    """Two file descriptors, non-blocking: the same one twice for a socket."""

    reading: int
    writing: int


class Channel:
    """Sends and receives messages. After any error it is of no more use.

    Deadlines are times of ``time.monotonic``. They hold for the whole message, so that a core that
    sends single bytes, or reads them, is late like one that does nothing.
    """

    def __init__(self, ends: Ends, *, max_payload: int = MAX_PAYLOAD_SIZE) -> None:
        self._ends = ends
        self._max_payload = max_payload
        self._incoming = bytearray()
        os.set_blocking(ends.reading, False)
        os.set_blocking(ends.writing, False)

    def send(self, pieces: Sequence[Buffer], deadline: float) -> None:
        """Send a message as ``messages.encode`` gives it.

        Meanwhile a little of what the core writes is taken: one that greets the world before it
        reads shall not stand still, and is told so where its answer is read.

        Raises:
            GoneError: The core takes no more.
            MessageError: It takes no more, and wrote what is no message.
            LateError: It does not take it in time.
        """
        with selectors.DefaultSelector() as selector:
            is_one = self._ends.reading == self._ends.writing
            both = selectors.EVENT_READ | selectors.EVENT_WRITE
            selector.register(self._ends.writing, both if is_one else selectors.EVENT_WRITE)
            if not is_one:
                selector.register(self._ends.reading, selectors.EVENT_READ)
            for piece in pieces:
                rest = memoryview(piece)
                while rest:
                    rest = rest[self._step(selector, rest, deadline) :]

    def receive(self, deadline: float) -> Message:
        """Give the next message.

        Raises:
            GoneError: The core has closed its end.
            LateError: There is no whole message in time.
            MessageError: It is none.
        """
        check_magic(self._incoming)
        while len(self._incoming) < PREFIX_SIZE:
            self._fill(len(self._incoming) + 1, deadline)
            check_magic(self._incoming)  # at the first wrong byte: the rest may never come
        n_header, n_payload = decode_prefix(
            self._incoming[:PREFIX_SIZE], max_payload=self._max_payload
        )
        end = PREFIX_SIZE + n_header
        self._fill(end, deadline)
        header = decode_header(self._incoming[PREFIX_SIZE:end])
        self._fill(end + n_payload, deadline)
        payload = bytes(memoryview(self._incoming)[end : end + n_payload])
        del self._incoming[: end + n_payload]
        return Message(header, payload)

    def unread(self) -> bytes:
        """Give what has come and was not asked for, without waiting."""
        while len(self._incoming) < _MOST_UNASKED and self._take():
            pass
        return bytes(self._incoming)

    def _step(self, selector: selectors.BaseSelector, rest: memoryview, deadline: float) -> int:
        """Wait until something moves; give how many bytes were sent."""
        events = selector.select(_left_s(deadline, what="did not read what it was sent"))
        n_sent = 0
        for key, mask in events:
            if mask & selectors.EVENT_READ and not self._has_taken_unasked():
                # Nothing more to be read for now: wait for writing only.
                if key.fd == self._ends.writing:
                    selector.modify(key.fd, selectors.EVENT_WRITE)
                else:
                    selector.unregister(key.fd)
            if mask & selectors.EVENT_WRITE:
                n_sent = self._write(rest)
        return n_sent

    def _has_taken_unasked(self) -> bool:
        """Take some of what the core writes; whether there may be more, and room for it."""
        try:
            return self._take() and len(self._incoming) < _MOST_UNASKED
        except GoneError:
            return False  # what is lost is said by writing, or when the answer is read

    def _write(self, rest: memoryview) -> int:
        try:
            return os.write(self._ends.writing, rest[:_CHUNK])
        except BlockingIOError:
            return 0
        except OSError as error:
            self._has_taken_unasked()
            check_magic(self._incoming)  # what it wrote instead says more
            raise GoneError(f"reads no more messages ({error.strerror})") from error

    def _fill(self, n: int, deadline: float) -> None:
        """Have at least ``n`` bytes; memory grows with what comes, not with what is announced."""
        if len(self._incoming) >= n:
            return
        with selectors.DefaultSelector() as selector:
            selector.register(self._ends.reading, selectors.EVENT_READ)
            while len(self._incoming) < n:
                what = f"sent {len(self._incoming)} of {n} bytes" if self._incoming else "is silent"
                if selector.select(_left_s(deadline, what=what)):
                    self._take()

    def _take(self) -> bool:
        """Read once; whether something came.

        Raises:
            GoneError: Nothing will come any more.
        """
        try:
            chunk = os.read(self._ends.reading, _CHUNK)
        except BlockingIOError:
            return False
        except OSError as error:
            raise GoneError(f"cannot be heard any more ({error.strerror})") from error
        if not chunk:
            raise GoneError(
                f"ended in the middle of a message, after {len(self._incoming)} bytes"
                if self._incoming
                else "ended without an answer"
            )
        self._incoming += chunk
        return True


def _left_s(deadline: float, *, what: str) -> float | None:
    """Give the time that is left for a selector: None is without end."""
    if deadline == FOREVER:
        return None
    left_s = deadline - monotonic()
    if left_s <= 0:
        raise LateError(what)
    return left_s
