"""EthernetKRL: the messages as agreed with the robot program, and the back end against a peer."""

import socket
import threading
import time
from xml.etree import ElementTree

import numpy as np
import pytest

from drivers.kuka.backend import Command, CommandKind, Mode
from drivers.kuka.eki import (
    COMMAND_TAGS,
    DocumentReader,
    decode_position,
    decode_state,
    encode_command,
)
from drivers.kuka.eki_backend import EkiBackend
from drivers.kuka.options import EkiOptions
from drivers.kuka.position import Axes, xyz_mm_abc_deg
from tronlab.errors import (
    AccessDeniedError,
    DeviceTimeoutError,
    NotConnectedError,
    ProtocolError,
)
from tronlab.kinematics.kr16 import forward

STATE = (
    b'<RobotState Seq="17" Ack="5" Done="4" Err="3">'
    b'<Axis A1="10.5" A2="-90" A3="9.0E+01" A4="0" A5="-45.25" A6="1e-3" E1="1234.5678"></Axis>'
    b'<Pos X="903.649" Y="1029.865" Z="1038.384" A="-8.7762" B="-13.1836" C="-96.8309"'
    b' S="2" T="43" E1="1234.5678"></Pos>'
    b'<Flags Move="1" Stop="0" Peri="1" Estop="1" Safe="0" Mode="4" Ov="30" Pro="1"></Flags>'
    b"</RobotState>"
)


def parsed(document):
    return ElementTree.fromstring(document)  # noqa: S314  # our own


def command(kind=CommandKind.PTP_AXES, arm_deg=(0, -90, 90, 0, 90, 0), e1_mm=1500.25):
    axes = Axes.from_controller(arm_deg, e1_mm)
    return Command(kind, axes, forward(axes.arm_rad), 20, 50)


def test_a_command_has_these_bytes():
    assert encode_command(command(), 7) == (
        b'<RobotCommand Id="7" Type="1" Vel="20" Acc="50">'
        b'<Axis A1="0.000000" A2="-90.000000" A3="90.000000" A4="0.000000" A5="90.000000"'
        b' A6="0.000000" E1="1500.250000"></Axis>'
        b'<Cart X="930.000000" Y="0.000000" Z="1162.000000" A="180.000000" B="0.000000"'
        b' C="180.000000" S="-1" T="-1" E1="1500.250000"></Cart>'
        b'<Tool No="0"></Tool><Base No="0"></Base></RobotCommand>'
    )


@pytest.mark.parametrize("kind", CommandKind)
def test_a_command_of_any_kind_has_every_element(kind):
    """EthernetKRL keeps a queue for each: one left out would shift it against the others."""
    root = parsed(encode_command(command(kind), 1))
    assert {"": tuple(root.attrib)} | {c.tag: tuple(c.attrib) for c in root} == COMMAND_TAGS


def test_numbers_have_no_exponent_and_no_negative_zero():
    document = encode_command(command(arm_deg=(-1e-9, 1e-7, 350, 0, 1e-12, 0), e1_mm=-4e-7), 1)
    root = parsed(document)
    axis = root.find("Axis").attrib
    assert [axis[name] for name in ("A1", "A2", "A3", "E1")] == [
        "0.000000",
        "0.000000",
        "350.000000",
        "0.000000",
    ]


@pytest.mark.parametrize("seed", range(5))
def test_rounding_on_the_wire_moves_the_flange_by_less_than_a_micrometre(seed):
    arm_deg = np.random.default_rng(seed).uniform(-100, 30, 6)
    axis = parsed(encode_command(command(arm_deg=arm_deg), 1)).find("Axis").attrib
    sent = forward(np.radians([float(axis[f"A{i}"]) for i in range(1, 7)]))
    assert np.abs(sent.translation - forward(np.radians(arm_deg)).translation).max() < 1e-7


def test_a_state_is_read_whole():
    state = decode_state(STATE, device="arm")
    assert (state.reading, state.accepted_id, state.done_id, state.error) == (17, 5, 4, 3)
    assert state.axes.arm_deg == pytest.approx((10.5, -90, 90, 0, -45.25, 1e-3))
    assert state.axes.e1_mm == pytest.approx(1234.5678)
    assert xyz_mm_abc_deg(decode_position(STATE, device="arm")) == pytest.approx(
        (903.649, 1029.865, 1038.384, -8.7762, -13.1836, -96.8309)
    )
    assert (state.is_moving, state.has_stop_message) == (True, False)
    assert (state.are_drives_on, state.is_emergency_stop_released) == (True, True)
    assert (state.is_guard_closed, state.is_program_active) == (False, True)
    assert (state.mode, state.override_pct) == (Mode.EXT, 30)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b' A3="9.0E+01"', b"", r"lacks RobotState/Axis/@A3"),
        (b' Done="4"', b"", r"lacks RobotState/@Done"),
        (b'E1="1234.5678"', b'E1="nan"', r"RobotState/Axis/@E1 is 'nan', allowed is a number"),
        (b'Ack="5"', b'Ack="5.5"', r"RobotState/@Ack is '5.5', allowed is a whole number"),
        (b'Move="1"', b'Move="2"', r"RobotState/Flags/@Move is '2', allowed is 0 or 1"),
        (b'Mode="4"', b'Mode="5"', r"RobotState/Flags/@Mode is '5', allowed is 1 to 4"),
        (b"</Axis>", b"</Axes>", r"is no XML"),
        (b"</Axis>", b"<!-- --></Axis>", r"declaration or comment"),
    ],
)
def test_a_state_that_is_not_as_agreed_is_an_error_that_names_the_part(old, new, message):
    with pytest.raises(
        ProtocolError, match=rf"^arm: state channel: the state .*{message}"
    ) as caught:
        decode_state(STATE.replace(old, new), device="arm")
    assert caught.value.received


def test_a_state_without_a_position_lacks_only_that():
    document = STATE.replace(b"Pos", b"Position")
    assert decode_state(document, device="arm").done_id == 4
    with pytest.raises(ProtocolError, match=r"^arm: .*lacks RobotState/Pos/@X"):
        decode_position(document, device="arm")


def test_children_may_close_themselves():
    short = STATE.replace(b"></Axis>", b"/>").replace(b"></Flags>", b" />")
    assert decode_state(short, device="arm").axes.arm_deg[0] == pytest.approx(10.5)


@pytest.mark.parametrize("size", [1, 2, 7, 100, 10_000])
def test_documents_are_cut_however_they_arrive(size):
    reader = DocumentReader("RobotState", device="arm")
    stream = STATE + b"\r\n" + STATE + STATE + STATE[:50]
    pieces = [stream[i : i + size] for i in range(0, len(stream), size)]
    assert [d for piece in pieces for d in reader.feed(piece)] == [STATE] * 3


@pytest.mark.parametrize("junk", [b"hello", b"<Other/>", b"<RobotStatus>", b"\x00"])
def test_anything_else_on_the_channel_is_an_error(junk):
    reader = DocumentReader("RobotState", device="arm")
    with pytest.raises(ProtocolError, match=r"expected a document <RobotState>"):
        list(reader.feed(STATE + junk))


def test_a_document_without_end_is_an_error():
    reader = DocumentReader("RobotState", device="arm")
    with pytest.raises(ProtocolError, match=r"does not end within"):
        list(reader.feed(b"<RobotState " + b" " * 70_000))


class Peer:
    """Two servers that do what the test says: they tell ``state`` and keep what they are sent."""

    def __init__(self):
        self.state: bytes | None = STATE
        self.received = b""
        self.accept_clients = True
        self.accept_commands = True
        self._has_refused = threading.Event()
        self._connections: list[socket.socket] = []
        self._is_over = threading.Event()
        self.commands, self.states = (socket.create_server(("127.0.0.1", 0)) for _ in range(2))
        self._threads = [
            threading.Thread(target=self._serve, args=(self.commands, self._read)),
            threading.Thread(target=self._serve, args=(self.states, self._tell)),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def options(self):
        ports = (server.getsockname()[1] for server in (self.commands, self.states))
        return EkiOptions(
            kind="eki", **dict(zip(("command_port", "state_port"), ports, strict=True))
        )

    def drop(self, server):
        wait_for(lambda: len(self._connections) == 2)
        for connection in list(self._connections):
            if connection.getsockname() == server.getsockname():
                connection.shutdown(socket.SHUT_RDWR)

    def close(self):
        self._is_over.set()
        for thread in self._threads:
            thread.join()
        for server in (self.commands, self.states):
            server.close()

    def _serve(self, server, talk):
        server.settimeout(0.02)
        while not self._is_over.is_set():
            try:
                connection, _ = server.accept()
            except TimeoutError:
                continue
            if server is self.states and not self.accept_commands:
                self._has_refused.wait(5.0)
            with connection:
                if self.accept_clients and (self.accept_commands or server is self.states):
                    self._connections.append(connection)
                    self._talk(connection, talk)
            self._has_refused.set()

    def _talk(self, connection, talk):
        connection.settimeout(0.01)
        try:
            while not self._is_over.is_set() and talk(connection):
                pass
        except OSError:
            pass
        self._connections.remove(connection)

    def _read(self, connection):
        try:
            received = connection.recv(4096)
        except TimeoutError:
            return True
        self.received += received
        return bool(received)

    def _tell(self, connection):
        if self.state is not None:
            connection.sendall(self.state)
        try:
            return bool(connection.recv(1))  # wakes at once when the client goes
        except TimeoutError:
            return True


@pytest.fixture
def peer():
    peer = Peer()
    yield peer
    peer.close()


@pytest.fixture
def backend(peer):
    backend = EkiBackend("127.0.0.1", peer.options, timeout_s=1.0, device="arm")
    yield backend
    backend.close()


def look(backend, *, times):
    for _ in range(times):
        backend.state(call="go")


def wait_for(condition):
    give_up = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < give_up, "waited in vain"
        time.sleep(0.005)


def test_commands_are_counted_on_from_what_the_controller_has_seen(peer, backend):
    backend.connect()
    assert peer.received == b""  # connecting tells the robot nothing
    assert backend.send(command(), call="go") == 6  # Ack is 5
    assert backend.send(command(), call="go") == 7
    wait_for(lambda: peer.received.count(b"</RobotCommand>") == 2)
    assert peer.received == encode_command(command(), 6) + encode_command(command(), 7)


def test_a_state_is_newer_than_the_question(peer, backend):
    backend.connect()
    peer.state = STATE.replace(b'Done="4"', b'Done="5"')
    wait_for(lambda: backend.state(call="go").done_id == 5)


@pytest.mark.parametrize("call", ["state", "send", "identify"])
def test_use_before_connect_is_refused(backend, call):
    arguments = (command(),) if call == "send" else ()
    with pytest.raises(NotConnectedError, match=r"^arm: go: not connected; call connect\(\) first"):
        getattr(backend, call)(*arguments, call="go")


def test_the_position_is_that_of_the_next_state(backend):
    backend.connect()
    assert backend.position(call="go").translation == pytest.approx([0.903649, 1.029865, 1.038384])


def test_silence_is_a_timeout(peer, backend):
    backend.connect()
    peer.state = None
    time.sleep(0.05)
    with pytest.raises(DeviceTimeoutError, match=r"^arm: go: no state .* 1 s"):
        look(backend, times=3)


def test_silence_from_the_start_is_a_timeout_of_connect(peer, backend):
    peer.state = None
    with pytest.raises(DeviceTimeoutError, match=r"^arm: connect: no state"):
        backend.connect()


def test_a_second_client_is_told_that_there_is_another(peer, backend):
    peer.accept_clients = False
    with pytest.raises(AccessDeniedError, match=r"^arm: connect: .*another client holds it"):
        backend.connect()


def test_a_client_refused_on_the_command_channel_alone_is_told_too(peer, backend):
    peer.accept_commands = False
    with pytest.raises(AccessDeniedError, match=r"another client holds it"):
        backend.connect()


def test_a_controller_that_is_not_there_is_named_with_its_address(peer, backend):
    port = peer.options.command_port
    peer.close()
    with pytest.raises(NotConnectedError, match=rf"^arm: connect: 127\.0\.0\.1:{port}: .*refused"):
        backend.connect()


def test_a_lost_state_channel_is_reported_until_connected_again(peer, backend):
    backend.connect()
    peer.drop(peer.states)
    for _ in range(2):
        with pytest.raises(NotConnectedError, match=r"^arm: go: the state channel is lost"):
            look(backend, times=100)
    backend.connect()
    assert backend.state(call="go").done_id == 4


def test_a_lost_command_channel_is_reported_before_a_command_is_lost_in_it(peer, backend):
    backend.connect()
    peer.drop(peer.commands)
    wait_for(lambda: len(peer._connections) == 1)
    with pytest.raises(NotConnectedError, match=r"^arm: go: the command channel is lost"):
        backend.send(command(), call="go")


def test_a_state_nobody_understands_is_a_protocol_error(peer, backend):
    backend.connect()
    peer.state = STATE.replace(b"Ack", b"Bck")
    with pytest.raises(ProtocolError, match=r"lacks RobotState/@Ack"):
        look(backend, times=100)


def test_nothing_is_left_after_close(peer, backend):
    before = threading.active_count()
    backend.connect()
    assert threading.active_count() == before + 1
    backend.close()
    backend.close()
    assert threading.active_count() == before


def test_without_variables_beside_it_only_maker_and_model_are_known(backend):
    backend.connect()
    identity = backend.identify(call="identify")
    assert (identity.maker, identity.model, identity.serial) == ("KUKA", "KR 16", "")
