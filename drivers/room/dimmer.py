"""The lamp's dimmer: a DMX lamp behind an ENTTEC DMX USB Pro.

Messages by the ENTTEC DMX USB Pro Widget API 1.44. The widget repeats the last DMX frame by itself
and acknowledges none; whether it is there shows when it is asked for its parameters. Any other
request, such as for its serial number, ends its output until the next frame.
"""

from dataclasses import dataclass
from typing import Final

from drivers.room.options import DimmerOptions
from drivers.room.serial_line import SerialLine
from tronlab.devices.readings import DeviceIdentity
from tronlab.errors import LimitError, ProtocolError

GET_PARAMETERS: Final = 3
SEND_DMX: Final = 6
GET_SERIAL_NUMBER: Final = 10

_START, _END = 0x7E, 0xE7
_HEADER_BYTES: Final = 4
_MAX_DATA_BYTES: Final = 600
_DMX_START_CODE: Final = b"\x00"
_MIN_CHANNELS: Final = 24
_NO_USER_DATA: Final = b"\x00\x00"


@dataclass(frozen=True, slots=True)
class WidgetMessage:
    """One message to or from the widget."""

    label: int
    data: bytes = b""

    def __bytes__(self) -> bytes:
        length = len(self.data).to_bytes(2, "little")
        return bytes((_START, self.label)) + length + self.data + bytes((_END,))


class MessageReader:
    """Finds messages in a stream of bytes; what is none is skipped."""

    def __init__(self) -> None:
        self._pending = b""

    def feed(self, data: bytes) -> list[WidgetMessage]:
        """Take bytes, give the messages that end in them."""
        self._pending += data
        messages: list[WidgetMessage] = []
        while True:
            begin = self._pending.find(_START)
            self._pending = self._pending[begin:] if begin >= 0 else b""
            if len(self._pending) < _HEADER_BYTES:
                return messages
            end = _HEADER_BYTES + int.from_bytes(self._pending[2:4], "little")
            if end > _HEADER_BYTES + _MAX_DATA_BYTES:
                self._pending = self._pending[1:]
            elif len(self._pending) <= end:
                return messages
            elif self._pending[end] != _END:
                self._pending = self._pending[1:]
            else:
                messages.append(WidgetMessage(self._pending[1], self._pending[4:end]))
                self._pending = self._pending[end + 1 :]


class Dimmer:
    """A dimmed lamp on one or two channels of DMX.

    Args:
        options: Its serial line and channels.
        device: Name of the device whose part it is.
    """

    def __init__(self, options: DimmerOptions, *, device: str) -> None:
        self._options = options
        self._line = SerialLine(options, what="dimmer", device=device)
        self._device = device
        self._level: float | None = None

    @property
    def level(self) -> float | None:
        """Get the level last set, 0 to 1; None if none was: it cannot be read from the widget."""
        return self._level

    def connect(self) -> None:
        """Open the line and see that the widget is there; the light stays as it is.

        Raises:
            NotConnectedError: The line cannot be opened.
            DeviceTimeoutError: Nobody answers there.
        """
        self._line.open()
        self._read_parameters()

    def close(self) -> None:
        """Close the line; the widget goes on sending the last level."""
        self._line.close()

    def identify(self) -> DeviceIdentity:
        """Read serial number and firmware of the widget; the light may flicker once."""
        minor, major = self._read_parameters()[:2]
        serial = self._ask(WidgetMessage(GET_SERIAL_NUMBER), min_bytes=4)[:4]
        if self._level is not None:
            self.set_level(self._level)
        return DeviceIdentity(
            maker="ENTTEC",
            model="DMX USB Pro",
            serial=serial[::-1].hex(),
            firmware=f"{major}.{minor}",
        )

    def set_level(self, level: float) -> None:
        """Send a level, 0 to 1 of the full light, and see that the widget is still there.

        Raises:
            LimitError: It lies outside.
            DeviceTimeoutError: The widget does not answer; nobody knows what it did.
        """
        if not 0.0 <= level <= 1.0:
            raise LimitError(f"dimmer: level is {level:g}, allowed 0 to 1", device=self._device)
        self._line.write(bytes(WidgetMessage(SEND_DMX, _DMX_START_CODE + self._channels(level))))
        self._read_parameters()
        self._level = level

    def _read_parameters(self) -> bytes:
        """Give firmware (low byte, high byte) and timing of the DMX output."""
        return self._ask(WidgetMessage(GET_PARAMETERS, _NO_USER_DATA), min_bytes=2)

    def _channels(self, level: float) -> bytes:
        """Give the values of all channels from 1 up to the last one needed."""
        coarse, fine = self._options.channel, self._options.fine_channel
        channels = bytearray(max(_MIN_CHANNELS, coarse, fine or 0))
        if fine is None:
            channels[coarse - 1] = round(level * 0xFF)
        else:
            channels[coarse - 1], channels[fine - 1] = divmod(round(level * 0xFFFF), 0x100)
        return bytes(channels)

    def _ask(self, request: WidgetMessage, *, min_bytes: int) -> bytes:
        """Give the data of the answer, which has the label of the request."""
        self._line.discard()
        self._line.write(bytes(request))
        until_s, reader = self._line.deadline_s(), MessageReader()
        while True:
            received = self._line.read(until_s=until_s)
            for message in reader.feed(received):
                if message.label != request.label:
                    continue  # such as DMX that the widget itself received
                if len(message.data) < min_bytes:
                    raise ProtocolError(
                        f"dimmer: the answer has {len(message.data)} bytes, expected {min_bytes}",
                        device=self._device,
                        sent=bytes(request),
                        received=received,
                    )
                return message.data
