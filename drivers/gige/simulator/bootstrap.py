"""The registers that every GigE Vision device has: where they are, and what they hold at first.

Addresses and bits: GigE Vision 1.2, bootstrap registers.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum
from ipaddress import IPv4Address
from typing import Final

from drivers.gige.simulator.features import Access, Model

DISCOVERY_BYTES: Final = 0xF8
"""An acknowledged discovery carries the registers from 0 to here."""
TICK_HZ: Final = 36_858_974
"""Frequency of the camera's clock."""
LARGEST_PACKET: Final = 8228
SMALLEST_PACKET: Final = 576
SHORTEST_HEARTBEAT_MS: Final = 500

CONTROL_EXCLUSIVE: Final = 0b01
CONTROL_SHARED: Final = 0b10
"""Bits of the control channel privilege: with the second, others may read."""

FIRE_TEST_PACKET: Final = 1 << 31
DO_NOT_FRAGMENT: Final = 1 << 30
RESET_TIMESTAMP: Final = 0b01
LATCH_TIMESTAMP: Final = 0b10

_BIG_ENDIAN_UTF8: Final = 0x80000001
_SUPPORTED_IP: Final = 0b111  # link-local, DHCP and persistent addresses
_CAPABILITY: Final = (
    1 << 31  # user-defined name
    | 1 << 30  # serial number
    | 1 << 27  # port and address of the application in control
    | 1 << 5  # PENDING_ACK
    | 1 << 2  # PACKETRESEND
    | 1 << 1  # WRITEMEM
    | 1 << 0  # several registers in one command
)


class Bootstrap(IntEnum):
    """Addresses."""

    VERSION = 0x0000
    DEVICE_MODE = 0x0004
    MAC_HIGH = 0x0008
    MAC_LOW = 0x000C
    IP_SUPPORTED = 0x0010
    IP_CURRENT = 0x0014
    IP_ADDRESS = 0x0024
    SUBNET_MASK = 0x0034
    VENDOR = 0x0048
    MODEL = 0x0068
    DEVICE_VERSION = 0x0088
    INFORMATION = 0x00A8
    SERIAL = 0x00D8
    USER_NAME = 0x00E8
    FIRST_URL = 0x0200
    SECOND_URL = 0x0400
    N_INTERFACES = 0x0600
    N_MESSAGE_CHANNELS = 0x0900
    N_STREAM_CHANNELS = 0x0904
    CAPABILITY = 0x0934
    HEARTBEAT_MS = 0x0938
    TICK_HZ_HIGH = 0x093C
    TICK_HZ_LOW = 0x0940
    TIMESTAMP_CONTROL = 0x0944
    TIMESTAMP_HIGH = 0x0948
    TIMESTAMP_LOW = 0x094C
    CONTROL_PRIVILEGE = 0x0A00
    APPLICATION_PORT = 0x0A04
    APPLICATION_ADDRESS = 0x0A14
    STREAM_PORT = 0x0D00
    PACKET_SIZE = 0x0D04
    PACKET_DELAY = 0x0D08
    STREAM_ADDRESS = 0x0D18
    STREAM_SOURCE_PORT = 0x0D1C


@dataclass(frozen=True, slots=True)
class Content:
    """Some registers in a row as they are at first."""

    address: int
    data: bytes
    access: Access = "RO"


def mac_of(host: str) -> bytes:
    """Give the MAC address of a simulated camera: locally administered, one for every address."""
    return b"\x02\x00" + IPv4Address(host).packed


def bootstrap(model: Model, *, host: str, source_port: int, url: str) -> tuple[Content, ...]:
    """Give what the standard's registers hold when the camera starts."""
    return (
        Content(0, _identification(model, host)),
        Content(Bootstrap.USER_NAME, bytes(16), "RW"),
        _text(Bootstrap.FIRST_URL, url, 512),
        _text(Bootstrap.SECOND_URL, "", 512),
        _word(Bootstrap.N_INTERFACES, 1),
        _word(Bootstrap.N_MESSAGE_CHANNELS, 0),
        _word(Bootstrap.N_STREAM_CHANNELS, 1),
        _word(Bootstrap.CAPABILITY, _CAPABILITY),
        _word(Bootstrap.HEARTBEAT_MS, 3000, "RW"),
        _word(Bootstrap.TICK_HZ_HIGH, 0),
        _word(Bootstrap.TICK_HZ_LOW, TICK_HZ),
        _word(Bootstrap.TIMESTAMP_CONTROL, 0, "WO"),
        _word(Bootstrap.TIMESTAMP_HIGH, 0),
        _word(Bootstrap.TIMESTAMP_LOW, 0),
        _word(Bootstrap.CONTROL_PRIVILEGE, 0, "RW"),
        _word(Bootstrap.APPLICATION_PORT, 0),
        _word(Bootstrap.APPLICATION_ADDRESS, 0),
        _word(Bootstrap.STREAM_PORT, 0, "RW"),
        _word(Bootstrap.PACKET_SIZE, 1500, "RW"),
        _word(Bootstrap.PACKET_DELAY, 0, "RW"),
        _word(Bootstrap.STREAM_ADDRESS, 0, "RW"),
        _word(Bootstrap.STREAM_SOURCE_PORT, source_port),
    )


def _identification(model: Model, host: str) -> bytes:
    mac = int.from_bytes(mac_of(host))
    block = bytearray(Bootstrap.USER_NAME)
    for address, value in (
        (Bootstrap.VERSION, 1 << 16 | 2),
        (Bootstrap.DEVICE_MODE, _BIG_ENDIAN_UTF8),
        (Bootstrap.MAC_HIGH, mac >> 32),
        (Bootstrap.MAC_LOW, mac & 0xFFFFFFFF),
        (Bootstrap.IP_SUPPORTED, _SUPPORTED_IP),
        (Bootstrap.IP_CURRENT, 0b101),  # persistent address, as a laboratory sets it
        (Bootstrap.IP_ADDRESS, int(IPv4Address(host))),
        (Bootstrap.SUBNET_MASK, int(IPv4Address("255.0.0.0"))),
    ):
        struct.pack_into(">I", block, address, value)
    for text in (
        _text(Bootstrap.VENDOR, model.vendor, 32),
        _text(Bootstrap.MODEL, model.name, 32),
        _text(Bootstrap.DEVICE_VERSION, model.firmware, 32),
        _text(Bootstrap.INFORMATION, "simulated", 48),
        _text(Bootstrap.SERIAL, model.serial, 16),
    ):
        block[text.address : text.address + len(text.data)] = text.data
    return bytes(block)


def _word(address: Bootstrap, value: int, access: Access = "RO") -> Content:
    return Content(address, struct.pack(">I", value), access)


def _text(address: Bootstrap, text: str, length: int) -> Content:
    data = text.encode()
    if len(data) >= length:
        raise ValueError(f"{address.name} has room for {length - 1} bytes, got '{text}'")
    return Content(address, data.ljust(length, b"\0"))
