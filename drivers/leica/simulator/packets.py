"""Packets of the simulated tracker as bytes, and requests from bytes."""

import struct
from collections.abc import Sequence
from typing import Final

from drivers.leica.simulator.codes import DataType, Event
from drivers.leica.simulator.layout import Values
from drivers.leica.simulator.tables import DATA, REPLIES, SAMPLES

MOST_BYTES: Final = 65536
"""No request is longer; what claims to be is garbage."""
SIZE_BYTES: Final = 4
"""Of the number every packet begins with."""

_REPLY_HEADER_SIZE: Final = 16


def request_of(request: bytes) -> tuple[int, int]:
    """Read data type and command of a whole request."""
    kind, command = struct.unpack_from("<Ii", request, SIZE_BYTES)
    return kind, command


def reply(command: int, status: int, values: Values | None = None) -> bytes:
    """Make a reply; one with an error has no body."""
    layout = REPLIES.get(command)
    if values is None or layout is None:
        return struct.pack("<iIiI", _REPLY_HEADER_SIZE, DataType.COMMAND, command, status)
    data = layout.pack(values)
    struct.pack_into("<iIiI", data, 0, layout.size, DataType.COMMAND, command, status)
    return bytes(data)


def error(command: int, status: int) -> bytes:
    """Make an error packet."""
    return struct.pack("<iIiI", 16, DataType.ERROR, command, status)


def event(number: Event) -> bytes:
    """Make a status event."""
    return struct.pack("<iII", 12, DataType.EVENT, number)


def data(kind: DataType, values: Values, points: Sequence[Values] = ()) -> bytes:
    """Make a data packet with status 0; ``points`` are the samples of a continuous one."""
    head, sample = DATA[kind], SAMPLES.get(kind)
    packet = head.pack({"status": 0, **values})
    if sample is not None:
        packet += b"".join(sample.pack(point) for point in points)
    struct.pack_into("<iI", packet, 0, len(packet), kind)
    return bytes(packet)
