"""A scripted peer in the place of a tracker: all it answers is written by literal offsets."""

import contextlib
import socket
import struct
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest

from drivers.leica.driver import LeicaTracker, open_tracker
from tronlab.devices.registry import DeviceContext

P_TOP_LEFT = (3.0, 2.0, 1.0)
P_TMAC = (2.5, 0.25, -0.25)
QUATERNION_WXYZ = (0.5, 0.5, -0.1, np.sqrt(1 - 0.51))
SYSTEM_STATUS, TRACKER_STATUS, SET_UNITS, INITIALIZE, STATION, TRANSFORMATION = 1, 2, 5, 7, 12, 14
SET_AIR, GET_AIR, SET_MODE, SET_CS, SET_STATIONARY, SET_CONTINUOUS = 20, 21, 24, 26, 28, 30
SET_REFLECTOR, GET_REFLECTOR, GET_REFLECTORS, SET_SEARCH, SET_SETTINGS = 40, 41, 42, 43, 47
GET_SETTINGS, START, STOP, CHANGE_FACE, POINT_LASER, FIND, SET_STATISTICS = (
    48,
    49,
    52,
    53,
    58,
    63,
    80,
)
GET_DIRECTION = 66
CHECK_BIRDBATH, GET_FACE, GET_PROBES, PROBE_INFO, SET_LONG, MASK = 87, 98, 103, 119, 120, 122
TRACKER_INFO, METEO = 132, 139
EVERYTHING = 0xFFFFF


def wide(text: str, units: int) -> bytes:
    return text.encode("utf-16-le").ljust(2 * units, b"\0")


def reply(command: int, body: bytes = b"", *, status: int = 0) -> bytes:
    return struct.pack("<iIII", 16 + len(body), 0, command, status) + body


def error(command: int, status: int) -> bytes:
    return struct.pack("<iIII", 16, 1, command, status)


def event(number: int) -> bytes:
    return struct.pack("<iII", 12, 8, number)


def put(packet: bytearray, offset: int, code: str, *values: Any) -> None:
    struct.pack_into("<" + code, packet, offset, *values)


def point(
    p: Sequence[float] = P_TOP_LEFT, *, std: float = 2e-5, covariance: float = 1e-10
) -> bytes:
    packet = bytearray(204)
    put(packet, 0, "iIIII", 204, 9, 0, 0, 0)
    put(packet, 20, "3d", *p)
    put(packet, 44, "3d", std, std, 2 * std)
    put(packet, 76, "3d", covariance, 0.0, 0.0)
    put(packet, 180, "3d", 21.0, 987.0, 44.0)
    return bytes(packet)


def pose(
    p: Sequence[float] = P_TMAC,
    *,
    rotation_status: int = 1,
    q: Sequence[float] = QUATERNION_WXYZ,
    std: float = 2e-5,
    status: int = 0,
) -> bytes:
    packet = bytearray(376)
    put(packet, 0, "iIII", 376, 4, status, 6)
    put(packet, 24, "i", rotation_status)
    put(packet, 48, "3d", *p)
    put(packet, 72, "3d", std, std, 2 * std)
    put(packet, 104, "3d", 1e-10, 0.0, 0.0)
    put(packet, 184, "4d", *q)
    put(packet, 240, "3d", 1e-4, 2e-4, 3e-4)
    put(packet, 272, "3d", 0.0, 0.0, 1e-9)
    put(packet, 352, "3d", 21.0, 987.0, 44.0)
    return bytes(packet)


def stream(positions: Sequence[Sequence[float]], *, point_status: int = 0) -> bytes:
    n = len(positions)
    packet = bytearray(68 + 212 * n)
    put(packet, 0, "iIIiI", len(packet), 5, 0, n, 7)
    for i, p in enumerate(positions):
        start = 68 + 212 * i
        put(packet, start, "IIiii", point_status, 0, 1, 100, 20_000 * i)
        put(packet, start + 20, "3d", *p)
        put(packet, start + 44, "3d", 1e-5, 1e-5, 1e-5)
        put(packet, start + 100, "4d", *QUATERNION_WXYZ)
        put(packet, start + 156, "3d", 1e-4, 1e-4, 1e-4)
    return bytes(packet)


def reflector_list(*types: tuple[int, str]) -> bytes:
    return b"".join(
        reply(
            GET_REFLECTORS,
            struct.pack("<iiId", len(types), number, 1, 0.01905) + wide(name, 32),
        )
        for number, name in types
    )


class Peer:
    """Says to each command what ``answers`` has, and remembers what it was told.

    An answer is bytes, or a function from the request's body to bytes; None is silence.
    """

    put = staticmethod(put)
    reply = staticmethod(reply)
    error = staticmethod(error)
    event = staticmethod(event)
    point = staticmethod(point)
    pose = staticmethod(pose)
    stream = staticmethod(stream)
    reflector_list = staticmethod(reflector_list)
    p_top_left = P_TOP_LEFT
    p_tmac = P_TMAC
    quaternion_wxyz = QUATERNION_WXYZ

    def __init__(self) -> None:
        self.requests: list[tuple[int, bytes]] = []
        self.greeting = b""
        self.hangs_up_at_once = False
        self.mask = EVERYTHING
        self.tracker_status = 2
        self.face = 1
        self.reflector = 0
        self.n_clients = 0
        self.answers: dict[int, bytes | Callable[[bytes], bytes | None] | None] = {
            SYSTEM_STATUS: reply(
                SYSTEM_STATUS, struct.pack("<IIIIiiiIii", 0, 5, 3, 2, 3, 6, 412, 2, 0, 2345)
            ),
            TRACKER_STATUS: lambda _: reply(TRACKER_STATUS, struct.pack("<I", self.tracker_status)),
            GET_REFLECTORS: reflector_list((4, "RRR-0.5in"), (7, "CCR-1.5in")),
            GET_SETTINGS: reply(GET_SETTINGS, struct.pack("<9I", 0, 1, 1, 0, 0, 1, 1, 1, 0)),
            GET_AIR: reply(GET_AIR, struct.pack("<3d", 21.5, 987.5, 44.0)),
            GET_DIRECTION: reply(GET_DIRECTION, struct.pack("<2d", 0.25, 1.5)),
            GET_FACE: lambda _: reply(GET_FACE, struct.pack("<I", self.face)),
            SET_REFLECTOR: self._select,
            GET_REFLECTOR: lambda _: reply(GET_REFLECTOR, struct.pack("<i", self.reflector)),
            START: reply(START) + pose(),
            MASK: lambda _: reply(MASK, struct.pack("<Ii", 0, self.mask)),
            PROBE_INFO: reply(PROBE_INFO, struct.pack("<iiiI10i", 1, 7, 877, 5, *[0] * 10)),
            GET_PROBES: reply(
                GET_PROBES,
                struct.pack("<iiiIi", 1, 3, 877, 5, 4) + wide("T-MAC front", 32) + wide("", 128),
            ),
            TRACKER_INFO: reply(
                TRACKER_INFO,
                struct.pack("<I64si", 14, wide("AT901-MR", 32), 2345)
                + bytes(68)
                + struct.pack("<ii", 2, 19),
            ),
            METEO: reply(METEO, struct.pack("<I64sii", 1, wide("Thommen", 32), 1, 0)),
        }
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._client: socket.socket | None = None
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.hang_up()
        self._thread.join(5.0)
        assert not self._thread.is_alive()

    def hang_up(self) -> None:
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.shutdown(socket.SHUT_RDWR)

    def say(self, data: bytes) -> None:
        """Send without being asked."""
        assert self._client is not None
        self._client.sendall(data)

    def told(self, *commands: int) -> list[int]:
        """Which of these commands came, in order."""
        return [command for command, _ in self.requests if command in commands]

    def last(self, command: int) -> bytes:
        return [body for number, body in self.requests if number == command][-1]

    def locks_when_searched(self, bit: int, *, at: Sequence[float] | None = None) -> None:
        """Have the peer see nothing until a search; ``at`` limits where it finds something."""
        self.mask = EVERYTHING & ~bit
        pointed = [0.0, 0.0, 0.0]

        def point_laser(body: bytes) -> bytes:
            pointed[:] = struct.unpack("<3d", body)
            self.mask &= ~bit
            return reply(POINT_LASER)

        def find(_: bytes) -> bytes:
            if at is not None and pointed != list(at):
                return reply(FIND, status=701)
            self.mask |= bit
            return reply(FIND)

        self.answers |= {POINT_LASER: point_laser, FIND: find}

    def _select(self, body: bytes) -> bytes:
        (self.reflector,) = struct.unpack("<i", body)
        return reply(SET_REFLECTOR)

    def _serve(self) -> None:
        while True:
            try:
                self._client, _ = self._listener.accept()
            except OSError:
                return
            self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.n_clients += 1
            with self._client, contextlib.suppress(OSError, EOFError):
                self._client.sendall(self.greeting)
                while not self.hangs_up_at_once:
                    self._answer(*self._request(self._client))

    def _request(self, client: socket.socket) -> tuple[int, bytes]:
        size, kind, command = struct.unpack("<iII", _exactly(client, 12))
        assert kind == 0
        return command, _exactly(client, size - 12)

    def _answer(self, command: int, body: bytes) -> None:
        self.requests.append((command, body))
        answer = self.answers.get(command, reply(command))
        data = answer(body) if callable(answer) else answer
        if data is not None:
            self.say(data)


def _exactly(client: socket.socket, n: int) -> bytes:
    data = b""
    while len(data) < n:
        piece = client.recv(n - len(data))
        if not piece:
            raise EOFError
        data += piece
    return data


@pytest.fixture
def peer() -> Iterator[Peer]:
    peer = Peer()
    yield peer
    peer.close()


@pytest.fixture
def make(peer: Peer) -> Iterator[Callable[..., LeicaTracker]]:
    made: list[LeicaTracker] = []

    def make_one(name: str = "tracker", **options: Any) -> LeicaTracker:
        values: dict[str, Any] = {
            "host": "127.0.0.1",
            "port": peer.port,
            "reflectors": {"top_left": {"p_trk_m": list(P_TOP_LEFT), "type": "CCR-1.5in"}},
            "tmac": {"p_trk_m": list(P_TMAC)},
            "timeout_s": 0.5,
            "lock_timeout_s": 0.1,
            "move_timeout_s": 0.6,
            "initialize_timeout_s": 0.8,
        }
        context = DeviceContext(name=name, options=values | options, seed=0, world=None)
        made.append(open_tracker(context))
        return made[-1]

    yield make_one
    for tracker in made:
        tracker.close()


@pytest.fixture
def tracker(make: Callable[..., LeicaTracker]) -> LeicaTracker:
    tracker = make()
    tracker.connect()
    return tracker
