"""What the conversation with a core asks of the way there, be it a process or a socket."""

from typing import Protocol

from tronlab.nav.foreign.channel import Channel

MAX_ANSWER_SIZE = 1 << 26
"""Largest payload of an answer, bytes: 4 million inliers."""


class StartError(Exception):
    """A core cannot be started or reached; the text completes "the core ..."."""


class UnreachableError(StartError):
    """Nobody listens there, for now at least."""


class Transport(Protocol):
    """A core that has been started or connected to."""

    can_share_memory: bool
    """Whether the core may be on this machine."""
    stray_bytes_hint: str
    """What to think of bytes that are no message; completes "the core wrote ..."."""

    @property
    def channel(self) -> Channel:
        """Get the stream of messages."""
        ...

    def how_it_ended(self) -> str:
        """Say how a core ended that has closed its end, or nothing if nobody knows."""
        ...

    def last_words(self) -> str:
        """Give what the core said last for people to read, or nothing."""
        ...

    def close(self) -> None:
        """Let it end by itself after its ``bye``; what does not within a moment is killed."""
        ...

    def kill(self) -> None:
        """End it at once, whatever it does."""
        ...
