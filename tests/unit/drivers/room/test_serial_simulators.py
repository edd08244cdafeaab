"""The simulated serial devices: driven by clients that others wrote, and typed to by hand."""

import time
from contextlib import closing

import pytest
from DMXEnttecPro import Controller

from drivers.room.dimmer import Dimmer
from drivers.room.options import DimmerOptions
from drivers.room.simulator.dmx import DmxWidget
from drivers.room.simulator.lamp import SimulatedLamp
from drivers.room.simulator.ptu300 import Ptu300
from drivers.room.simulator.pty_device import PtyDevice
from drivers.room.simulator.scene import RoomState
from drivers.room.simulator.scpi import ScpiSupply


class Tap:
    """Listens on a serial line to what is sent to a device."""

    def __init__(self, device) -> None:
        self._device = device
        self.heard = b""

    def receive(self, data: bytes) -> bytes:
        self.heard += data
        return self._device.receive(data)

    def spontaneous(self) -> bytes:
        return self._device.spontaneous()


def wait_for(condition) -> None:
    end_s = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end_s, "it never happened"
        time.sleep(0.005)


@pytest.fixture
def lamp(scene) -> SimulatedLamp:
    lamp = SimulatedLamp(scene, has_supply=True, has_dimmer=True)
    lamp.close_contactor(closed=True)
    lamp.power(on=True)
    return lamp


@pytest.fixture
def tap(lamp, faults, tmp_path):
    tap = Tap(DmxWidget(lamp, faults, channel=1, fine_channel=2))
    terminal = PtyDevice(tmp_path / "dmx", tap)
    yield tap
    terminal.close()


def test_dmxenttecpro_dims_the_simulated_lamp(tap: Tap, tmp_path, scene):
    with closing(Controller(str(tmp_path / "dmx"), dmx_size=512)) as controller:
        controller.set_channel(1, 128)
        controller.submit()
        wait_for(lambda: scene.lamp_level == 128 * 256 / 65535)
        controller.all_channels_on()
        controller.submit()
        wait_for(lambda: scene.lamp_level == 1.0)
        controller.clear_channels()
        controller.submit()
        wait_for(lambda: scene.lamp_level == 0.0)


def test_driver_sends_the_bytes_that_dmxenttecpro_sends(tap: Tap, tmp_path):
    path = str(tmp_path / "dmx")
    with closing(Controller(path, dmx_size=24)) as controller:
        controller.set_channel(1, 255)
        controller.set_channel(2, 16)
        controller.submit()
        wait_for(lambda: tap.heard.endswith(b"\xe7"))
    theirs = tap.heard
    assert theirs == bytes.fromhex("7e 06 19 00 00 ff 10") + bytes(22) + b"\xe7"
    dimmer = Dimmer(DimmerOptions(path=path, channel=1, fine_channel=2), device="here")
    dimmer.connect()
    tap.heard = b""
    dimmer.set_level(0xFF10 / 0xFFFF)
    dimmer.close()
    assert tap.heard.startswith(theirs)


def test_simulated_widget_takes_the_parameters_of_dmxenttecpro(tap: Tap, tmp_path):
    with closing(Controller(str(tmp_path / "dmx"))) as controller:
        controller.set_dmx_parameters(output_break_time=20, mab_time=3, output_rate=0)
        wait_for(lambda: tap.heard.endswith(b"\xe7"))
    assert tap.heard == bytes.fromhex("7e 04 05 00 00 00 14 03 00 e7")
    assert tap.receive(bytes.fromhex("7e 03 02 00 00 00 e7")) == bytes.fromhex(
        "7e 03 05 00 2c 01 14 03 00 e7"
    )


def test_a_widget_asked_for_its_serial_number_stops_sending(tap: Tap, scene):
    tap.receive(bytes.fromhex("7e 06 19 00 00 ff ff") + bytes(22) + b"\xe7")
    assert scene.lamp_level == 1.0
    assert tap.receive(bytes.fromhex("7e 03 02 00 00 00 e7"))
    assert scene.lamp_level == 1.0
    assert tap.receive(bytes.fromhex("7e 0a 00 00 e7")) == bytes.fromhex("7e 0a 04 00 21436507 e7")
    assert scene.lamp_level == 0.0


@pytest.mark.parametrize(
    "frame",
    [
        bytes.fromhex("7e 06 18 00 00 ff ff") + bytes(21) + b"\xe7",
        bytes.fromhex("7e 06 19 00 01 ff ff") + bytes(22) + b"\xe7",
        bytes.fromhex("7e 06 19 00 00 ff ff") + bytes(22) + b"\xe6",
        bytes.fromhex("7e 06 ff ff 00 ff ff"),
    ],
    ids=["23 channels", "start code 1", "no end", "too long"],
)
def test_the_widget_ignores_frames_that_are_none(tap: Tap, scene, frame: bytes):
    assert tap.receive(frame) == b""
    assert scene.lamp_level == 0.0
    tap.receive(bytes.fromhex("7e 06 19 00 00 ff ff") + bytes(22) + b"\xe7")
    assert scene.lamp_level == 1.0


@pytest.fixture
def supply(lamp, faults) -> ScpiSupply:
    lamp.power(on=False)
    lamp.dim(1.0)
    supply = ScpiSupply(lamp, faults, serial="7")
    assert supply.receive(b"SYST:REM\n") == b""
    return supply


def ask(supply: ScpiSupply, line: str) -> str:
    return supply.receive(line.encode() + b"\n").decode().strip()


def test_supply_in_local_control_refuses(lamp, faults):
    supply = ScpiSupply(lamp, faults, serial="")
    assert ask(supply, "VOLT 1") == ""
    assert ask(supply, "*IDN?") == ""
    ask(supply, "SYST:REM")
    assert ask(supply, "SYST:ERR?") == '+550,"Command not allowed in local"'
    assert ask(supply, "VOLT?") == "+0.00000000E+00"


def test_supply_feeds_the_lamp(supply: ScpiSupply, scene):
    ask(supply, "VOLT 24")
    ask(supply, "CURR 5")
    assert float(ask(supply, "MEAS:VOLT?")) == 0.0
    ask(supply, "OUTP ON")
    assert scene.lamp_level == 1.0
    assert float(ask(supply, "MEAS:VOLT?")) == 24.0
    assert float(ask(supply, "MEAS:CURR?")) == 5.0
    ask(supply, "*RST")
    assert scene.lamp_level == 0.0
    assert ask(supply, "OUTP?") == "0"


def test_supply_takes_lines_in_pieces_and_several_at_once(supply: ScpiSupply):
    assert supply.receive(b"VOL") == b""
    assert supply.receive(b"T 3\r\nVOLT?\nOUT") == b"+3.00000000E+00\r\n"
    assert supply.receive(b"P?\n") == b"0\r\n"


@pytest.mark.parametrize(
    ("command", "error"),
    [
        ("VOLT 31", '-222,"Data out of range"'),
        ("CURR -1", '-222,"Data out of range"'),
        ("VOLT lots", '-104,"Data type error"'),
        ("FREQ 3", '-113,"Undefined header"'),
        ("FREQ?", '-113,"Undefined header"'),
    ],
)
def test_supply_queues_its_errors(supply: ScpiSupply, command: str, error: str):
    assert ask(supply, command) == ""
    assert ask(supply, "SYST:ERR?") == error
    assert ask(supply, "SYST:ERR?") == '+0,"No error"'


def test_supply_forgets_errors_when_its_queue_is_full(supply: ScpiSupply):
    for _ in range(25):
        ask(supply, "FREQ 3")
    errors = [ask(supply, "SYST:ERR?") for _ in range(21)]
    assert errors[0] == '-113,"Undefined header"'
    assert errors[19] == '-350,"Too many errors"'
    assert errors[20] == '+0,"No error"'


@pytest.fixture
def sensor(faults) -> Ptu300:
    return Ptu300(RoomState, faults)


def test_sensor_echoes_and_prompts(sensor: Ptu300):
    assert sensor.receive(b"se") == b"se"
    assert sensor.receive(b"nd\r") == b"nd\r\nP= 1013.2 hPa T= 20.0 'C RH= 45.0 %RH\r\n>"
    assert sensor.receive(b"form /\r") == b"form /\r\nOK\r\n>"
    assert sensor.receive(b"what\r") == b"what\r\n>"


def test_sensor_in_run_mode_neither_echoes_nor_answers(faults):
    sensor = Ptu300(RoomState, faults, is_running=True, interval_s=0.0)
    assert sensor.spontaneous().startswith(b"P= 1013.2 hPa")
    assert sensor.receive(b"send\r") == b""
    assert sensor.receive(b"s\r") == b">"
    assert sensor.spontaneous() == b""
    sensor.receive(b"r\r")
    assert sensor.spontaneous().startswith(b"P= 1013.2 hPa")
