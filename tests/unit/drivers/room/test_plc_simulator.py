"""The simulated PLC: read and written by pyModbusTCP, and its program at chosen times."""

import struct
import time
from collections.abc import Callable

import pytest
from pyModbusTCP.client import ModbusClient
from pyModbusTCP.utils import decode_ieee, get_2comp, word_list_to_long

from drivers.room.simulator.lamp import SimulatedLamp
from drivers.room.simulator.plc import PlcServer
from drivers.room.simulator.program import CYCLE_S, PlcProgram, SilenceError
from drivers.room.simulator.scene import RoomState, StaticScene
from tronlab.errors import DeviceFaultError, DeviceTimeoutError, NotConnectedError


class Plc:
    """A program, and what it drives."""

    def __init__(self, scene, faults, word_order="big", now_s: float = 100.0) -> None:
        self.scene = scene
        self.lamp = SimulatedLamp(scene, has_supply=False, has_dimmer=False)
        self.program = PlcProgram(scene, self.lamp, faults, word_order=word_order, now_s=now_s)

    def beat(self, count: int, now_s: float) -> None:
        assert self.program.write_holding_registers(0, [count], now_s)


@pytest.fixture
def plc(scene, faults) -> Plc:
    return Plc(scene, faults)


@pytest.fixture
def serve(scene, faults):
    """Serve a PLC, and give a client that others wrote."""
    open_things: list[PlcServer | ModbusClient] = []

    def make(word_order: str = "big") -> ModbusClient:
        plc = Plc(scene, faults, word_order, now_s=time.monotonic())
        server = PlcServer(plc.program, faults, host="127.0.0.1", port=0)
        host, port = server.address
        client = ModbusClient(host=host, port=port, unit_id=1, timeout=5.0, auto_open=True)
        open_things.extend([server, client])
        return client

    yield make
    for thing in reversed(open_things):
        thing.close()


Serve = Callable[..., ModbusClient]


def floats(client: ModbusClient, address: int, *, big_endian: bool) -> float:
    words = client.read_input_registers(address, 2)
    assert words is not None
    return decode_ieee(word_list_to_long(words, big_endian=big_endian)[0])


@pytest.mark.parametrize(("word_order", "big_endian"), [("big", True), ("little", False)])
def test_pymodbustcp_reads_floats_in_either_word_order(
    serve: Serve, word_order: str, big_endian: bool
):
    client = serve(word_order)
    assert floats(client, 40, big_endian=big_endian) == 123456.0
    assert floats(client, 10, big_endian=big_endian) == pytest.approx(20.0, abs=1e-4)
    assert floats(client, 12, big_endian=big_endian) == pytest.approx(1013.25, abs=1e-3)
    assert floats(client, 14, big_endian=big_endian) == pytest.approx(45.0, abs=1e-4)
    assert floats(client, 16, big_endian=big_endian) == pytest.approx(24.0)


def test_pymodbustcp_reads_the_inputs(serve: Serve, faults):
    client = serve()
    assert client.read_discrete_inputs(0, 8) == [True, True, True, True, False, False, True, True]
    faults.arm("room.door_open")
    assert client.read_discrete_inputs(1, 2) == [False, False]


def test_pymodbustcp_switches_the_lamp(serve: Serve, scene):
    client = serve()
    assert client.write_single_register(0, 1)
    assert client.write_single_coil(0, True)
    assert client.read_coils(0, 5) == [True, False, False, False, False]
    assert scene.lamp_level == 1.0
    assert client.write_multiple_coils(0, [False, True, True, False, True])
    assert client.read_coils(0, 5) == [False, True, True, False, True]
    assert scene.lamp_level == 0.0


def test_pymodbustcp_dims_by_the_plc_and_is_refused_what_makes_no_sense(serve: Serve, scene):
    client = serve()
    client.write_single_register(0, 1)
    client.write_single_coil(0, True)
    half = list(struct.unpack(">HH", struct.pack(">f", 50.0)))
    assert client.write_multiple_registers(10, half)
    assert client.read_holding_registers(10, 2) == half
    assert scene.lamp_level == 0.5
    too_much = list(struct.unpack(">HH", struct.pack(">f", 101.0)))
    assert not client.write_multiple_registers(10, too_much)
    assert client.last_except == 3
    assert scene.lamp_level == 0.5


def test_pymodbustcp_is_refused_addresses_and_devices_that_are_not_there(serve: Serve):
    client = serve()
    assert client.read_input_registers(100, 1) is None
    assert client.last_except == 2
    client.unit_id = 9
    assert client.read_input_registers(0, 1) is None
    assert client.last_except == 4


def test_negative_temperatures_are_floats_too(faults, serve: Serve, scene):
    scene._state = RoomState(air_temperature_k=263.15)
    client = serve()
    assert floats(client, 10, big_endian=True) == pytest.approx(-10.0, abs=1e-4)
    assert get_2comp(0xFFFF, 16) == -1


def test_two_clients_see_one_plc(serve: Serve):
    client = serve()
    with_other = ModbusClient(host=client.host, port=client.port, timeout=5.0)
    try:
        client.write_single_register(0, 1)
        client.write_single_coil(2, True)
        assert with_other.read_coils(2, 1) == [True]
    finally:
        with_other.close()


def test_a_port_that_is_taken_is_one_clear_error(serve: Serve, plc: Plc, faults):
    port = serve().port
    with pytest.raises(NotConnectedError, match=rf"cannot listen at 127\.0\.0\.1:{port}"):
        PlcServer(plc.program, faults, host="127.0.0.1", port=port)


def test_a_port_that_is_none_is_the_same_error(plc: Plc, faults):
    with pytest.raises(NotConnectedError, match=r"cannot listen at 127\.0\.0\.1:70000"):
        PlcServer(plc.program, faults, host="127.0.0.1", port=70000)


def test_requests_need_a_heartbeat(plc: Plc, scene):
    plc.program.write_coils(0, [True], 100.0)
    assert plc.program.coils[0] is False
    plc.beat(1, 100.0)
    plc.program.write_coils(0, [True], 100.0)
    assert plc.program.coils[0] is True
    assert scene.lamp_level == 1.0


def test_requests_are_dropped_after_two_seconds_without_one(plc: Plc, scene):
    plc.beat(1, 100.0)
    plc.program.write_coils(0, [True, True, True], 100.0)
    for now_s in (100.5, 101.5, 102.0):
        plc.program.cycle(now_s)
    assert plc.program.coils[:3] == [True, True, True]
    plc.beat(1, 102.0)  # the same count again is no heartbeat
    plc.program.cycle(102.1)
    assert plc.program.coils == [False] * 5
    assert scene.lamp_level == 0.0
    assert plc.program.input_registers(102.1)[2] == 2
    plc.beat(2, 102.2)
    plc.program.cycle(102.3)
    assert plc.program.coils == [False] * 5  # they are not taken up again by themselves
    assert plc.program.input_registers(102.3)[2] == 1


def test_heartbeat_counts_seconds_and_stands_when_told(plc: Plc, faults):
    counts: list[int] = []
    for now_s in (100.0, 101.0, 103.2):
        plc.program.cycle(now_s)
        counts.append(plc.program.input_registers(now_s)[1])
    assert counts == [0, 1, 3]
    faults.arm("room.heartbeat_stopped")
    plc.program.cycle(110.0)
    assert plc.program.input_registers(110.0)[1] == 3


@pytest.mark.parametrize("fault", ["room.emergency_stop", "room.over_temperature"])
def test_the_lamp_goes_dark_by_itself(plc: Plc, scene, faults, fault: str):
    plc.beat(1, 100.0)
    plc.program.write_coils(0, [True], 100.0)
    faults.arm(fault)
    plc.program.cycle(100.1)
    assert scene.lamp_level == 0.0
    assert plc.program.input_registers(100.1)[2] == 3
    plc.program.write_coils(0, [True], 100.2)
    assert scene.lamp_level == 0.0


def test_the_curtain_takes_a_second(plc: Plc):
    plc.beat(1, 100.0)
    plc.program.write_coils(1, [True], 100.0)
    plc.program.cycle(100.6)
    assert plc.program.discrete_inputs()[4] is False
    plc.program.cycle(101.1)
    assert plc.program.discrete_inputs()[4] is True


class Scripted(StaticScene):
    """A scene whose script has one error for every call."""

    def __init__(self, error: Exception) -> None:
        super().__init__()
        self.error = error
        self.calls: list[str] = []

    def begin(self, call: str) -> None:
        self.calls.append(call)
        raise self.error


def test_a_scripted_timeout_is_silence(faults):
    plc = Plc(Scripted(DeviceTimeoutError("x", device="room")), faults)
    with pytest.raises(SilenceError):
        plc.program.begin_read()


def test_a_scripted_fault_is_the_error_code(faults):
    scene = Scripted(DeviceFaultError("x", device="room", code=900))
    plc = Plc(scene, faults)
    plc.program.begin_read()
    assert plc.program.input_registers(100.0)[3] == 900
    plc.beat(1, 100.0)
    plc.program.write_coils(0, [True], 100.0)
    assert plc.program.coils[0] is False
    plc.program.write_coils(1, [True], 100.0)
    assert scene.calls == ["read", "switch_lamp"]


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (DeviceTimeoutError("x", device="room"), DeviceTimeoutError),
        (DeviceFaultError("x", device="room", code=900), DeviceFaultError),
    ],
)
@pytest.mark.parametrize("call", ["read", "switch_lamp"])
def test_scripted_faults_reach_the_driver(
    tmp_path, faults, make_lab, make_room, error, kind, call: str
):
    lab = make_lab().without("dimmer", "supply", "air")
    lab.scene = Scripted(error)
    room = make_room(lab.start())
    room.connect()
    room.identify()
    assert lab.scene.calls == []
    with pytest.raises(kind, match=f"^here: {call}: ") as caught:
        room.read() if call == "read" else room.switch_lamp(on=True)
    assert lab.scene.calls[0] == call
    assert getattr(caught.value, "code", 900) == 900


class Shared(StaticScene):
    """The scene of a laboratory that nobody serves for a while."""

    is_gone = False

    def state(self) -> RoomState:
        self._check()
        return super().state()

    def set_lamp(self, level: float) -> None:
        self._check()
        super().set_lamp(level)

    def _check(self) -> None:
        if self.is_gone:
            raise NotConnectedError("nobody answers", device="simulated world")


def test_a_laboratory_that_was_gone_for_a_while_ends_nothing(make_lab, make_room):
    lab = make_lab()
    lab.scene = scene = Shared()
    room = make_room(lab.start())
    room.connect()
    room.switch_lamp(on=True)
    scene.is_gone = True
    with pytest.raises(DeviceTimeoutError, match="no answer from the air sensor"):
        room.read()
    room.close()
    time.sleep(2.5 * CYCLE_S)
    scene.is_gone = False
    room.connect()
    room.switch_lamp(on=True)
    assert room.read().is_lamp_on
    assert scene.lamp_level == 1.0


def test_what_the_laboratory_did_not_take_is_told_it_again():
    scene = Shared()
    lamp = SimulatedLamp(scene, has_supply=False, has_dimmer=False)
    scene.is_gone = True
    with pytest.raises(NotConnectedError):
        lamp.close_contactor(closed=True)
    scene.is_gone = False
    lamp.close_contactor(closed=True)
    assert scene.lamp_level == lamp.level == 1.0
