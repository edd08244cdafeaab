"""A simulated ENTTEC DMX USB Pro with a lamp on its line."""

from typing import Final

from drivers.room.simulator.lamp import SimulatedLamp
from tronlab.twin.state import Faults

_FIRMWARE: Final = bytes((44, 1))
_BREAK_UNITS, _MARK_UNITS, _RATE_HZ = 9, 1, 40
_SERIAL_BCD: Final = bytes((0x21, 0x43, 0x65, 0x07))
_LARGEST: Final = 600


class DmxWidget:
    """The widget: it takes label 6, answers labels 3 and 10, and keeps what label 4 sets.

    Like the real one it stops sending DMX at any request but labels 3 and 6; the lamp goes dark.

    Args:
        lamp: What hangs on the DMX line.
        faults: ``room.dimmer_silent``.
        channel: Of the lamp's coarse brightness, from 1.
        fine_channel: Of the fine brightness; None if the lamp has 8 bits.
    """

    def __init__(
        self, lamp: SimulatedLamp, faults: Faults, *, channel: int, fine_channel: int | None
    ) -> None:
        self._lamp = lamp
        self._faults = faults
        self._channel, self._fine_channel = channel, fine_channel
        self._timing = bytes((_BREAK_UNITS, _MARK_UNITS, _RATE_HZ))
        self._buffer = bytearray()

    def receive(self, data: bytes) -> bytes:
        """Take bytes, and give the answers of the messages that end in them."""
        if self._faults.is_armed("room.dimmer_silent"):
            self._buffer.clear()
            return b""
        answers = b""
        for byte in data:
            self._buffer.append(byte)
            answers += self._message()
        return answers

    def spontaneous(self) -> bytes:
        """Send nothing: no DMX comes in."""
        return b""

    def _message(self) -> bytes:
        """Act on the message in the buffer if its last byte has just come."""
        buffer = self._buffer
        if buffer[0] != 0x7E:
            buffer.clear()
        if len(buffer) < 4:
            return b""
        size = buffer[2] | buffer[3] << 8
        if size > _LARGEST:
            buffer.clear()
        if len(buffer) < size + 5:
            return b""
        label, content, end = buffer[1], bytes(buffer[4:-1]), buffer[-1]
        buffer.clear()
        return self._act(label, content) if end == 0xE7 else b""

    def _act(self, label: int, content: bytes) -> bytes:
        if label not in {3, 6}:
            self._lamp.dim(0.0)  # the widget turns its line round, and the lamp misses its DMX
        match label:
            case 3:
                return _answer(3, _FIRMWARE + self._timing)
            case 4 if len(content) >= 5:
                self._timing = content[2:5]
            case 6 if content[:1] == b"\0" and 24 <= len(content) - 1 <= 512:
                self._dim(content)
            case 10:
                return _answer(10, _SERIAL_BCD)
            case _:
                pass  # the widget does not answer what it does not know
        return b""

    def _dim(self, frame: bytes) -> None:
        """Take a DMX frame; its place 0 is the start code, so channel n is at place n."""
        coarse = frame[self._channel] if self._channel < len(frame) else 0
        if self._fine_channel is None:
            self._lamp.dim(coarse / 255)
            return
        fine = frame[self._fine_channel] if self._fine_channel < len(frame) else 0
        self._lamp.dim((coarse * 256 + fine) / 65535)


def _answer(label: int, content: bytes) -> bytes:
    return b"\x7e" + bytes((label, len(content) & 0xFF, len(content) >> 8)) + content + b"\xe7"
