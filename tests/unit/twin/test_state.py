"""The state of a simulated laboratory, kept here and shared between processes."""

import json
import math
import socket
import threading
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.devices.readings import RobotTarget
from tronlab.errors import NotConnectedError
from tronlab.twin import server as server_module
from tronlab.twin.server import RemoteState, StateServer
from tronlab.twin.state import FOR_EVER, LocalState, RobotState, StateStore, WorldState

POSE = RigidTransform.from_components([0.1, 0.2, 1 / 3], Rotation.from_rotvec([0.3, -1.1, 2.0]))
STATE = WorldState(
    robot_encoders=RobotState.at(RobotTarget(1.1, POSE)),
    robot_actual=RobotState.at(RobotTarget(1.1000001, POSE)),
    trs_from_board=None,
    lamp_level=0.0,
    is_door_closed=True,
    air_temperature_k=293.15,
    air_pressure_pa=101325.0,
    relative_humidity=0.45,
)
finite = st.floats(allow_nan=False, allow_infinity=False)


@pytest.fixture
def remote() -> Iterator[RemoteState]:
    server = StateServer(LocalState(STATE))
    remote = RemoteState(*server.address)
    yield remote
    remote.close()
    server.close()


@pytest.fixture(params=["local", "remote"])
def store(request: pytest.FixtureRequest) -> StateStore:
    return LocalState(STATE) if request.param == "local" else request.getfixturevalue("remote")


def test_state_is_read_and_changed(store: StateStore):
    assert store.read() == STATE
    moved = RobotState.at(RobotTarget(2.0, POSE.inv()))
    store.change(robot_actual=moved, trs_from_board=(0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
    store.change(tracker_shift_m=(0.0, 1e-3, 0.0))
    state = store.read()
    assert state.robot_actual == moved
    assert state.robot_encoders == STATE.robot_encoders
    assert state.trs_from_board == (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    assert state.tracker_shift_m == (0.0, 1e-3, 0.0)


@settings(max_examples=50, deadline=None)
@given(rail_m=finite, numbers=st.tuples(*[finite] * 7), level=finite)
def test_json_keeps_every_bit(rail_m: float, numbers: tuple[float, ...], level: float):
    robot = RobotState(rail_m, numbers)  # type: ignore[arg-type]
    lamp, room = (numbers, level), (True, level, level, level)
    state = WorldState(robot, robot, *lamp, *room, tracker_shift_m=numbers[:3])  # type: ignore[arg-type]
    assert WorldState.from_json(json.loads(json.dumps(state.as_json()))) == state


def test_a_fault_strikes_as_often_as_it_was_armed(store: StateStore):
    assert not store.strike("tracker.silent")
    store.arm("tracker.silent", times=2)
    assert store.is_armed("tracker.silent")
    assert [store.strike("tracker.silent") for _ in range(3)] == [True, True, False]


def test_a_lasting_fault_stays_until_cleared(store: StateStore):
    store.arm("robot.stuck", times=FOR_EVER)
    assert all(store.strike("robot.stuck") for _ in range(5))
    store.arm("robot.stuck", times=0)
    assert not store.is_armed("robot.stuck")


def test_a_fault_strikes_once_however_many_ask(remote: RemoteState):
    remote.arm("camera.gone", times=3)
    struck: list[bool] = []
    threads = [
        threading.Thread(target=lambda: struck.append(remote.strike("camera.gone")))
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(struck) == 3


def test_nobody_there_is_one_clear_error():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(NotConnectedError, match=rf"nobody answers at 127\.0\.0\.1:{port}.*twin up"):
        RemoteState("127.0.0.1", port).read()


def test_a_server_that_goes_away_is_an_error_and_a_new_one_is_found():
    server = StateServer(LocalState(STATE))
    remote = RemoteState(*server.address)
    remote.read()
    port = server.address[1]
    server.close()
    with pytest.raises(NotConnectedError):
        remote.read()
    again = StateServer(LocalState(STATE), port=port)
    try:
        assert remote.read() == STATE
    finally:
        remote.close()
        again.close()


def test_a_taken_port_is_one_clear_error():
    server = StateServer(LocalState(STATE))
    try:
        with pytest.raises(NotConnectedError, match="cannot listen at"):
            StateServer(LocalState(STATE), port=server.address[1])
    finally:
        server.close()


def test_closing_does_not_wait_for_a_client_that_has_just_come(monkeypatch: pytest.MonkeyPatch):
    has_come, has_hung_up = threading.Event(), threading.Event()
    handle, hang_up = server_module._Handler.handle, server_module._Server.hang_up

    def handle_late(handler: server_module._Handler) -> None:
        has_come.set()
        assert has_hung_up.wait(timeout=10)
        handle(handler)

    def tell(server: server_module._Server) -> None:
        hang_up(server)
        has_hung_up.set()

    monkeypatch.setattr(server_module._Handler, "handle", handle_late)
    monkeypatch.setattr(server_module._Server, "hang_up", tell)
    server = StateServer(LocalState(STATE))
    with socket.create_connection(server.address, timeout=5):
        assert has_come.wait(timeout=10)
        closing = threading.Thread(target=server.close, daemon=True)
        closing.start()
        closing.join(timeout=10)
        assert not closing.is_alive()


def test_an_answer_cut_short_is_one_clear_error():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        remote = RemoteState(*listener.getsockname())

        def answer_half() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.recv(1000)
                connection.sendall(b'{"ok": tr')

        answering = threading.Thread(target=answer_half)
        answering.start()
        with pytest.raises(NotConnectedError, match="closed the connection"):
            remote.is_armed("camera.gone")
        answering.join()


@pytest.mark.parametrize(
    "line",
    [
        b"\n",
        b"{}\n",
        b"[]\n",
        b'{"do": "fly"}\n',
        b'{"do": "change", "values": {"x": 1}}\n',
        b'{"do": "change", "values": [1]}\n',
        b"\xff\xfe\n",
    ],
)
def test_nonsense_is_refused_and_the_next_question_answered(remote: RemoteState, line: bytes):
    host, port = remote._address
    with socket.create_connection((host, port), timeout=5) as connection:
        stream = connection.makefile("rwb")
        stream.write(line + b'{"do": "read"}\n')
        stream.flush()
        assert "error" in json.loads(stream.readline())
        answer = json.loads(stream.readline())
        stream.close()
    assert math.isclose(answer["ok"]["air_temperature_k"], 293.15)
