"""The simulated variable server: the bytes of its specification, and a client that others wrote."""

import socket
import struct
import time

import pytest
from py_openshowvar import openshowvar

from drivers.kuka.simulator import faults as f
from drivers.kuka.simulator.controller import Controller
from drivers.kuka.simulator.kvp import MAX_CLIENTS, KvpServer
from drivers.kuka.simulator.machine import HOME, Machine, position_of
from drivers.kuka.simulator.scene import EmptyScene
from tronlab.twin.state import ArmedFaults

NIMBLE = Machine(axis_ramp_s=0.05, rail_acceleration_mm_per_s2=5e3)
"""Starts and stops faster than a KR 16, so that tests do not wait for it."""

GOLDEN = {  # C3 Bridge Interface Protocol 1.5, sections 3.5 to 3.10: request, reply
    "read": (
        "0100 000E 00 000B 24414343555F5354415445",
        "0100 0010 00 000A 234348415247455F4F4B 0001 01",
    ),
    "write": ("0100 000E 01 0007 244F565F50524F 0002 3335", "0100 0008 01 0002 3335 0001 01"),
    "read wide": (  # the sample's $ACT_BASE is 1, ours 0
        "0200 0015 04 0009 24004100430054005F004200410053004500",
        "0200 0008 04 0001 3000 0001 01",
    ),
    "write wide": (
        "0100 0015 05 0007 24004F0056005F00500052004F00 0001 3500",
        "0100 0008 05 0001 3500 0001 01",
    ),
    "read several": (  # the sample's second variable is one of C3's own
        "0400 001C 06 02 0004 500049004E004700 0007 24004F0056005F004A004F004700",
        "0400 0017 06 02 01 0004 50004F004E004700 01 0002 31003000 0001 01",
    ),
    "write several": (
        "0400 0030 07 02 0007 24004F0056005F00500052004F00 0002 33003700"
        "0007 24004F0056005F004A004F004700 0003 310030003000",
        "0400 0015 07 02 01 0002 33003700 01 0003 310030003000 0001 01",
    ),
    "reset submit interpreter": ("028C 0004 0A 01 0000", "028C 0005 0A 01 0001 01"),
    "confirm all": ("0001 0001 3F", "0001 0004 3F 0001 01"),
}

REFUSED = {
    "start the robot's program": ("0001 0004 0A 02 0001", "0001 0005 0A 02 0007 00"),
    "select a program": ("0001 0009 0A 05 0001 0000 0000 01", "0001 0005 0A 05 0007 00"),
    "move by C3": ("0001 0006 0B 01 0001 4100", "0001 0004 0B 0007 00"),
    "write what only the controller writes": (
        "0001 0012 01 0009 245045 52495F524459 0004 54525545",
        "0001 0006 01 0000 0002 00",
    ),
    "write what is no number": (
        "0001 000D 01 0007 244F565F50524F 0001 78",
        "0001 0006 01 0000 0003 00",
    ),
    "parts that do not fit the length": ("0001 0004 00 0009 24", "0001 0004 00 0009 00"),
    "nothing at all": ("0001 0000", "0001 0003 0009 00"),
}


@pytest.fixture
def faults():
    return ArmedFaults()


@pytest.fixture
def controller(faults):
    controller = Controller(EmptyScene(), faults, machine=NIMBLE)
    yield controller
    controller.close()


@pytest.fixture
def server(controller, faults):
    server = KvpServer(controller, faults)
    yield server
    server.close()


@pytest.fixture
def connection(server):
    with socket.create_connection(server.address, timeout=10.0) as connection:
        yield connection


@pytest.fixture
def client(server):
    client = openshowvar(*server.address)
    yield client
    client.close()


def exactly(connection: socket.socket, n: int) -> bytes:
    data = b""
    while len(data) < n:
        received = connection.recv(n - len(data))
        if not received:
            raise EOFError
        data += received
    return data


def reply(connection: socket.socket) -> bytes:
    header = exactly(connection, 4)
    return header + exactly(connection, struct.unpack(">HH", header)[1])


def read_request(name: str, tag: int = 1) -> bytes:
    return struct.pack(">HHBH", tag, 3 + len(name), 0, len(name)) + name.encode()


def is_closed(connection: socket.socket) -> bool:
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


def value_of(answer: bytes) -> str:
    return answer[7 : 7 + struct.unpack(">H", answer[5:7])[0]].decode()


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_bytes(connection, name):
    request, expected = map(bytes.fromhex, GOLDEN[name])
    connection.sendall(request)
    assert reply(connection).hex(" ") == expected.hex(" ")


@pytest.mark.parametrize("name", REFUSED)
def test_refusals_have_their_code_and_no_success(connection, name):
    request, expected = map(bytes.fromhex, REFUSED[name])
    connection.sendall(request)
    assert reply(connection).hex(" ") == expected.hex(" ")
    connection.sendall(read_request("PING"))
    assert value_of(reply(connection)) == "PONG"


def test_requests_split_and_joined_are_answered_in_turn(connection):
    stream = b"".join(read_request(name, tag) for tag, name in enumerate(["PING", "$T1", "$AUT"]))
    for i in range(len(stream)):
        connection.sendall(stream[i : i + 1])
    answers = [reply(connection) for _ in range(3)]
    assert [value_of(answer) for answer in answers] == ["PONG", "FALSE", "TRUE"]
    assert [answer[1] for answer in answers] == [0, 1, 2]


SYSTEM_VARIABLES = {
    "$PRO_STATE1": b"#P_ACTIVE",
    "$PRO_MOVE": b"FALSE",
    "$STOPMESS": b"FALSE",
    "$PERI_RDY": b"TRUE",
    "$ALARM_STOP": b"TRUE",
    "$USER_SAF": b"TRUE",
    "$MODE_OP": b"#AUT",
    "$OV_PRO": b"50",
    "$ADVANCE": b"0",
    "$MODEL_NAME[]": b'"#KR16 C2 FLR ZH16"',
    "$ROBTRAFO[]": b'"#KR16 C2 FLR ZH16"',
    "$KR_SERIALNO": b"830123",
    "$SOFTN_END[2]": b"-155.0",
    "$SOFTP_END[7]": b"11000.0",
    "$ROBROOT": b"{FRAME: X 0.0, Y 0.0, Z 0.0, A 0.0, B 0.0, C 0.0}",
    "LAB_SEQ": b"0",
    "LAB_VEL": b"0.0",
    "$axis_act.a2": b"-90.0",
    "no_such_variable": b"",
    "$AXIS_ACT.B9": b"",
}


@pytest.mark.parametrize("name", SYSTEM_VARIABLES)
def test_client_others_wrote_reads(client, name):
    assert client.read(name, debug=False) == SYSTEM_VARIABLES[name]


@pytest.mark.parametrize("name", ["$AXIS_ACT", "$AXIS_ACT_MEAS", "$POS_ACT", "$POS_ACT_MES"])
def test_client_others_wrote_reads_structures_in_one_piece(client, name):
    text = client.read(name, debug=False).decode()
    kind, _, listed = text.strip("{}").partition(": ")
    members = dict(item.split(" ") for item in listed.split(", "))
    assert list(members)[-6:] == ["E1", "E2", "E3", "E4", "E5", "E6"]
    if name.startswith("$AXIS"):
        assert kind == "E6AXIS"
        values = [float(members[f"A{i}"]) for i in range(1, 7)]
        assert values == pytest.approx(list(HOME[:6]), abs=1e-6)
    else:
        assert kind == "E6POS"
        assert float(members["X"]) == pytest.approx(position_of(HOME).x_mm, abs=1e-5)
        assert int(members["S"]) == position_of(HOME).status
    assert len(text) < 240  # that client reads at most 256 bytes


def wait_for(client, name: str, value: bytes):
    end = time.monotonic() + 10.0
    while client.read(name, debug=False) != value:
        assert time.monotonic() < end, client.read(name, debug=False)


def test_client_others_wrote_moves_the_robot(client):
    target = "{E6AXIS: A1 1.5, A2 -90.0, A3 90.0, A4 0.0, A5 9e1, A6 0.0, E1 2.5}"
    for name, text in [
        ("LAB_AXIS", target),
        ("LAB_VEL", "100"),
        ("LAB_ACC", "100"),
        ("LAB_CMD", "1"),
    ]:
        assert client.write(name, text, debug=False) == text.encode()
    assert client.read("LAB_CMD", debug=False) == b"1"
    assert client.read("LAB_ACK", debug=False) == b"0"
    client.write("LAB_SEQ", "1", debug=False)
    wait_for(client, "LAB_DONE", b"1")
    assert client.read("LAB_ERR", debug=False) == b"0"
    assert client.read("LAB_ACK", debug=False) == b"1"
    assert b"A1 1.5," in client.read("$AXIS_ACT_MEAS", debug=False)
    assert b"E1 2.5," in client.read("$POS_ACT_MES", debug=False)


def test_position_in_lower_case_with_members_left_out_moves_it_too(client, controller):
    goal = position_of(HOME)
    text = (
        f"{{e6pos: x {goal.x_mm - 5}, y {goal.y_mm},  z {goal.z_mm}, "
        f"a {goal.a_deg}, b {goal.b_deg}, c {goal.c_deg}, e1 0}}"
    )
    for name, value in [("lab_pos", text), ("lab_vel", "50"), ("lab_acc", "100"), ("lab_cmd", "3")]:
        assert client.write(name, value, debug=False) == value.encode()
    client.write("LAB_SEQ", "7", debug=False)
    wait_for(client, "LAB_DONE", b"7")
    assert client.read("LAB_ERR", debug=False) == b"0"
    assert position_of(controller.state.measured).x_mm == pytest.approx(goal.x_mm - 5, abs=1e-6)


def test_member_left_undefined_stops_the_program_until_all_is_confirmed(client, connection):
    client.write("LAB_AXIS", "{A1 5.0}", debug=False)
    assert client.read("LAB_AXIS", debug=False) == b"{E6AXIS: A1 5.0}"
    for name, value in [("LAB_VEL", "50"), ("LAB_ACC", "50"), ("LAB_CMD", "1"), ("LAB_SEQ", "1")]:
        client.write(name, value, debug=False)
    wait_for(client, "LAB_DONE", b"1")
    assert client.read("LAB_ERR", debug=False) == b"6"
    wait_for(client, "$STOPMESS", b"TRUE")
    connection.sendall(bytes.fromhex(GOLDEN["confirm all"][0]))
    reply(connection)
    wait_for(client, "$STOPMESS", b"FALSE")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("LAB_AXIS", "{E6POS: X 1.0}"),
        ("LAB_AXIS", "{E6AXIS: X 1.0}"),
        ("LAB_AXIS", "A1 1.0"),
        ("LAB_POS", "{E6POS: X}"),
        ("LAB_CMD", "1.5"),
        ("LAB_SEQ", "2147483648"),
        ("$OV_PRO", "101"),
        ("$ALARM_STOP", "TRUE"),
        ("$AXIS_ACT", "{E6AXIS: A1 0.0}"),
        ("LAB_ACK", "3"),
        ("no_such_variable", "1"),
    ],
)
def test_what_cannot_be_written_fails_and_changes_nothing(client, name, text):
    before = client.read(name, debug=False)
    assert client.write(name, text, debug=False) is None
    assert client.read(name, debug=False) == before


def test_eleventh_client_is_closed_at_once(server):
    clients = [socket.create_connection(server.address, timeout=10.0) for _ in range(MAX_CLIENTS)]
    try:
        for client in clients:
            client.sendall(read_request("PING"))
            assert value_of(reply(client)) == "PONG"
        with socket.create_connection(server.address, timeout=10.0) as last:
            assert is_closed(last)
    finally:
        for client in clients:
            client.close()


def test_idle_client_is_dropped(controller, faults):
    server = KvpServer(controller, faults, idle_s=0.05)
    try:
        with socket.create_connection(server.address, timeout=10.0) as connection:
            assert connection.recv(1) == b""
    finally:
        server.close()


def test_silent_server_swallows_requests(connection, faults):
    faults.arm(f.SILENT)
    connection.settimeout(0.2)
    connection.sendall(read_request("PING", tag=1))
    with pytest.raises(TimeoutError):
        connection.recv(1)
    faults.arm(f.SILENT, times=0)
    connection.settimeout(10.0)
    connection.sendall(read_request("PING", tag=2))
    assert reply(connection)[:2] == b"\x00\x02"


def test_disconnect_closes_every_connection_once(server, connection, faults):
    faults.arm(f.DISCONNECT, times=1)
    with socket.create_connection(server.address, timeout=10.0) as other:
        other.sendall(read_request("PING"))
        assert connection.recv(1) == b""
        with pytest.raises(EOFError):
            reply(other)
    with socket.create_connection(server.address, timeout=10.0) as again:
        again.sendall(read_request("PING"))
        assert value_of(reply(again)) == "PONG"


def test_split_replies_are_whole_in_the_end(connection, faults):
    faults.arm(f.SPLIT)
    connection.sendall(read_request("$POS_ACT"))
    first = connection.recv(4096)
    assert len(first) < 100
    rest = b""
    while len(first + rest) < 4 or len(first + rest) < 4 + struct.unpack(">H", first[2:4])[0]:
        rest += connection.recv(4096)
    assert value_of(first + rest).startswith("{E6POS: X 930.0,")
