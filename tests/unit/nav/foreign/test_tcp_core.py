"""Cores behind a socket: refused, reset, half open, slow to come back, IPv6."""

import json
import re
import socket
import struct
import threading
from collections.abc import Callable, Generator
from contextlib import suppress
from typing import Any

import pytest
from plain_cores import frame, place

from tronlab.errors import ScoreError
from tronlab.nav.core import CoreContext
from tronlab.nav.foreign import ForeignCore, describe_core, open_core
from tronlab.nav.specs import CoreSpec

Reply = Callable[[socket.socket, dict[str, Any]], None]


def send(connection: socket.socket, header: dict[str, Any]) -> None:
    text = json.dumps(header).encode()
    connection.sendall(struct.pack("<4sIQ", b"TLC1", len(text), 0) + text)


def receive(stream: Any) -> dict[str, Any]:
    _, n_header, n_payload = struct.unpack("<4sIQ", stream.read(16))
    header = json.loads(stream.read(n_header))
    payload = stream.read(n_payload)
    return {**header, "sum": payload[0] if payload else 0}


class Server(threading.Thread):
    """A core that listens, with one connection at a time; ``reply`` does what answers a frame."""

    def __init__(self, reply: Reply, address: tuple[str, int] = ("127.0.0.1", 0)) -> None:
        super().__init__(daemon=True)
        family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        self._server = socket.create_server(address, family=family)
        self._reply = reply
        self.n_connections = 0
        host = f"[{address[0]}]" if ":" in address[0] else address[0]
        self.address = f"{host}:{self._server.getsockname()[1]}"
        self.start()

    def run(self) -> None:
        with suppress(OSError):  # closed
            while True:
                connection, _ = self._server.accept()
                self.n_connections += 1
                with (
                    connection,
                    connection.makefile("rb") as stream,
                    suppress(OSError, struct.error),
                ):
                    self._serve(connection, stream)

    def _serve(self, connection: socket.socket, stream: Any) -> None:
        receive(stream)
        send(connection, {"type": "hello", "protocol": 1, "name": "far", "version": "1",
                          "shared_memory": True, "identity": "build 77"})  # fmt: skip
        while (header := receive(stream))["type"] != "bye":
            if header["type"] == "setup":
                assert header["shared_memory"] is None
                send(connection, {"type": "ready"})
            else:
                self._reply(connection, header)

    def close(self) -> None:
        with suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self.join(5.0)


@pytest.fixture
def served() -> Generator[Callable[..., Server]]:
    servers: list[Server] = []

    def make(*arguments: Any) -> Server:
        servers.append(Server(*arguments))
        return servers[-1]

    yield make
    for server in servers:
        server.close()


def spec_of(server: Server) -> CoreSpec:
    return CoreSpec("far", "tcp", server.address)


def answer(connection: socket.socket, header: dict[str, Any]) -> None:
    pose = {"parent": "trs", "child": "cam", "position_m": [header["sum"], 0, 0],
            "quaternion_xyzw": [0, 0, 0, 1]}  # fmt: skip
    send(connection, {"type": "result", "number": header["number"], "status": "ok", "pose": pose})


def reset(connection: socket.socket, header: dict[str, Any]) -> None:
    if header["number"] == 1:  # RST, as a computer that goes down sends it
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        raise OSError
    answer(connection, header)


def other_protocol(connection: socket.socket, header: dict[str, Any]) -> None:
    if header["number"] == 1:
        connection.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
        raise OSError
    answer(connection, header)


def silent(connection: socket.socket, header: dict[str, Any]) -> None:
    if header["number"] != 1:
        answer(connection, header)


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_a_socket_is_a_core_like_any_other(
    served: Callable[..., Server], context: CoreContext, host: str
) -> None:
    server = served(answer, (host, 0))
    described = describe_core(spec_of(server), limit_s=20.0)
    assert (described.name, described.is_sequential) == ("far", False)
    assert described.identity.endswith("far\n1\nbuild 77")
    with open_core(spec_of(server), context, limit_s=20.0) as core:
        for i in range(3):
            result = core.locate(frame(i))
            assert result.trs_from_cam is not None, result.reason
            assert result.trs_from_cam.translation[0] == place(frame(i))[0] / frame(i).image.size
    assert server.n_connections == 2


@pytest.mark.parametrize(
    ("reply", "status", "reason"),
    [
        (reset, "error", "the core (cannot be heard|ended without an answer)"),
        (other_protocol, "error", 'the core wrote "HTTP/1.1 400 Bad Request" where a message was'),
        (silent, "timeout", "no answer within 0.1 s, nor in another 0.1 s: it is silent"),
    ],
)
def test_a_lost_connection_is_made_anew_for_the_next_frame(
    served: Callable[..., Server],
    opened: Callable[..., ForeignCore],
    monkeypatch: pytest.MonkeyPatch,
    reply: Reply,
    status: str,
    reason: str,
) -> None:
    server = served(reply)
    core = opened(spec_of(server))
    assert core.locate(frame(0)).status == "ok"
    with monkeypatch.context() as patch:
        patch.setattr(core, "_limit_s", 0.1 if status == "timeout" else 20.0)
        lost = core.locate(frame(1))
    assert lost.status == status
    assert re.match(reason, lost.reason), lost.reason
    assert core.locate(frame(2)).status == "ok"
    assert server.n_connections == 2


def test_a_core_that_comes_up_again_is_waited_for(
    served: Callable[..., Server], opened: Callable[..., ForeignCore]
) -> None:
    server = served(answer)
    core = opened(spec_of(server))
    assert core.locate(frame(0)).status == "ok"
    core.close()
    server.close()
    port = int(server.address.rpartition(":")[2])
    late = threading.Timer(0.15, lambda: served(answer, ("127.0.0.1", port)))
    late.start()
    assert core.locate(frame(1)).status == "ok"
    late.join()


def test_nobody_there_is_an_error_at_once_and_a_result_later(
    opened: Callable[..., ForeignCore], served: Callable[..., Server]
) -> None:
    server = served(answer)
    server.close()
    spec = spec_of(server)
    with pytest.raises(ScoreError, match=f"cannot be reached at tcp://{server.address}: .*refused"):
        describe_core(spec, limit_s=20.0)
    result = opened(spec, start_limit_s=0.05).locate(frame(0))
    assert (result.status, "cannot be reached" in result.reason) == ("error", True)
    with pytest.raises(ScoreError, match=r"reached at tcp://no-such-host\.invalid:5"):
        describe_core(CoreSpec("x", "tcp", "no-such-host.invalid:5"), limit_s=20.0)
    with pytest.raises(ScoreError, match=r"reached at tcp://a\.\.b:5: .*label empty"):
        describe_core(CoreSpec("x", "tcp", "a..b:5"), limit_s=20.0)


def test_a_listener_that_never_speaks_is_not_waited_for() -> None:
    """Half open: the system accepts the connection, no program does."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        spec = CoreSpec("mute", "tcp", f"127.0.0.1:{server.getsockname()[1]}")
        with pytest.raises(ScoreError, match=r"it is not ready within 0.1 s: it is silent"):
            describe_core(spec, limit_s=0.1)
