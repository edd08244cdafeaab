"""Packets of emScon: what is sent, and how a stream of bytes becomes packets again."""

import struct
from dataclasses import dataclass
from typing import Final

from drivers.leica.codes import Command, PacketType

HEADER: Final = struct.Struct("<iI")
"""Size of the whole packet, and its type."""
_LARGEST: Final = 65536
"""No packet is near it; a larger size means that the stream is out of step."""

_U32: Final = struct.Struct("<I")
_COMMAND_AND_STATUS: Final = struct.Struct("<II")

_BODIES: Final[dict[Command, str]] = {
    Command.SET_UNITS: "5I",
    Command.SET_STATION_ORIENTATION: "6d",
    Command.SET_TRANSFORMATION: "7d",
    Command.SET_ENVIRONMENT: "3d",
    Command.SET_MEASUREMENT_MODE: "I",
    Command.SET_COORDINATE_SYSTEM_TYPE: "I",
    Command.SET_STATIONARY_PARAMETERS: "iI",
    Command.SET_CONTINUOUS_TIME_PARAMETERS: "iiII",
    Command.SET_REFLECTOR: "i",
    Command.SET_SEARCH_PARAMETERS: "di",
    Command.SET_SYSTEM_SETTINGS: "9I",
    Command.POINT_LASER: "3d",
    Command.POINT_LASER_HVD: "3d",
    Command.FIND_REFLECTOR: "d",
    Command.SET_STATISTIC_MODE: "2I",
    Command.SET_LONG_PARAMETER: "Ii",
}
"""What follows the number of a command; nothing for those that are not here."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One whole packet as it came; its type may be one that this driver does not know."""

    type: int
    data: bytes

    @property
    def command(self) -> int:
        """Get the command that a reply or an error is about."""
        return _U32.unpack_from(self.data, 8)[0]

    @property
    def status(self) -> int:
        """Get the status of a reply, an error or a result; 0 is good."""
        is_answer = self.type in {PacketType.COMMAND, PacketType.ERROR}
        return _U32.unpack_from(self.data, 12 if is_answer else 8)[0]

    @property
    def event(self) -> int:
        """Get the number of an event."""
        return _U32.unpack_from(self.data, 8)[0]

    @property
    def body(self) -> bytes:
        """Get what follows the status."""
        return self.data[16 if self.type == PacketType.COMMAND else 12 :]


class PacketBuffer:
    """Makes packets of bytes, however these are split or joined."""

    def __init__(self) -> None:
        self._data = bytearray()

    @property
    def pending(self) -> bytes:
        """Get the bytes that are no whole packet yet."""
        return bytes(self._data)

    def feed(self, data: bytes) -> None:
        """Add bytes in the order they came."""
        self._data += data

    def pop(self) -> Packet | None:
        """Take the next packet, if it is whole.

        Raises:
            ValueError: The next bytes are no packet.
        """
        if len(self._data) < HEADER.size:
            return None
        size, kind = HEADER.unpack_from(self._data)
        if not _smallest(kind) <= size <= _LARGEST:
            raise ValueError(f"{size} is no size of a packet of type {kind}")
        if len(self._data) < size:
            return None
        packet = Packet(kind, bytes(self._data[:size]))
        del self._data[:size]
        return packet


def encode_request(command: Command, *values: float) -> bytes:
    """Write a command with its parameters, in the order of the emScon header."""
    body = struct.pack("<" + _BODIES.get(command, ""), *values)
    size = HEADER.size + _U32.size + len(body)
    return HEADER.pack(size, PacketType.COMMAND) + _U32.pack(command) + body


def _smallest(kind: int) -> int:
    has_command_and_status = kind in {PacketType.COMMAND, PacketType.ERROR}
    return HEADER.size + (_COMMAND_AND_STATUS if has_command_and_status else _U32).size
