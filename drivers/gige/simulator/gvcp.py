"""The control protocol on the wire: commands, acknowledgements and status codes of GVCP 1.2."""

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

STANDARD_PORT: Final = 3956
MAX_MEMORY_BYTES: Final = 536
"""Most that one READMEM or WRITEMEM may carry: a command fits 576 bytes with its headers."""

_KEY: Final = 0x42
_WANTS_ACKNOWLEDGEMENT: Final = 0x01
_HEADER: Final = struct.Struct(">BBHHH")
_ACKNOWLEDGEMENT: Final = struct.Struct(">HHHH")


class Command(IntEnum):
    """What an application may ask; the acknowledgement has the next higher number."""

    DISCOVERY = 0x0002
    FORCE_IP = 0x0004
    PACKET_RESEND = 0x0040
    READ_REGISTERS = 0x0080
    WRITE_REGISTERS = 0x0082
    READ_MEMORY = 0x0084
    WRITE_MEMORY = 0x0086


PENDING_ACKNOWLEDGEMENT: Final = 0x0089


class Status(IntEnum):
    """How a command went; from 0x8000 on, it failed."""

    SUCCESS = 0x0000
    PACKET_RESENT = 0x0100
    NOT_IMPLEMENTED = 0x8001
    INVALID_PARAMETER = 0x8002
    INVALID_ADDRESS = 0x8003
    WRITE_PROTECTED = 0x8004
    BAD_ALIGNMENT = 0x8005
    ACCESS_DENIED = 0x8006
    LOCAL_PROBLEM = 0x8008
    PACKET_UNAVAILABLE = 0x800C
    INVALID_HEADER = 0x800E


class RefusedError(Exception):
    """A command cannot be done; the acknowledgement says why.

    ``done`` is what the acknowledgement carries nevertheless: what went well before.
    """

    def __init__(self, status: Status, done: bytes = b"") -> None:
        self.status = status
        self.done = done
        super().__init__(status.name)


class IgnoredError(Exception):
    """A command gets no acknowledgement, whatever its header asks for."""


@dataclass(frozen=True, slots=True)
class Request:
    """One command as it arrived."""

    command: int
    wants_acknowledgement: bool
    request_id: int
    payload: bytes
    is_whole: bool
    """The header tells the length of the payload rightly."""


def parse_request(datagram: bytes) -> Request | None:
    """Read a command; None if the datagram is none, which a device must ignore."""
    if len(datagram) < _HEADER.size:
        return None
    key, flags, command, length, request_id = _HEADER.unpack_from(datagram)
    if key != _KEY:
        return None
    payload = datagram[_HEADER.size :]
    return Request(
        command=command,
        wants_acknowledgement=bool(flags & _WANTS_ACKNOWLEDGEMENT),
        request_id=request_id,
        payload=payload,
        is_whole=length == len(payload),
    )


def is_acknowledgement(command: int) -> bool:
    """Tell an acknowledgement from a command: answering one could go on for ever."""
    return bool(command & 1)


def acknowledge(request: Request, payload: bytes, status: Status = Status.SUCCESS) -> bytes:
    """Give the acknowledgement of a command."""
    number = request.command + 1
    return _ACKNOWLEDGEMENT.pack(status, number, len(payload), request.request_id) + payload


def ask_for_patience(request: Request, *, time_ms: int) -> bytes:
    """Give the PENDING_ACK that promises the acknowledgement within ``time_ms``."""
    payload = struct.pack(">HH", 0, time_ms)
    return (
        _ACKNOWLEDGEMENT.pack(
            Status.SUCCESS, PENDING_ACKNOWLEDGEMENT, len(payload), request.request_id
        )
        + payload
    )
