"""KUKAVARPROXY and C3 Bridge: golden bytes of the specification, and the client against a peer."""

import socket
import struct
import threading
import time

import py_openshowvar
import pytest

from drivers.kuka.backend import Command, CommandKind, Mode
from drivers.kuka.kvp import KvpClient, decode_reply, read_request, write_request
from drivers.kuka.kvp_backend import KvpBackend
from drivers.kuka.options import KvpOptions
from drivers.kuka.position import Axes
from tronlab.errors import (
    DeviceFaultError,
    DeviceTimeoutError,
    NotConnectedError,
    ProtocolError,
)
from tronlab.kinematics.kr16 import forward

# From the C3 Bridge Interface Protocol 1.5.
READ_ACCU = bytes.fromhex("01 00 00 0E 00 00 0B 24 41 43 43 55 5F 53 54 41 54 45")
ACCU_IS_OK = bytes.fromhex("01 00 00 10 00 00 0A 23 43 48 41 52 47 45 5F 4F 4B 00 01 01")
WRITE_OVERRIDE = bytes.fromhex("01 00 00 0E 01 00 07 24 4F 56 5F 50 52 4F 00 02 33 35")
OVERRIDE_IS_35 = bytes.fromhex("01 00 00 08 01 00 02 33 35 00 01 01")


def test_a_request_to_read_has_the_bytes_of_the_specification():
    assert read_request(256, "$ACCU_STATE") == READ_ACCU


def test_a_request_to_write_has_the_bytes_of_the_specification():
    assert write_request(256, "$OV_PRO", "35") == WRITE_OVERRIDE


def test_the_replies_of_the_specification_are_read():
    reply = decode_reply(ACCU_IS_OK)
    assert (reply.tag, reply.kind, reply.value) == (256, 0, "#CHARGE_OK")
    assert (reply.code, reply.is_success) == (1, True)
    reply = decode_reply(OVERRIDE_IS_35)
    assert (reply.tag, reply.kind, reply.value, reply.is_success) == (256, 1, "35", True)


@pytest.mark.parametrize("footer", [b"\x00\x01\x00", b"\x00\x00\x00", b"\x00\x02\x00"])
def test_a_reply_succeeds_only_if_its_last_byte_is_not_zero(footer):
    reply = decode_reply(b"\x00\x07\x00\x06\x00\x00\x00" + footer)
    assert not reply.is_success
    assert reply.code == footer[1]


@pytest.mark.parametrize("body", [b"", b"\x00\x00\x00\x00\x01", b"\x00\x00\x05ab\x00\x01\x01"])
def test_lengths_that_contradict_each_other_are_an_error(body):
    with pytest.raises(ValueError, match=r"expected 6 or more|but says 5"):
        decode_reply(struct.pack(">HH", 1, len(body)) + body)


class Peer:
    """A server of variables; ``answer`` makes the bytes of every reply."""

    def __init__(self):
        self.variables = {"A": "1"}
        self.n_clients = 0
        self.written: list[tuple[str, str]] = []
        self.piece = 1 << 16
        self.is_mute = False
        self.reply_before: bytes = b""
        self.footer = b"\x00\x01\x01"
        self._connection: socket.socket | None = None
        self._is_over = threading.Event()
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.02)
        self.port = self._server.getsockname()[1]
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def drop(self):
        while self._connection is None:
            time.sleep(0.005)
        self._connection.shutdown(socket.SHUT_RDWR)

    def close(self):
        self._is_over.set()
        self._thread.join()
        self._server.close()

    def _serve(self):
        while not self._is_over.is_set():
            try:
                self._connection, _ = self._server.accept()
            except TimeoutError:
                continue
            self.n_clients += 1
            self._connection.settimeout(0.02)
            with self._connection:
                self._talk(self._connection)

    def _talk(self, connection):
        received = b""
        while not self._is_over.is_set():
            try:
                chunk = connection.recv(4096)
            except TimeoutError:
                continue
            except OSError:
                return
            if not chunk:
                return
            received += chunk
            while len(received) >= 4 and len(received) >= 4 + int.from_bytes(received[2:4]):
                end = 4 + int.from_bytes(received[2:4])
                request, received = received[:end], received[end:]
                if not self.is_mute:
                    self._send(connection, self.reply_before + self._answer(request))

    def _send(self, connection, data):
        for i in range(0, len(data), self.piece):
            connection.sendall(data[i : i + self.piece])
            if self.piece < len(data):
                time.sleep(0.001)

    def _answer(self, request):
        name_end = 7 + int.from_bytes(request[5:7])
        name = request[7:name_end].decode()
        if request[4] == 1:
            self.variables[name] = request[name_end + 2 :].decode()
            self.written.append((name, self.variables[name]))
        value = self.variables.get(name, "").encode()
        body = request[4:5] + struct.pack(">H", len(value)) + value + self.footer
        return request[:2] + struct.pack(">H", len(body)) + body


@pytest.fixture
def peer():
    peer = Peer()
    yield peer
    peer.close()


@pytest.fixture
def client(peer):
    client = KvpClient("127.0.0.1", peer.port, timeout_s=1.0, device="arm")
    client.connect(call="connect")
    yield client
    client.close()


def test_variables_are_read_and_written(peer, client):
    assert client.read("A", call="go") == "1"
    client.write("A", "2", call="go")
    assert peer.variables["A"] == "2"
    assert client.read("A", call="go") == "2"


def test_replies_in_small_pieces_are_put_together(peer, client):
    peer.piece = 3
    peer.variables["LONG"] = "x" * 600
    assert client.read("LONG", call="go") == "x" * 600
    assert client.read("A", call="go") == "1"


def test_an_empty_value_is_an_error(client):
    """KUKAVARPROXY has no other way to say that there is no such variable."""
    with pytest.raises(ProtocolError, match=r"^arm: go: LAB_SEQ has no value; is it declared"):
        client.read("LAB_SEQ", call="go")


@pytest.mark.parametrize(
    ("footer", "code", "what"),
    [
        (b"\x00\x02\x00", 2, "access denied"),
        (b"\x00\x00\x00", 0, "general error"),
        (b"\x01\x2c\x00", 300, "an unknown error"),
    ],
)
def test_a_refusal_carries_the_code(peer, client, footer, code, what):
    peer.footer = footer
    with pytest.raises(
        DeviceFaultError, match=rf"^arm: go: .*refuses to write A: {what}"
    ) as caught:
        client.write("A", "2", call="go")
    assert caught.value.code == code


def test_no_answer_is_a_timeout_and_a_late_one_is_not_taken_for_the_next(peer, client):
    peer.is_mute = True
    with pytest.raises(DeviceTimeoutError, match=r"^arm: go: A: no answer in 1 s"):
        client.read("A", call="go")
    peer.is_mute = False
    late = b"\x00\x01\x00\x0a\x00\x00\x04late\x00\x01\x01"
    peer.reply_before = late
    assert client.read("A", call="go") == "1"


def test_a_late_answer_is_known_as_such_whatever_ended_the_wait(peer, client):
    peer.reply_before = b"\x12\x34\x00\x07\x00\x00\x01z\x00\x01\x01"
    with pytest.raises(ProtocolError, match=r"answer to no question"):
        client.read("A", call="go")  # its own answer comes after this one
    peer.reply_before = b""
    peer.variables["A"] = "2"
    assert client.read("A", call="go") == "2"


def test_an_answer_to_no_question_is_an_error(peer, client):
    peer.reply_before = b"\x12\x34\x00\x07\x00\x00\x01z\x00\x01\x01"
    with pytest.raises(ProtocolError, match=r"^arm: go: A: answer to no question .*12 34"):
        client.read("A", call="go")


def test_a_lost_connection_is_reported_until_connected_again(peer, client):
    peer.drop()
    for _ in range(2):
        with pytest.raises(NotConnectedError, match=r"^arm: go: "):
            client.read("A", call="go")
    client.connect(call="connect")
    assert client.read("A", call="go") == "1"


def test_after_a_long_silence_the_connection_is_renewed_unasked(peer):
    client = KvpClient("127.0.0.1", peer.port, timeout_s=1.0, device="arm", idle_s=0.0)
    client.connect(call="connect")
    peer.drop()  # as KUKAVARPROXY does with who says nothing for 30 s
    assert client.read("A", call="go") == "1"
    assert peer.n_clients >= 2
    client.close()


def test_use_before_connect_is_refused(peer):
    client = KvpClient("127.0.0.1", peer.port, timeout_s=1.0, device="arm")
    with pytest.raises(NotConnectedError, match=r"^arm: go: not connected"):
        client.read("A", call="go")
    client.close()


CONTROLLER = {
    "LAB_SEQ": "41",
    "LAB_ACK": "41",
    "LAB_DONE": "40",
    "LAB_ERR": "0",
    "$PRO_MOVE": "TRUE",
    "$STOPMESS": "FALSE",
    "$PERI_RDY": "TRUE",
    "$ALARM_STOP": "TRUE",
    "$USER_SAF": "true",
    "$MODE_OP": "#EX",
    "$OV_PRO": "35",
    "$PRO_STATE1": "#P_ACTIVE",
    "$POS_ACT_MES": "{E6POS: X 903.649, Y 1029.865, Z 1038.384, A -8.7762, B -13.1836, C -96.8309,"
    " S 2, T 43, E1 1234.5}",
    "$AXIS_ACT_MEAS": "{E6AXIS: A1 -45.0, A2 -60, A3 7.5E1, A4 -100.0, A5 35.0, A6 -150.0,"
    " E1 1234.5, E2 0.0}",
    "$MODEL_NAME[]": '"#KR16-2 C4"',
    "$KR_SERIALNO": "830123",
}


@pytest.fixture
def backend(peer):
    peer.variables = dict(CONTROLLER)
    backend = KvpBackend(
        "127.0.0.1", KvpOptions(kind="kvp", port=peer.port), timeout_s=1.0, device="arm"
    )
    yield backend
    backend.close()


def command(kind):
    axes = Axes.from_controller((0, -90, 90, 0, 90, 0), 1500.25)
    return Command(kind, axes, forward(axes.arm_rad), 20, 50)


def test_the_state_is_put_together_from_variables(peer, backend):
    backend.connect()
    state = backend.state(call="go")
    assert (state.accepted_id, state.done_id, state.error) == (41, 40, 0)
    assert state.axes.arm_deg == pytest.approx((-45, -60, 75, -100, 35, -150))
    assert state.axes.e1_mm == pytest.approx(1234.5)
    assert (state.mode, state.override_pct) == (Mode.EXT, 35)
    assert state.is_moving
    assert state.is_guard_closed
    assert state.is_emergency_stop_released
    assert state.are_drives_on
    assert state.is_program_active
    assert not state.has_stop_message
    off_m = backend.position(call="go").translation - forward(state.axes.arm_rad).translation
    assert abs(off_m).max() < 1e-6
    assert peer.written == []


def test_without_tool_and_base_there_is_no_position_but_a_state(peer, backend):
    """So it is while no robot program has run."""
    del peer.variables["$POS_ACT_MES"]
    backend.connect()
    assert backend.state(call="go").accepted_id == 41
    with pytest.raises(ProtocolError, match=r"^arm: go: \$POS_ACT_MES has no value"):
        backend.position(call="go")


def test_a_command_is_written_member_by_member_and_its_number_last(peer, backend):
    backend.connect()
    assert backend.send(command(CommandKind.PTP_AXES), call="go") == 42
    assert [name for name, _ in peer.written] == [
        "LAB_AXIS",
        "LAB_POS",
        "LAB_VEL",
        "LAB_ACC",
        "LAB_CMD",
        "LAB_SEQ",
    ]
    written = dict(peer.written)
    assert written["LAB_AXIS"].startswith("{E6AXIS: A1 0.000000, A2 -90.000000, A3 90.000000")
    assert "E1 1500.250000, E2 0.000000" in written["LAB_AXIS"]
    assert written["LAB_POS"].startswith("{E6POS: X 930.000000, Y 0.000000, Z 1162.000000, A 180")
    assert "S -1, T -1, E1 1500.250000" in written["LAB_POS"]
    assert [written[f"LAB_{n}"] for n in ("VEL", "ACC", "CMD", "SEQ")] == ["20", "50", "1", "42"]


def test_a_hold_leaves_the_motion_it_holds_alone(peer, backend):
    backend.connect()
    backend.send(command(CommandKind.HOLD), call="go")
    assert peer.written == [("LAB_CMD", "9"), ("LAB_SEQ", "42")]


def test_a_number_is_used_up_even_if_its_command_is_lost(peer, backend):
    backend.connect()
    peer.is_mute = True
    with pytest.raises(DeviceTimeoutError):
        backend.send(command(CommandKind.HOLD), call="go")
    peer.is_mute = False
    assert backend.send(command(CommandKind.HOLD), call="go") == 43


def test_who_it_is_comes_from_the_controller(backend):
    backend.connect()
    identity = backend.identify(call="identify")
    assert (identity.maker, identity.model, identity.serial) == ("KUKA", "KR16-2 C4", "830123")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("$AXIS_ACT_MEAS", "{E6AXIS: A1 0}", r"\$AXIS_ACT_MEAS cannot be read: lacks A2, A3"),
        ("$MODE_OP", "#XY", r"\$MODE_OP cannot be read"),
        ("LAB_DONE", "many", r"LAB_DONE cannot be read"),
        ("$PERI_RDY", "1", r"expected TRUE or FALSE"),
    ],
)
def test_a_value_nobody_understands_is_named(peer, backend, name, value, message):
    backend.connect()
    peer.variables[name] = value
    with pytest.raises(ProtocolError, match=rf"^arm: go: .*{message}"):
        backend.state(call="go")


def test_globals_that_are_not_declared_are_found_at_connect(peer, backend):
    del peer.variables["LAB_SEQ"]
    with pytest.raises(ProtocolError, match=r"^arm: connect: LAB_SEQ has no value"):
        backend.connect()
    with pytest.raises(NotConnectedError):
        backend.state(call="go")


@pytest.mark.parametrize("name", ["$OV_PRO", "$AXIS_ACT_MEAS", "LAB_SEQ"])
def test_requests_equal_those_of_another_client(peer, name):
    """py_openshowvar was written by others and drives real controllers."""
    other = py_openshowvar.openshowvar("127.0.0.1", peer.port)
    other.varname, other.value = name.encode(), b"35"
    assert read_request(other.msg_id, name) == other._pack_read_req()
    assert write_request(other.msg_id, name, "35") == other._pack_write_req()
    other.close()
