"""A GigE Vision host of its own, byte by byte, that trusts nothing of the simulator's tables."""

import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import pytest

from drivers.gige.simulator.device import CameraServer
from drivers.gige.simulator.features import ADDRESSES
from drivers.gige.simulator.scene import PatternScene
from tronlab.twin.state import ArmedFaults

ANSWER_S = 5.0
"""Longest wait for an answer that must come."""
SILENCE_S = 0.3
"""How long nothing must come."""

LEADER_FIELDS = (
    "payload_type",
    "timestamp",
    "pixel_format",
    "width",
    "height",
    "left",
    "top",
    "pad_x",
    "pad_y",
)
CCP, SCP, SCPS, SCDA = 0xA00, 0xD00, 0xD04, 0xD18


class NoAnswerError(TimeoutError):
    """Nothing came."""


class Host:
    """An application at one UDP port."""

    def __init__(self, camera: CameraServer, *, ip: str = "127.0.0.1") -> None:
        self.camera = camera
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((ip, 0))
        self.request_id = 0
        self.sent = b""

    def send(self, command: int, payload: bytes, *, flags: int = 1) -> None:
        self.request_id = self.request_id % 65535 + 1
        self.sent = struct.pack(">BBHHH", 0x42, flags, command, len(payload), self.request_id)
        self.sent += payload
        self.socket.sendto(self.sent, self.camera.address)

    def receive(self, *, timeout_s: float = ANSWER_S) -> tuple[int, int, bytes]:
        """Give status, acknowledged command and payload."""
        self.socket.settimeout(timeout_s)
        try:
            datagram, _ = self.socket.recvfrom(2048)
        except TimeoutError as error:
            raise NoAnswerError from error
        status, number, length, request_id = struct.unpack_from(">HHHH", datagram)
        assert (length, request_id) == (len(datagram) - 8, self.request_id)
        return status, number, datagram[8:]

    def ask(self, command: int, payload: bytes) -> tuple[int, bytes]:
        self.send(command, payload)
        status, number, answer = self.receive()
        assert number == command + 1
        return status, answer

    def try_read(self, *addresses: int) -> tuple[int, bytes]:
        return self.ask(0x80, struct.pack(f">{len(addresses)}I", *addresses))

    def read(self, address: int) -> int:
        status, answer = self.try_read(address)
        assert status == 0, hex(status)
        return struct.unpack(">I", answer)[0]

    def read_memory(self, address: int, n: int) -> tuple[int, bytes]:
        status, answer = self.ask(0x84, struct.pack(">IHH", address, 0, n))
        return status, answer[4:]

    def write_memory(self, address: int, data: bytes) -> tuple[int, bytes]:
        return self.ask(0x86, struct.pack(">I", address) + data)

    def try_write(self, address: int, value: int) -> int:
        return self.ask(0x82, struct.pack(">II", address, value))[0]

    def write(self, address: int, value: int) -> None:
        status = self.try_write(address, value)
        assert status == 0, f"{address:#x} = {value}: {status:#x}"

    def get(self, feature: str) -> int:
        return self.read(ADDRESSES[feature])

    def set(self, **features: int) -> None:
        for name, value in features.items():
            self.write(ADDRESSES[name], value)

    def try_set(self, feature: str, value: int) -> int:
        return self.try_write(ADDRESSES[feature], value)

    def take_control(self) -> "Host":
        self.write(CCP, 2)
        return self

    def ask_again(self, block_id: int, first: int, last: int, *, channel: int = 0) -> None:
        self.send(0x40, struct.pack(">HHII", channel, block_id, first, last), flags=0)

    def expect_silence(self) -> None:
        with pytest.raises(NoAnswerError):
            self.receive(timeout_s=SILENCE_S)


@dataclass
class Packet:
    status: int
    block_id: int
    format: int
    packet_id: int
    data: bytes

    @classmethod
    def parse(cls, datagram: bytes) -> "Packet":
        status, block_id, word = struct.unpack_from(">HHI", datagram)
        return cls(status, block_id, word >> 24, word & 0xFFFFFF, datagram[8:])


@dataclass
class Received:
    """One frame as it arrived."""

    packets: dict[int, Packet] = field(default_factory=dict)

    @property
    def block_id(self) -> int:
        return next(iter(self.packets.values())).block_id

    @property
    def leader(self) -> dict[str, int]:
        values = struct.unpack(">xxHQIIIIIHH", self.packets[0].data)
        return dict(zip(LEADER_FIELDS, values, strict=True))

    @property
    def data(self) -> bytes:
        return b"".join(
            packet.data for _, packet in sorted(self.packets.items()) if packet.format == 3
        )

    @property
    def missing(self) -> set[int]:
        return set(range(max(self.packets) + 1)) - set(self.packets)


class Stream:
    """A stream channel and the host in control behind it."""

    def __init__(self, host: Host, *, packet_bytes: int = 1500) -> None:
        self.host = host
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self.socket.bind(("127.0.0.1", 0))
        host.write(SCPS, packet_bytes)
        host.write(SCDA, 0x7F000001)
        host.write(SCP, self.socket.getsockname()[1])

    def datagram(self, *, timeout_s: float = ANSWER_S) -> bytes:
        self.socket.settimeout(timeout_s)
        try:
            return self.socket.recv(65536)
        except TimeoutError as error:
            raise NoAnswerError from error

    def packet(self, *, timeout_s: float = ANSWER_S) -> Packet:
        return Packet.parse(self.datagram(timeout_s=timeout_s))

    def frame(self, *, timeout_s: float = ANSWER_S) -> Received:
        """Receive up to a trailer."""
        frame = Received()
        while True:
            packet = self.packet(timeout_s=timeout_s)
            frame.packets[packet.packet_id] = packet
            if packet.format == 2:
                return frame

    def expect_silence(self) -> None:
        with pytest.raises(NoAnswerError):
            self.datagram(timeout_s=SILENCE_S)


@pytest.fixture
def faults() -> ArmedFaults:
    return ArmedFaults()


@pytest.fixture
def camera(faults: ArmedFaults) -> Iterator[Callable[..., CameraServer]]:
    """Start a camera; keyword arguments are the server's."""
    with ExitStack() as stack:

        def start(**options: Any) -> CameraServer:
            scene = options.pop("scene", PatternScene())
            server = CameraServer(scene, options.pop("faults", faults), **options)
            stack.callback(server.close)
            return server

        yield start


@pytest.fixture
def hosts() -> Iterator[Callable[..., Host]]:
    """Make hosts of a camera."""
    with ExitStack() as stack:

        def make(camera: CameraServer, **options: Any) -> Host:
            host = Host(camera, **options)
            stack.callback(host.socket.close)
            return host

        yield make


@pytest.fixture
def host(camera: Callable[..., CameraServer], hosts: Callable[..., Host]) -> Host:
    """The host in control of a camera."""
    return hosts(camera()).take_control()


@pytest.fixture
def streams() -> Iterator[Callable[..., Stream]]:
    """Open stream channels."""
    with ExitStack() as stack:

        def make(host: Host, **options: Any) -> Stream:
            stream = Stream(host, **options)
            stack.callback(stream.socket.close)
            return stream

        yield make


@pytest.fixture
def triggered() -> Callable[[Stream], Stream]:
    """Make a camera take images of 64 x 48 pixels for 10 us, one for each software trigger."""

    def prepare(stream: Stream) -> Stream:
        stream.host.set(Width=64, Height=48, ExposureTimeAbs=10, TriggerMode=1, TriggerSource=6)
        return stream

    return prepare


@pytest.fixture
def small(host: Host, streams: Callable[..., Stream], triggered: Callable[..., Stream]) -> Stream:
    """A stream of such images."""
    return triggered(streams(host))
