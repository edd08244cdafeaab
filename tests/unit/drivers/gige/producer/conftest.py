"""The producer's C interface for the tests, and a camera that does as each test tells it."""

import ctypes
import enum
import os
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from drivers.gige.producer import producer_path, why_missing

LEADER, TRAILER, PAYLOAD = 1, 2, 3
MONO8 = 0x01080001
WIDTH, HEIGHT = 40, 20
PACKET_SIZE = 136
CHUNK = PACKET_SIZE - 36
FOR_EVER = 2**64 - 1


class Code(enum.IntEnum):
    """The error codes of GenTL."""

    ERROR = -1001
    NOT_INITIALIZED = -1002
    NOT_IMPLEMENTED = -1003
    RESOURCE_IN_USE = -1004
    ACCESS_DENIED = -1005
    INVALID_HANDLE = -1006
    INVALID_ID = -1007
    INVALID_PARAMETER = -1009
    IO = -1010
    TIMEOUT = -1011
    ABORT = -1012
    NOT_AVAILABLE = -1014
    INVALID_ADDRESS = -1015
    BUFFER_TOO_SMALL = -1016
    INVALID_INDEX = -1017
    BUSY = -1022


class Library:
    """The C interface: ``library("TLOpen", ...)`` raises RuntimeError("CODE: text") on an error."""

    def __init__(self) -> None:
        path = os.environ.get("TRONLAB_TEST_PRODUCER") or producer_path()
        if path is None:
            pytest.skip(why_missing())
        self.functions = ctypes.CDLL(str(path))

    def __call__(self, function: str, *arguments: Any) -> None:
        code = self.functions[function](*arguments)
        if code:
            last, size = ctypes.c_int32(), ctypes.c_size_t(300)
            text = ctypes.create_string_buffer(300)
            self.functions.GCGetLastError(ctypes.byref(last), text, ctypes.byref(size))
            assert last.value == code
            raise RuntimeError(f"{Code(code).name}: {text.value.decode()}")

    def open(self, function: str, *arguments: Any) -> ctypes.c_void_p:
        """Call a function whose last argument is a handle that it fills."""
        handle = ctypes.c_void_p()
        self(function, *arguments, ctypes.byref(handle))
        return handle

    def count(self, function: str, handle: ctypes.c_void_p) -> int:
        value = ctypes.c_uint32(99)
        self(function, handle, ctypes.byref(value))
        return value.value

    def number(self, function: str, *arguments: Any) -> int:
        """Ask an information command for a number of any size."""
        value, size, kind = ctypes.c_uint64(), ctypes.c_size_t(8), ctypes.c_int32()
        self(function, *arguments, ctypes.byref(kind), ctypes.byref(value), ctypes.byref(size))
        return value.value

    def text(self, function: str, *arguments: Any) -> str:
        text, size = ctypes.create_string_buffer(600), ctypes.c_size_t(600)
        self(function, *arguments, text, ctypes.byref(size))
        return text.value.decode()

    def info(self, function: str, *arguments: Any) -> str:
        """Ask an information command for a text."""
        return self.text(function, *arguments, ctypes.byref(ctypes.c_int32()))

    def read(self, port: ctypes.c_void_p, address: int, size: int) -> bytes:
        buffer, n_bytes = ctypes.create_string_buffer(size), ctypes.c_size_t(size)
        self("GCReadPort", port, ctypes.c_uint64(address), buffer, ctypes.byref(n_bytes))
        return buffer.raw

    def write(self, port: ctypes.c_void_p, address: int, data: bytes) -> None:
        n_bytes = ctypes.c_size_t(len(data))
        self("GCWritePort", port, ctypes.c_uint64(address), data, ctypes.byref(n_bytes))

    def wait(self, event: ctypes.c_void_p, timeout_ms: int) -> bytes:
        data, size = ctypes.create_string_buffer(128), ctypes.c_size_t(128)
        self("EventGetData", event, data, ctypes.byref(size), ctypes.c_uint64(timeout_ms))
        return data.raw[: size.value]

    def wait_buffer(self, event: ctypes.c_void_p, timeout_ms: int = 5000) -> ctypes.c_void_p:
        return ctypes.c_void_p(struct.unpack("PP", self.wait(event, timeout_ms))[0])


@dataclass
class Camera:
    """A GigE Vision camera on loopback: a memory behind GVCP, and frames on demand.

    ``react`` may answer a command in its place: with bytes, with ``b""`` not at all, with None as
    usual. It is called with the command, its request id and its payload.
    """

    serial: bytes = b"S-17"
    is_mute: bool = False
    largest_test_packet: int = 0
    react: Callable[[int, int, bytes], bytes | None] | None = None
    memory: bytearray = field(default_factory=lambda: bytearray(0x3000))
    commands: list[tuple[int, int, bytes]] = field(default_factory=list)
    flags: list[tuple[int, int]] = field(default_factory=list)
    client: Any = None

    def __post_init__(self) -> None:
        self.memory[0x0A:0x10] = bytes.fromhex("0a0b0c0d0e0f")
        for address, text in (
            (0x48, b"Maker"),
            (0x68, b"Model 7"),
            (0x88, b"1.2.3"),
            (0xD8, self.serial),
            (0xE8, b"upper deck"),
            (0x200, b"Local:camera.zip;2000;700"),
        ):
            self.memory[address : address + len(text)] = text
        self.put(0x938, 1500)
        self.put(0x940, 36_858_974)
        self.put(0xD04, PACKET_SIZE)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self.socket.getsockname()[1]}"
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    def close(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stopper:
            stopper.sendto(b"stop", self.socket.getsockname())
        self.thread.join()
        self.socket.close()

    def get(self, address: int) -> int:
        return struct.unpack_from(">I", self.memory, address)[0]

    def put(self, address: int, value: int) -> None:
        struct.pack_into(">I", self.memory, address, value)

    def serve(self) -> None:
        while True:
            datagram, self.client = self.socket.recvfrom(2000)
            if datagram == b"stop":
                return
            _, command, _, request_id = struct.unpack(">HHHH", datagram[:8])
            payload = datagram[8:]
            self.flags.append((command, datagram[1]))
            self.commands.append((command, request_id, payload))
            if self.is_mute:
                continue
            answer = self.react(command, request_id, payload) if self.react else None
            if answer is None:
                answer = self.answer(command, request_id, payload)
            if answer:
                self.socket.sendto(answer, self.client)

    def answer(self, command: int, request_id: int, payload: bytes) -> bytes:
        result = b""
        if command == 0x40:
            return b""
        if command == 0x02:
            result = bytes(self.memory[:0xF8])
        elif command == 0x80:
            address = struct.unpack(">I", payload)[0]
            result = bytes(self.memory[address : address + 4])
        elif command == 0x84:
            address, size = struct.unpack(">IxxH", payload)
            result = payload[:4] + bytes(self.memory[address : address + size])
        elif command in {0x82, 0x86}:
            address = struct.unpack(">I", payload[:4])[0]
            self.memory[address : address + len(payload) - 4] = payload[4:]
            if address == 0xD04:
                self.fire_test_packet()
            result = struct.pack(">HH", 0, 1)
        return struct.pack(">HHHH", 0, command + 1, len(result), request_id) + result

    def fire_test_packet(self) -> None:
        size = self.get(0xD04) & 0xFFFF
        if self.get(0xD04) >> 31 and size <= self.largest_test_packet:
            self.send(bytes(size - 28))
        self.put(0xD04, size)

    def send(self, packet: bytes, *, source: str = "127.0.0.1") -> None:
        host = socket.inet_ntoa(struct.pack(">I", self.get(0xD18)))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.bind((source, 0))
            sender.sendto(packet, (host, self.get(0xD00)))

    def packets(self, block_id: int, *, ticks: int = 0, fill: int = 0) -> list[bytes]:
        """The leader, 8 payload packets of ``fill + i`` and the trailer of a frame."""
        geometry = (0, 1, ticks, MONO8, WIDTH, HEIGHT, 4, 2, 0, 0)
        data = [bytes([fill + i]) * CHUNK for i in range(WIDTH * HEIGHT // CHUNK)]
        return [
            stream_packet(block_id, LEADER, 0, struct.pack(">HHQIIIIIHH", *geometry)),
            *(stream_packet(block_id, PAYLOAD, i + 1, part) for i, part in enumerate(data)),
            stream_packet(block_id, TRAILER, len(data) + 1, struct.pack(">HHI", 0, 1, HEIGHT)),
        ]

    def send_error(self, block_id: int, packet_id: int, status: int) -> None:
        self.send(stream_packet(block_id, PAYLOAD, packet_id, b"", status))

    def requested(self) -> list[tuple[int, int, int]]:
        """The resend requests so far: block, first and last packet."""
        seen = [payload for command, _, payload in self.commands if command == 0x40]
        return [struct.unpack(">HHII", payload)[1:] for payload in seen]

    def flags_of(self, command: int) -> set[int]:
        return {flags for seen, flags in self.flags if seen == command}

    def n_commands(self, command: int, address: int | None = None) -> int:
        start = b"" if address is None else struct.pack(">I", address)
        return sum(c == command and payload.startswith(start) for c, _, payload in self.commands)


def stream_packet(block_id: int, kind: int, packet_id: int, rest: bytes, status: int = 0) -> bytes:
    return struct.pack(">HHI", status, block_id, kind << 24 | packet_id) + rest


@dataclass
class Stream:
    """An acquisition that runs, with the memory of each buffer."""

    library: Library
    handle: ctypes.c_void_p
    event: ctypes.c_void_p
    memories: dict[int, Any]

    def info(self, buffer: ctypes.c_void_p, command: int) -> int:
        return self.library.number("DSGetBufferInfo", self.handle, buffer, command)

    def next_frame(self) -> dict[str, Any]:
        """Wait for a frame and queue its buffer again."""
        buffer = self.library.wait_buffer(self.event)
        asked = {"id": 16, "is_incomplete": 7, "ticks": 3, "filled": 9, "width": 10, "lines": 22}
        frame: dict[str, Any] = {key: self.info(buffer, asked[key]) for key in asked}
        frame["bytes"] = self.memories[buffer.value or 0].raw
        self.library("DSQueueBuffer", self.handle, buffer)
        return frame


class Bench:
    """An open system, its cameras, and what is opened of them."""

    def __init__(self, library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
        self.library = library
        self.monkeypatch = monkeypatch
        self.cameras: list[Camera] = []
        self.system = library.open("TLOpen")

    def camera(self, **options: Any) -> Camera:
        self.cameras.append(Camera(**options))
        routes = ",".join(camera.address for camera in self.cameras)
        self.monkeypatch.setenv("TRONLAB_GEV_INTERFACES", routes)
        return self.cameras[-1]

    def interface(self, camera: Camera) -> ctypes.c_void_p:
        self.library("TLUpdateInterfaceList", self.system, None, ctypes.c_uint64(100))
        interface = self.library.open("TLOpenInterface", self.system, camera.address.encode())
        self.library("IFUpdateDeviceList", interface, None, ctypes.c_uint64(500))
        return interface

    def device(self, camera: Camera, access: int = 3) -> ctypes.c_void_p:
        return self.open_first(self.interface(camera), access)

    def open_first(self, interface: ctypes.c_void_p, access: int = 3) -> ctypes.c_void_p:
        camera_id = self.library.text("IFGetDeviceID", interface, 0).encode()
        return self.library.open("IFOpenDevice", interface, camera_id, access)

    def port(self, camera: Camera) -> ctypes.c_void_p:
        return self.library.open("DevGetPort", self.device(camera))

    def stream(self, device: ctypes.c_void_p, n_buffers: int = 4) -> Stream:
        handle = self.library.open("DevOpenDataStream", device, b"Stream0")
        event = self.library.open("GCRegisterEvent", handle, 1)
        memories: dict[int, Any] = {}
        for _ in range(n_buffers):
            memory = ctypes.create_string_buffer(WIDTH * HEIGHT)
            size = ctypes.c_size_t(len(memory))
            buffer = self.library.open("DSAnnounceBuffer", handle, memory, size, None)
            self.library("DSQueueBuffer", handle, buffer)
            memories[buffer.value or 0] = memory
        self.library("DSStartAcquisition", handle, 0, ctypes.c_uint64(FOR_EVER))
        return Stream(self.library, handle, event, memories)


@pytest.fixture
def closed_library() -> Library:
    """The library before GCInitLib."""
    return Library()


@pytest.fixture
def library(closed_library: Library) -> Iterator[Library]:
    closed_library("GCInitLib")
    yield closed_library
    closed_library("GCCloseLib")


@pytest.fixture
def bench(library: Library, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    bench = Bench(library, monkeypatch)
    yield bench
    library("TLClose", bench.system)
    for camera in bench.cameras:
        camera.close()
