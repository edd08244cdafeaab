"""The simulated EthernetKRL channels, by their bytes."""

import re
import socket
import time
import xml.etree.ElementTree as ET
from contextlib import ExitStack

import pytest

from drivers.kuka.simulator import faults as f
from drivers.kuka.simulator.controller import Controller
from drivers.kuka.simulator.eki import EkiServer
from drivers.kuka.simulator.machine import HOME, Machine, position_of
from drivers.kuka.simulator.scene import EmptyScene
from tronlab.errors import ConfigError
from tronlab.twin.state import ArmedFaults

NIMBLE = Machine(axis_ramp_s=0.05, rail_acceleration_mm_per_s2=5e3)
"""Starts and stops faster than a KR 16, so that tests do not wait for it."""

PING = (
    '<RobotCommand Id="{id}" Type="0" Vel="20" Acc="50">'
    '<Axis A1="0.0" A2="-90.0" A3="90.0" A4="0.0" A5="90.0" A6="0.0" E1="0.0"></Axis>'
    '<Cart X="930.0" Y="0.0" Z="1162.0" A="180.0" B="0.0" C="180.0" S="-1" T="-1" E1="0.0"/>'
    '<Tool No="0"/><Base No="0"/></RobotCommand>'
)


def message(number: int, kind: int = 0, **changes: str) -> bytes:
    text = PING.format(id=number).replace('Type="0"', f'Type="{kind}"')
    for key, value in changes.items():
        text = re.sub(rf'\b{key}="[^"]*"', f'{key}="{value}"', text, count=1)
    return text.encode()


class Client:
    """Both channels, read the plain way: one document after the other."""

    def __init__(self, server: EkiServer, stack: ExitStack) -> None:
        self.commands, self.states = (
            stack.enter_context(socket.create_connection(address, timeout=10.0))
            for address in (server.command_address, server.state_address)
        )
        self._read = b""

    def state(self) -> ET.Element:
        while b"</RobotState>" not in self._read:
            data = self.states.recv(64)
            if not data:
                raise EOFError
            self._read += data
        one, self._read = self._read.split(b"</RobotState>", 1)
        return ET.fromstring(one + b"</RobotState>")  # noqa: S314

    def drain(self) -> None:
        while True:
            self.state()

    def state_when(self, **attributes: str) -> ET.Element:
        for _ in range(200):
            state = self.state()
            if all(state.get(key) == value for key, value in attributes.items()):
                return state
        raise AssertionError(f"never {attributes}; last {state.attrib}")

    def flags(self) -> dict[str, str]:
        return dict(self.state()[2].attrib)


def is_closed(connection: socket.socket) -> bool:
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


@pytest.fixture
def faults():
    return ArmedFaults()


@pytest.fixture
def server(faults):
    controller = Controller(EmptyScene(), faults, machine=NIMBLE, override_pct=100)
    server = EkiServer(controller, faults)
    yield server
    server.close()
    controller.close()


@pytest.fixture
def connect(server):
    with ExitStack() as stack:
        yield lambda: Client(server, stack)


@pytest.fixture
def client(connect):
    return connect()


def test_state_has_every_attribute_and_is_numbered(client):
    first, second = client.state(), client.state()
    assert first.tag == "RobotState"
    assert list(first.attrib) == ["Seq", "Ack", "Done", "Err"]
    assert int(second.get("Seq")) == int(first.get("Seq")) + 1
    axis, pos, flags = first
    assert (axis.tag, *axis.attrib) == ("Axis", "A1", "A2", "A3", "A4", "A5", "A6", "E1")
    assert (pos.tag, *pos.attrib) == ("Pos", "X", "Y", "Z", "A", "B", "C", "S", "T", "E1")
    assert flags.tag == "Flags"
    assert flags.attrib == {
        "Move": "0",
        "Stop": "0",
        "Peri": "1",
        "Estop": "1",
        "Safe": "1",
        "Mode": "3",
        "Ov": "100",
        "Pro": "1",
    }
    assert [float(v) for v in axis.attrib.values()] == pytest.approx(list(HOME), abs=1e-6)
    home = position_of(HOME)
    assert float(pos.get("X")) == pytest.approx(home.x_mm, abs=1e-5)
    assert float(pos.get("Z")) == pytest.approx(home.z_mm, abs=1e-5)


def test_nothing_stands_between_documents_and_empty_elements_are_closed(client):
    data = b""
    while data.count(b"</RobotState>") < 2:
        data += client.states.recv(4096)
    assert data.startswith(b"<RobotState Seq=")
    assert b"</RobotState><RobotState " in data
    assert b"/>" not in data


def test_move_is_acknowledged_done_and_arrived(client):
    client.commands.sendall(message(11, 1, A1="2.5", E1="6.5", Vel="100", Acc="100"))
    assert client.state_when(Ack="11").get("Err") == "0"
    axis = client.state_when(Done="11")[0]
    assert (axis.get("A1"), axis.get("E1")) == ("2.5", "6.5")


def test_messages_split_and_joined_are_read(client):
    both = message(1) + message(2, 1, A6="1.0", Vel="100")
    for i in range(0, len(both), 50):
        client.commands.sendall(both[i : i + 50])
        time.sleep(0.001)
    assert client.state_when(Done="2")[0].get("A6") == "1"


@pytest.mark.parametrize(
    ("changes", "kind", "error"),
    [
        ({}, 4, "1"),
        ({"A2": "40"}, 1, "2"),
        ({"E1": "-0.5"}, 1, "3"),
        ({"X": "2500.0"}, 3, "6"),
    ],
)
def test_refusal_has_its_number(client, changes, kind, error):
    client.commands.sendall(message(1, kind, **changes))
    assert client.state_when(Done="1").get("Err") == error


def test_hold_stops_a_move(client):
    client.commands.sendall(message(1, 1, E1="5000.0", Vel="100"))
    client.state_when(Ack="1")
    while client.flags()["Move"] == "0":
        pass
    client.commands.sendall(message(2, 9))
    state = client.state_when(Done="2")
    assert state.get("Err") == "5"
    assert 0.0 < float(state[0].get("E1")) < 5000.0


@pytest.mark.parametrize(
    "damage",
    [(b' Acc="50"', b""), (b' T="-1"', b""), (b'A3="90.0"', b'A3="much"'), (b"<Tool", b"<Tools")],
    ids=["no Acc", "no T", "no number", "no Tool"],
)
def test_missing_element_stops_the_program_until_the_pc_connects_again(
    client, connect, damage, capsys
):
    client.commands.sendall(message(1, 1, A1="5").replace(*damage))
    assert client.state_when(Done="1").get("Err") == "6"
    while client.flags()["Stop"] == "0":
        pass
    assert "without a valid RobotCommand/" in capsys.readouterr().err
    client.commands.sendall(message(2, 1, A1="5"))
    for _ in range(4):
        state = client.state()
    assert (state.get("Ack"), state.get("Done")) == ("1", "1")
    assert float(state[0].get("A1")) == 0.0
    client.commands.close()
    client.states.close()
    again = connect()
    again.commands.sendall(message(3, 1, A1="0.5", Vel="100"))
    assert again.state_when(Done="3").get("Err") == "0"


def test_missing_element_ends_the_motion_under_way(client):
    client.commands.sendall(message(1, 1, E1="5000.0", Vel="100"))
    while client.flags()["Move"] == "0":
        pass
    client.commands.sendall(message(2, 1).replace(b' Acc="50"', b""))
    state = client.state_when(Done="2")
    assert state.get("Err") == "6"
    assert float(state[0].get("E1")) < 5000.0


def test_message_without_a_number_stops_the_program(client):
    client.commands.sendall(message(1, 1).replace(b'Id="1" ', b""))
    while client.flags()["Stop"] == "0":
        pass
    assert client.state().get("Ack") == "0"


def test_what_is_no_xml_closes_the_command_channel(client, capsys):
    client.commands.sendall(b"G0 X100\r\n")
    assert client.commands.recv(1) == b""
    assert "command channel closed" in capsys.readouterr().err
    client.state()


@pytest.mark.parametrize("channel", ["command_address", "state_address"])
def test_second_client_is_closed_at_once_and_the_first_stays(server, client, channel):
    with socket.create_connection(getattr(server, channel), timeout=10.0) as second:
        assert is_closed(second)
    client.commands.sendall(message(4))
    client.state_when(Done="4")


def test_client_that_left_makes_room(client, connect):
    client.commands.close()
    client.states.close()
    assert connect().state().tag == "RobotState"


def test_silence_and_its_end(client, faults):
    client.state()
    faults.arm(f.SILENT)
    client.states.settimeout(0.3)
    with pytest.raises(TimeoutError):
        client.drain()
    faults.arm(f.SILENT, times=0)
    client.states.settimeout(10.0)
    client.state()


def test_disconnect_closes_both_channels_once(client, connect, faults):
    faults.arm(f.DISCONNECT, times=1)
    with pytest.raises((EOFError, ConnectionResetError)):
        client.drain()
    assert client.commands.recv(1) == b""
    time.sleep(0.1)
    assert connect().state().tag == "RobotState"


def test_split_states_are_whole_in_the_end(client, faults):
    faults.arm(f.SPLIT)
    client.state()
    client.state()
    sizes = {len(client.states.recv(4096)) for _ in range(10)}
    assert max(sizes) < 400


def test_flags_tell_the_faults(client, faults):
    told = {
        f.EMERGENCY_STOP: ("Estop", "0"),
        f.GUARD_OPEN: ("Safe", "0"),
        f.DRIVES_OFF: ("Peri", "0"),
        f.WRONG_MODE: ("Mode", "1"),
        f.STOP_MESSAGE: ("Stop", "1"),
    }
    for fault, (flag, value) in told.items():
        faults.arm(fault)
        while (flags := client.flags())[flag] != value:
            pass
        assert flags["Pro"] == "0"
        faults.arm(fault, times=0)
        while client.flags()["Pro"] == "0":
            pass


def test_port_in_use_is_one_clear_error(server, faults):
    controller = Controller(EmptyScene(), faults)
    try:
        with pytest.raises(ConfigError, match="cannot listen at 127"):
            EkiServer(controller, faults, state_port=server.state_address[1])
    finally:
        controller.close()
