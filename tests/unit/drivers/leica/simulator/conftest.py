"""A fast simulated tracker, and a client that knows bytes and no tables of the simulator."""

import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from drivers.leica.simulator.scene import StaticScene
from drivers.leica.simulator.server import TrackerServer
from drivers.leica.simulator.tracker import Machine
from tronlab.twin.state import ArmedFaults

FAST = Machine(initialize_s=0.02, slew_rad_per_s=1000.0, face_turn_s=0.01, search_m_per_s=100.0)
PATIENCE_S = 10.0
SETTINGS_QUIET = (2, 0, 0, 0, 0, 0, 0, 1, 0)
"""Weather monitor computes, no events, no live positions, Nivel."""
SETTINGS_TALKING = (2, 0, 0, 0, 1, 0, 0, 1, 0)


@dataclass(frozen=True)
class Packet:
    """A packet, read at offsets from its start."""

    data: bytes

    @property
    def size(self) -> int:
        return self.at(0, "i")

    @property
    def type(self) -> int:
        return self.at(4, "I")

    @property
    def number(self) -> int:
        """Command of a reply or an error, number of an event."""
        return self.at(8, "I")

    @property
    def status(self) -> int:
        return self.at(12, "I")

    def at(self, offset: int, code: str) -> Any:
        values = struct.unpack_from(f"<{code}", self.data, offset)
        return values[0] if len(values) == 1 else values

    def floats(self, offset: int, n: int = 3) -> np.ndarray:
        return np.array(struct.unpack_from(f"<{n}d", self.data, offset))

    def text(self, offset: int, n_bytes: int) -> str:
        return self.data[offset : offset + n_bytes].decode("utf-16-le").rstrip("\0")


class Client:
    """One connection, blocking."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._socket = socket.create_connection(address, timeout=PATIENCE_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._socket.close()

    def send(self, data: bytes) -> None:
        self._socket.sendall(data)

    def send_command(self, command: int, code: str = "", *values: float) -> None:
        body = struct.pack(f"<{code}", *values)
        self.send(struct.pack("<iIi", 12 + len(body), 0, command) + body)

    def receive(self, timeout_s: float = PATIENCE_S) -> Packet:
        """Give the next packet; EOFError if the server hung up, TimeoutError if nothing came."""
        self._socket.settimeout(timeout_s)
        head = self._exactly(4)
        (size,) = struct.unpack("<i", head)
        return Packet(head + self._exactly(size - 4))

    def _exactly(self, n: int) -> bytes:
        data = b""
        while len(data) < n:
            piece = self._socket.recv(n - len(data))
            if not piece:
                raise EOFError(f"{len(data)} of {n} bytes")
            data += piece
        return data

    def receive_until(self, wanted: Callable[[Packet], bool]) -> list[Packet]:
        """Give everything up to the packet that is wanted."""
        seen: list[Packet] = []
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            seen.append(self.receive())
            if wanted(seen[-1]):
                return seen
        raise TimeoutError(f"not among {len(seen)} packets")

    def receive_for(self, quiet_s: float) -> list[Packet]:
        """Give everything until nothing comes for so long."""
        seen: list[Packet] = []
        with suppress(TimeoutError):
            while True:
                seen.append(self.receive(timeout_s=quiet_s))
        return seen

    def receive_event(self, number: int) -> list[Packet]:
        return self.receive_until(lambda packet: packet.type == 8 and packet.number == number)

    def receive_error(self) -> Packet:
        return self.receive_until(lambda packet: packet.type == 1)[-1]

    def receive_data(self, *types: int) -> Packet:
        return self.receive_until(lambda packet: packet.type in types)[-1]

    def ask(self, command: int, code: str = "", *values: float) -> Packet:
        """Send a command and give its reply, whatever comes before it."""
        self.send_command(command, code, *values)
        return self.receive_until(lambda packet: packet.type == 0 and packet.number == command)[-1]

    def do(self, command: int, code: str = "", *values: float) -> Packet:
        """Send a command that must succeed."""
        packet = self.ask(command, code, *values)
        assert packet.status == 0, f"command {command}: status {packet.status}"
        return packet

    def prepare(self, *, mode: int = 0, time_ms: int = 100, settings=SETTINGS_QUIET) -> None:
        """Metres and radians, CCR-1.5in, everything initialised."""
        self.do(5, "5I", 0, 0, 0, 0, 0)
        self.do(47, "9I", *settings)
        self.do(7)
        self.do(24, "I", mode)
        self.do(40, "i", 7)
        self.do(28, "iI", time_ms, 1)

    def measure(self, *, types: tuple[int, ...]) -> Packet:
        self.do(49)
        return self.receive_data(*types)


@dataclass
class Rig:
    """A server, its scene, its faults, and a client."""

    server: TrackerServer
    scene: StaticScene
    faults: ArmedFaults
    client: Client
    connect: Callable[[], Client]


@pytest.fixture
def make_rig(caplog: pytest.LogCaptureFixture) -> Iterator[Callable[..., Rig]]:
    """Make a rig; at the end no conversation may have ended by a mistake of the server."""
    servers: list[TrackerServer] = []
    clients: list[Client] = []

    def make(*, scene: Any = None, machine: Machine = FAST, **options: Any) -> Rig:
        scene = scene or StaticScene(np.random.default_rng(7), **options)
        faults = ArmedFaults({})
        server = TrackerServer(scene, faults, machine=machine)
        servers.append(server)

        def connect() -> Client:
            clients.append(Client(server.address))
            return clients[-1]

        return Rig(server, scene, faults, connect(), connect)

    yield make
    for client in clients:
        client.close()
    for server in servers:
        server.close()
    assert not [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]


@pytest.fixture
def rig(make_rig: Callable[..., Rig]) -> Rig:
    return make_rig()


@pytest.fixture
def new_client() -> type[Client]:
    """The client, for tests that make their own server."""
    return Client
