"""The stream protocol on the wire: an image as leader, payload packets and trailer of GVSP 1.2."""

import struct
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from drivers.gige.simulator.gvcp import Status

UDP_HEADERS_BYTES: Final = 28
"""IP and UDP headers, which the packet size of a stream channel includes."""

_HEADER: Final = struct.Struct(">HHI")
_LEADER: Final = struct.Struct(">HHQIIIIIHH")
_TRAILER: Final = struct.Struct(">HHI")
_LEADER_FORMAT: Final = 1 << 24
_TRAILER_FORMAT: Final = 2 << 24
_PAYLOAD_FORMAT: Final = 3 << 24
_IMAGE: Final = 0x0001
_LAST_BLOCK_ID: Final = 0xFFFF

MONO8: Final = 0x01080001
MONO12: Final = 0x01100005
MONO12_PACKED: Final = 0x010C0006
PIXEL_FORMATS: Final = {"Mono8": MONO8, "Mono12": MONO12, "Mono12Packed": MONO12_PACKED}
"""Code by name; bits 16 to 23 of a code are the bits a pixel takes."""

GreyImage: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class Frame:
    """An image with what its leader says of it."""

    block_id: int
    timestamp_ticks: int
    pixel_format: int
    left_px: int
    top_px: int
    image: GreyImage
    """Grey values, shape (rows, columns); 12 bits in uint16 unless the format is Mono8."""


def next_block_id(block_id: int) -> int:
    """Count blocks in 16 bits; 0 is the block id of test packets, so it is left out."""
    return block_id % _LAST_BLOCK_ID + 1


def payload_bytes(width_px: int, height_px: int, pixel_format: int) -> int:
    """Give the size of an image on the wire."""
    return -(-width_px * height_px * (pixel_format >> 16 & 0xFF) // 8)


def encode_pixels(image: GreyImage, pixel_format: int) -> NDArray[np.uint8]:
    """Give the bytes of an image, row after row, shape (n,)."""
    flat = np.ascontiguousarray(image).reshape(-1)
    if pixel_format == MONO8:
        return flat.astype(np.uint8, copy=False)
    if pixel_format == MONO12:
        return flat.astype("<u2", copy=False).view(np.uint8)
    return _pack_pairs(flat)[: -(-flat.size * 3 // 2)]


def _pack_pairs(codes: NDArray[np.uint16 | np.uint8]) -> NDArray[np.uint8]:
    """Pack two pixels of 12 bits into three bytes: high bits, both low nibbles, high bits."""
    first, second = codes[0::2], np.zeros(-(-codes.size // 2), np.uint16)
    second[: codes.size // 2] = codes[1::2]
    packed = np.empty((first.size, 3), np.uint8)
    packed[:, 0] = first >> 4
    packed[:, 1] = (second & 0xF) << 4 | first & 0xF
    packed[:, 2] = second >> 4
    return packed.reshape(-1)


class Block:
    """A frame cut into packets: 0 is the leader, ``n_packets + 1`` the trailer."""

    def __init__(self, frame: Frame, *, packet_bytes: int) -> None:
        """Cut a frame.

        Args:
            frame: The frame.
            packet_bytes: Size of a packet with its IP, UDP and GVSP headers.
        """
        self.block_id = frame.block_id
        self.udp_bytes = packet_bytes - UDP_HEADERS_BYTES
        """Size of every payload packet but the last, from the GVSP header on."""
        self._payload = _cut(
            encode_pixels(frame.image, frame.pixel_format), frame.block_id, self.udp_bytes
        )
        self.n_packets = -(-len(self._payload) // self.udp_bytes)
        """Number of payload packets."""
        self._leader = _leader(frame)
        self._trailer = _trailer(frame, self.n_packets + 1)

    @property
    def last_id(self) -> int:
        """Get the packet id of the trailer."""
        return self.n_packets + 1

    def packet(self, packet_id: int) -> bytes | memoryview:
        """Give one packet from its GVSP header on."""
        if packet_id == 0:
            return self._leader
        if packet_id == self.last_id:
            return self._trailer
        return self.payload_packets(packet_id, 1)

    def payload_packets(self, first_id: int, n: int) -> memoryview:
        """Give up to ``n`` payload packets from ``first_id`` on, one behind the other."""
        start = (first_id - 1) * self.udp_bytes
        return self._payload[start : start + n * self.udp_bytes]


def resent(packet: bytes | memoryview) -> bytes:
    """Give a packet marked as one that was asked for again."""
    return Status.PACKET_RESENT.to_bytes(2) + packet[2:]


def unavailable(block_id: int, packet_id: int) -> bytes:
    """Give the packet that says that one asked for again is not held any more."""
    return _HEADER.pack(Status.PACKET_UNAVAILABLE, block_id, _PAYLOAD_FORMAT | packet_id)


def test_packet(packet_bytes: int) -> bytes:
    """Give a packet of that size, to find out which sizes arrive."""
    padding = bytes(packet_bytes - UDP_HEADERS_BYTES - _HEADER.size)
    return _HEADER.pack(Status.SUCCESS, 0, _PAYLOAD_FORMAT) + padding


def garbage(block_id: int) -> tuple[bytes, ...]:
    """Give packets no receiver may make anything of, as a faulty switch would let through."""
    beyond_every_image = 0xFFFFF0
    return (
        b"",
        b"\x00\x00\x00",
        _HEADER.pack(Status.SUCCESS, block_id, 0x7F << 24 | 1) + bytes(64),
        _HEADER.pack(Status.SUCCESS, block_id, _PAYLOAD_FORMAT | beyond_every_image) + bytes(64),
        _HEADER.pack(Status.SUCCESS, block_id, _LEADER_FORMAT) + b"\xff" * 5,
        _HEADER.pack(Status.LOCAL_PROBLEM, block_id, _PAYLOAD_FORMAT | 1) + b"\xff" * 64,
    )


def _cut(data: NDArray[np.uint8], block_id: int, udp_bytes: int) -> memoryview:
    """Give all payload packets one behind the other, each with its header."""
    room = udp_bytes - _HEADER.size
    n, n_full = -(-data.size // room), data.size // room
    packets = np.empty((n, udp_bytes), np.uint8)
    headers = np.empty((n, 2), ">u4")
    headers[:, 0] = block_id
    headers[:, 1] = _PAYLOAD_FORMAT + np.arange(1, n + 1)
    packets[:, : _HEADER.size] = headers.view(np.uint8)
    packets[:n_full, _HEADER.size :] = data[: n_full * room].reshape(n_full, room)
    rest = data[n_full * room :]
    packets[n_full:, _HEADER.size : _HEADER.size + rest.size] = rest
    return packets.reshape(-1).data[: data.size + n * _HEADER.size]


def _leader(frame: Frame) -> bytes:
    height_px, width_px = frame.image.shape
    return _HEADER.pack(Status.SUCCESS, frame.block_id, _LEADER_FORMAT) + _LEADER.pack(
        0,
        _IMAGE,
        frame.timestamp_ticks,
        frame.pixel_format,
        width_px,
        height_px,
        frame.left_px,
        frame.top_px,
        0,
        0,
    )


def _trailer(frame: Frame, packet_id: int) -> bytes:
    header = _HEADER.pack(Status.SUCCESS, frame.block_id, _TRAILER_FORMAT | packet_id)
    return header + _TRAILER.pack(0, _IMAGE, frame.image.shape[0])
