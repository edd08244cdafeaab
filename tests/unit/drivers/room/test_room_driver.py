"""The room as one device: what it reads and switches, and every fault by its name."""

import sys
import threading
import time

import pytest

from drivers.room.simulator.scene import FAULTS, RoomState
from tronlab.devices.protocols import RoomIO
from tronlab.errors import (
    DeviceError,
    DeviceFaultError,
    DeviceTimeoutError,
    NotConnectedError,
    NotReadyError,
    ProtocolError,
    SafetyError,
    TronlabError,
)


def switch_on(room):
    room.switch_lamp(on=True)


def read(room):
    return room.read()


def connect(room):
    room.connect()


def read_until_it_fails(room):
    end_s = time.monotonic() + 30.0
    while time.monotonic() < end_s:
        room.read()
        time.sleep(0.05)


CASES = {
    "room.emergency_stop": [(read, SafetyError), (switch_on, SafetyError)],
    "room.over_temperature": [(read, SafetyError), (switch_on, SafetyError)],
    "room.silent": [(read, DeviceTimeoutError), (switch_on, DeviceTimeoutError)],
    "room.disconnect": [(read, NotConnectedError), (switch_on, NotConnectedError)],
    "room.wrong_word_order": [(connect, ProtocolError)],
    "room.heartbeat_stopped": [(read_until_it_fails, DeviceFaultError)],
    "room.dimmer_silent": [(switch_on, DeviceTimeoutError), (connect, DeviceTimeoutError)],
    "room.supply_error": [(switch_on, DeviceFaultError)],
    "room.supply_silent": [(switch_on, DeviceTimeoutError), (connect, DeviceTimeoutError)],
    "room.air_silent": [(read, DeviceTimeoutError), (connect, DeviceTimeoutError)],
    "room.air_garbage": [(read, ProtocolError), (connect, ProtocolError)],
    "room.air_missing": [(read, NotReadyError)],
}
"""What each fault makes of which action; ``room.door_open`` is a reading and no error."""


def test_every_fault_has_a_case():
    assert set(CASES) == set(FAULTS) - {"room.door_open"}


@pytest.mark.parametrize(
    ("fault", "act", "kind"),
    [
        pytest.param(fault, act, kind, id=f"{fault}-{act.__name__}")
        for fault, cases in CASES.items()
        for act, kind in cases
    ],
)
def test_every_fault_has_its_error_and_the_room_recovers(
    lab, make_room, faults, scene, fault: str, act, kind
):
    room = make_room(lab.moved(heartbeat_timeout_s=1.5))
    room.connect()
    faults.arm(fault)
    with pytest.raises(kind, match=r"^here: (read|switch_lamp|connect): ") as caught:
        act(room)
    assert type(caught.value) is kind
    assert caught.value.device == "here"
    assert scene.lamp_level == 0.0
    faults.arm(fault, times=0)
    room.close()
    room.connect()
    switch_on(room)
    assert room.read().is_lamp_on
    assert scene.lamp_level == 1.0


def test_keeps_the_protocol(room):
    assert isinstance(room, RoomIO)


def test_reads_the_room(make_lab, make_room, scene):
    scene._state = RoomState(
        is_door_closed=False,
        air_temperature_k=295.25,
        air_pressure_pa=94350.0,
        relative_humidity=0.383,
    )
    room = make_room(make_lab().start())
    room.connect()
    before_s = time.time()
    reading = room.read()
    assert before_s <= reading.time_s <= time.time()
    assert not reading.is_door_closed
    assert reading.air_temperature_k == pytest.approx(295.25, abs=0.051)
    assert reading.air_pressure_pa == pytest.approx(94350.0, abs=5.1)
    assert reading.relative_humidity == pytest.approx(0.383, abs=0.00051)


def test_an_open_door_is_a_reading(room, faults, scene):
    faults.arm("room.door_open")
    assert not room.read().is_door_closed
    room.switch_lamp(on=True)
    assert scene.lamp_level == 1.0


def test_lamp_burns_with_exactly_its_full_light_and_goes_dark(room, scene):
    assert not room.read().is_lamp_on
    room.switch_lamp(on=True)
    assert scene.lamp_level == 1.0
    assert room.read().is_lamp_on
    room.switch_lamp(on=False)
    assert scene.lamp_level == 0.0
    assert not room.read().is_lamp_on


@pytest.mark.parametrize(
    "missing",
    [("dimmer",), ("supply",), ("air",), ("dimmer", "supply"), ("dimmer", "supply", "air")],
    ids="-".join,
)
def test_a_room_without_some_parts(make_lab, make_room, scene, missing: tuple[str, ...]):
    room = make_room(make_lab().without(*missing).start())
    room.connect()
    room.switch_lamp(on=True)
    reading = room.read()
    assert reading.is_lamp_on
    assert reading.air_temperature_k == pytest.approx(293.15, abs=0.05)
    assert scene.lamp_level == 1.0
    assert set(room.identify_parts()) == {"plc", "dimmer", "supply", "air"} - set(missing)


def test_a_dimmed_lamp_with_sixteen_bits(make_lab, make_room, scene):
    lab = make_lab()
    dimmed = {"channel": 5, "fine_channel": 6, "level": 0.3}
    lab.options = lab.options.model_copy(
        update={"dimmer": lab.options.dimmer.model_copy(update=dimmed)}
    )
    room = make_room(lab.start())
    room.connect()
    room.switch_lamp(on=True)
    assert scene.lamp_level == pytest.approx(0.3, abs=1e-5)
    assert scene.lamp_level == round(0.3 * 65535) / 65535


def test_connecting_switches_nothing(lab, make_room, scene):
    first = make_room(lab)
    first.connect()
    first.switch_lamp(on=True)
    first.close()
    second = make_room(lab)
    second.connect()
    assert scene.lamp_level == 1.0
    second.switch_lamp(on=False)
    assert scene.lamp_level == 0.0


def test_asking_who_the_parts_are_leaves_the_lamp_on(room, scene):
    room.switch_lamp(on=True)
    parts = room.identify_parts()
    assert str(parts["dimmer"]) == "ENTTEC DMX USB Pro 07654321 1.44"
    assert parts["supply"].model == "simulated supply"
    assert str(parts["air"]) == "Vaisala PTU300"
    assert scene.lamp_level == 1.0
    assert room.read().is_lamp_on


def test_safety_is_told_even_when_it_is_not_safe(room, faults):
    faults.arm("room.emergency_stop")
    assert not room.safety().is_emergency_stop_released
    room.switch_lamp(on=False)


def test_a_lamp_that_the_emergency_stop_put_out_is_not_forgotten(room, faults, scene):
    room.switch_lamp(on=True)
    faults.arm("room.emergency_stop")
    end_s = time.monotonic() + 30.0
    while scene.lamp_level and time.monotonic() < end_s:
        time.sleep(0.02)
    with pytest.raises(SafetyError):
        room.read()
    faults.arm("room.emergency_stop", times=0)
    with pytest.raises(NotConnectedError, match="switch the lamp on"):
        room.read()
    room.close()
    room.connect()
    room.switch_lamp(on=True)
    assert room.read().is_lamp_on


@pytest.mark.parametrize("kind", [DeviceFaultError, NotConnectedError])
def test_a_lamp_that_fails_because_the_cell_became_unsafe_is_sound(
    room, faults, monkeypatch: pytest.MonkeyPatch, kind: type
):
    def go_dark():
        faults.arm("room.emergency_stop")
        code = {"code": 0} if kind is DeviceFaultError else {}
        raise kind("dark", device="here", **code)

    monkeypatch.setattr(room._lamp, "switch_on", go_dark)
    with pytest.raises(SafetyError, match=r"^here: switch_lamp: the emergency stop is pressed"):
        room.switch_lamp(on=True)


def test_curtain_and_warning_light(room):
    room.set_curtain(closed=True)
    assert room.safety().is_curtain_closed
    room.set_warning_light(on=True)
    room.set_curtain(closed=False)


def test_after_silence_every_call_says_so_until_connected_again(room, faults):
    faults.arm("room.silent")
    for _ in range(2):
        with pytest.raises(DeviceTimeoutError):
            room.read()
    faults.arm("room.silent", times=0)
    with pytest.raises(DeviceTimeoutError, match=r"call connect\(\) again"):
        room.read()
    room.connect()
    room.read()


def test_all_parts_that_fail_are_named_at_once(lab, make_room, faults):
    for fault in ("room.silent", "room.dimmer_silent", "room.air_silent"):
        faults.arm(fault)
    with pytest.raises(NotConnectedError, match=r"connect: 3 parts failed") as caught:
        make_room(lab).connect()
    for what in ("the PLC at", "the dimmer at", "the air sensor at"):
        assert what in str(caught.value)


def test_a_package_that_is_missing_leaves_nothing_running(lab, make_room, monkeypatch):
    monkeypatch.setitem(sys.modules, "serial", None)
    room = make_room(lab)
    with pytest.raises(TronlabError, match=r"^here: pyserial is not installed: pip install"):
        room.connect()
    assert not any(thread.name == "room heartbeat" for thread in threading.enumerate())


def test_nothing_stays_open_after_a_connect_that_failed(lab, make_room, faults):
    faults.arm("room.silent")
    with pytest.raises(DeviceTimeoutError):
        make_room(lab, name="first").connect()
    faults.arm("room.silent", times=0)
    second = make_room(lab, name="second")
    second.connect()
    second.read()


def test_a_second_driver_is_refused(lab, room, make_room):
    with pytest.raises(NotConnectedError, match="another program has it"):
        make_room(lab).connect()
    room.read()


@pytest.mark.parametrize(
    "act",
    [
        lambda room: room.identify(),
        lambda room: room.identify_parts(),
        lambda room: room.read(),
        lambda room: room.switch_lamp(on=True),
        lambda room: room.safety(),
        lambda room: room.set_curtain(closed=True),
        lambda room: room.set_warning_light(on=True),
    ],
)
def test_use_before_connect_and_after_close(lab, make_room, act):
    room = make_room(lab)
    with pytest.raises(NotConnectedError, match=r"^here: \w+: not connected; call connect\(\)"):
        act(room)
    room.connect()
    room.close()
    with pytest.raises(NotConnectedError, match=r"^here: \w+: not connected; call connect\(\)"):
        act(room)


def test_close_never_fails(lab, make_room):
    room = make_room(lab)
    room.close()
    room.connect()
    lab.close()
    room.close()
    room.close()


def test_when_the_whole_room_goes_away_the_error_is_named(lab, room):
    lab.close()
    with pytest.raises(DeviceError, match=r"^here: read: lost"):
        room.read()
