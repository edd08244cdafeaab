"""Options of a room: what may stand in a rig file."""

from pathlib import Path
from typing import Any

import pytest

from drivers.room.driver import open_room
from drivers.room.options import RoomOptions
from tronlab.devices.registry import DeviceContext
from tronlab.errors import ConfigError

PLC = {"host": "plc.lab"}


def parse(**options: Any) -> RoomOptions:
    context = DeviceContext(name="room", options=options, seed=1, world=None)
    return context.parse_options(RoomOptions)


def test_a_plc_is_enough():
    options = parse(plc=PLC)
    assert (options.plc.port, options.plc.word_order) == (502, "big")
    assert (options.dimmer, options.supply, options.air) == (None, None, None)


def test_null_means_that_the_room_has_none():
    assert parse(plc=PLC, dimmer=None).dimmer is None


def test_line_of_the_supply_is_as_the_e3632a_leaves_the_factory():
    supply = parse(plc=PLC, supply={"path": "x", "voltage_v": 24, "current_a": 5}).supply
    assert supply is not None
    assert (supply.baud, supply.data_bits, supply.parity, supply.stop_bits) == (9600, 8, "none", 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, r"devices\.room\.options\.plc: required key is missing"),
        ({"plc": {}}, r"plc\.host: required key is missing"),
        ({"plc": {**PLC, "port": 70000}}, r"plc\.port: .*less than or equal to 65535, got 70000"),
        ({"plc": {**PLC, "word_order": "middle"}}, r"plc\.word_order: must be 'big' or 'little'"),
        ({"plc": PLC, "dimmer": {"path": "x", "channel": 513}}, r"dimmer\.channel: .*512"),
        ({"plc": PLC, "dimmer": {"path": "x", "level": 1.1}}, r"dimmer\.level: .*1, got 1\.1"),
        ({"plc": PLC, "dimmer": {"path": "x", "fine_channel": 1}}, r"fine_channel: is 1 like"),
        ({"plc": PLC, "supply": {"path": "x"}}, r"supply\.voltage_v: required key is missing"),
        ({"plc": PLC, "air": {"path": "x", "baudrate": 1}}, r"did you mean baud\?"),
    ],
)
def test_what_is_wrong_is_said_with_its_key(options: dict[str, Any], message: str):
    with pytest.raises(ConfigError, match=message):
        parse(**options)


def test_the_factory_opens_nothing(tmp_path: Path):
    context = DeviceContext(
        name="room",
        options={"plc": {"host": "no.such.host"}, "air": {"path": "air"}},
        seed=1,
        world=None,
        base_dir=tmp_path,
    )
    assert open_room(context).name == "room"


@pytest.mark.parametrize(
    ("path", "located"),
    [
        ("serial/air", "/rigs/serial/air"),
        ("/dev/ttyUSB0", "/dev/ttyUSB0"),
        ("COM3", "COM3"),
        ("socket://server:4001", "socket://server:4001"),
        ("COMMON/air", "/rigs/COMMON/air"),
    ],
)
def test_paths_start_at_the_rig_file_and_urls_do_not(path: str, located: str):
    options = parse(plc=PLC, air={"path": path}).located(Path("/rigs"))
    assert options.air is not None
    assert options.air.path == located
    assert options.dimmer is None
