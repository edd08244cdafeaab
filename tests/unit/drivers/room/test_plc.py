"""The PLC's part of the driver against the simulated PLC."""

import time
from contextlib import closing
from dataclasses import asdict

import pytest
from pyModbusTCP.client import ModbusClient

from drivers.room.plc import RoomPlc
from drivers.room.registers import PlcState
from tronlab.errors import (
    DeviceFaultError,
    DeviceTimeoutError,
    NotConnectedError,
    ProtocolError,
)


@pytest.fixture
def make_plc():
    made: list[RoomPlc] = []

    def make(lab) -> RoomPlc:
        plc = RoomPlc(lab.options.plc, device="here")
        made.append(plc)
        return plc

    yield make
    for plc in made:
        plc.close()


@pytest.fixture
def plc(lab, make_plc):
    plc = make_plc(lab)
    plc.connect()
    return plc


@pytest.mark.parametrize("word_order", ["big", "little"])
def test_air_is_read_in_either_word_order(make_lab, make_plc, word_order: str):
    plc = make_plc(make_lab(word_order=word_order).start())
    plc.connect()
    air = plc.read_air()
    assert air.temperature_k == pytest.approx(293.15, abs=1e-4)
    assert air.pressure_pa == pytest.approx(101325.0, abs=0.01)
    assert air.relative_humidity == pytest.approx(0.45, abs=1e-6)


@pytest.mark.parametrize(("right", "wrong"), [("big", "little"), ("little", "big")])
def test_wrong_word_order_names_the_option(make_lab, make_plc, right: str, wrong: str):
    lab = make_lab(word_order=right).start().moved(word_order=wrong)
    with pytest.raises(ProtocolError, match=f"set plc.word_order to '{right}'"):
        make_plc(lab).connect()


def test_the_fault_of_the_word_order_is_seen_when_connecting(lab, make_plc, faults):
    faults.arm("room.wrong_word_order")
    with pytest.raises(ProtocolError, match=r"not the constant 123456\.0") as caught:
        make_plc(lab).connect()
    assert caught.value.sent[-4:] == bytes.fromhex("00 28 00 02")


def test_wrong_device_id_names_the_option(lab, make_plc):
    with pytest.raises(DeviceFaultError, match=r"is plc\.device_id 9 right\?") as caught:
        make_plc(lab.moved(device_id=9)).connect()
    assert caught.value.code == 4


def test_safety_inputs_by_name(plc: RoomPlc, faults):
    assert asdict(plc.safety()) == {
        "is_emergency_stop_released": True,
        "is_door_closed": True,
        "is_area_clear": True,
        "is_robot_automatic": True,
        "is_curtain_closed": False,
        "is_lamp_too_hot": False,
        "is_rail_enabled": True,
        "is_watchdog_ok": True,
    }
    for name in ("room.emergency_stop", "room.over_temperature", "room.door_open"):
        faults.arm(name)
    inputs = plc.safety()
    assert not inputs.is_emergency_stop_released
    assert inputs.is_lamp_too_hot
    assert not inputs.is_door_closed


def test_uptime_and_state(plc: RoomPlc):
    assert 0.0 <= plc.uptime_s() < 3600.0
    assert plc.status().state == PlcState.READY
    plc.check_ready()


def test_curtain_closes_and_opens(plc: RoomPlc):
    plc.set_curtain(closed=True)
    assert plc.safety().is_curtain_closed
    plc.set_curtain(closed=False)
    assert not plc.safety().is_curtain_closed


def test_a_curtain_that_sticks_is_a_timeout(lab, make_plc):
    plc = make_plc(lab.moved(curtain_timeout_s=0.01))
    plc.connect()
    with pytest.raises(DeviceTimeoutError, match=r"the curtain is not closed after 0\.01 s"):
        plc.set_curtain(closed=True)


def test_requests_are_kept_while_the_heartbeat_runs(plc: RoomPlc, scene):
    plc.request_lamp(on=True)
    assert plc.is_lamp_requested()
    plc.set_warning_light(on=True)
    plc.request_lamp(on=False)
    assert not plc.is_lamp_requested()


def test_a_request_that_is_not_kept_is_an_error(plc: RoomPlc, faults):
    faults.arm("room.over_temperature")
    with pytest.raises(DeviceFaultError, match="did not keep the request: lamp on"):
        plc.request_lamp(on=True)


def test_a_program_that_stands_is_noticed(lab, make_plc, faults):
    plc = make_plc(lab.moved(heartbeat_timeout_s=1.5))
    plc.connect()
    plc.safety()
    faults.arm("room.heartbeat_stopped")

    def look_on():
        end_s = time.monotonic() + 30.0
        while time.monotonic() < end_s:
            plc.safety()
            time.sleep(0.05)

    with pytest.raises(DeviceFaultError, match=r"its heartbeat has not changed for .* 1\.5 s"):
        look_on()


def test_who_closes_can_connect_again(plc: RoomPlc):
    plc.close()
    plc.close()
    with pytest.raises(NotConnectedError):
        plc.safety()
    plc.connect()
    assert plc.safety().is_door_closed


def test_connecting_is_itself_a_heartbeat(lab, make_plc):
    plc, counts = make_plc(lab), list[int]()
    client = ModbusClient(host=lab.options.plc.host, port=lab.options.plc.port, timeout=5.0)
    with closing(client):
        for _ in range(3):  # each connection ends before its second beat
            plc.connect()
            plc.close()
            counts += client.read_holding_registers(0, 1) or []
    assert counts == [1, 2, 3]


def test_identity(plc: RoomPlc):
    identity = plc.identify()
    assert str(identity) == "tronlab simulated room PLC sim-1"
