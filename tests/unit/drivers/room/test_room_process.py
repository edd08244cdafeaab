"""``python -m drivers.room.simulator``: as a process of its own, alone and with a rig."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from drivers.room.driver import RoomDriver
from drivers.room.options import RoomOptions
from drivers.room.simulator.__main__ import main
from drivers.room.simulator.scene import FAULTS
from tronlab.campaign.rig import load_rig
from tronlab.errors import DeviceFaultError, SafetyError
from tronlab.twin.faults import FAULT_CODE
from tronlab.twin.server import StateServer
from tronlab.twin.state import LocalState
from tronlab.twin.world import initial_state

ROOT = Path(__file__).parents[4]
RIG = ROOT / "campaigns" / "rigs" / "twin.yaml"


@pytest.fixture
def run(tmp_path: Path):
    """Run the simulator, and end it."""
    processes: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "drivers.room.simulator", *arguments],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        return process

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def wait_for(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end_s, "it never happened"
        time.sleep(0.05)


def announced(process: subprocess.Popen[str], n: int) -> dict[str, dict[str, str | int]]:
    assert process.stdout is not None
    lines = [json.loads(process.stdout.readline()) for _ in range(n)]
    return {line["device"]: line for line in lines}


def options_for(addresses: dict[str, dict[str, str | int]]) -> RoomOptions:
    return RoomOptions.model_validate(
        {
            "plc": {"host": addresses["room plc"]["host"], "port": addresses["room plc"]["port"]},
            "dimmer": {"path": addresses["room dimmer"]["port"]},
            "supply": {
                "path": addresses["room supply"]["port"],
                "voltage_v": 24.0,
                "current_a": 5.0,
            },
            "air": {"path": addresses["room air"]["port"]},
            "lamp_settle_s": 0.0,
        }
    )


def test_alone_it_is_a_room_with_every_part(run):
    process = run("--port", "0")
    addresses = announced(process, 4)
    assert {line["host"] for name, line in addresses.items() if name != "room plc"} == {"pty"}
    room = RoomDriver("room", options_for(addresses))
    try:
        room.connect()
        room.switch_lamp(on=True)
        assert room.read().is_lamp_on
    finally:
        room.close()
    paths = [Path(str(addresses[f"room {part}"]["port"])) for part in ("dimmer", "supply", "air")]
    assert all(path.is_symlink() for path in paths)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0
    assert errors == ""
    assert not any(path.is_symlink() or path.parent.exists() for path in paths)


def rig_with_room(folder: Path) -> Path:
    """Write the twin's rig with a PLC room that has an air sensor only, and one scripted fault."""
    room = "{driver: plc.room, options: {plc: {host: 127.0.0.1, port: 1}, air: {path: air}}}"
    fault = "{device: room, call: read, at: 3, error: fault}"
    text = RIG.read_text()
    for old, new in {
        "room: {driver: twin.room}": f"room: {room}",
        "\n  faults: []": f"\n  faults: [{fault}]",
    }.items():
        assert old in text
        text = text.replace(old, new)
    rig = folder / "rig.yaml"
    rig.write_text(text)
    return rig


def test_with_a_rig_it_is_the_room_of_the_shared_laboratory(run, tmp_path: Path):
    folder = tmp_path / "rigs"
    folder.mkdir()
    rig = rig_with_room(folder)
    setup = load_rig(rig).world_setup()
    assert setup is not None
    state = LocalState(initial_state(setup))
    with closing(StateServer(state)) as server:
        host, port = server.address
        process = run("--rig", str(rig), "--port", "0", "--world", f"{host}:{port}")
        addresses = announced(process, 2)
        assert set(addresses) == {"room plc", "room air"}
        assert addresses["room air"]["port"] == str(folder / "air")
        plc = {"host": addresses["room plc"]["host"], "port": addresses["room plc"]["port"]}
        options = RoomOptions.model_validate(
            {"plc": plc, "air": {"path": "air"}, "lamp_settle_s": 0.0}
        )
        room = RoomDriver("room", options, base_dir=folder)
        with closing(room):
            room.connect()
            room.switch_lamp(on=True)
            assert state.read().lamp_level == 1.0
            assert room.read().air_pressure_pa == pytest.approx(101325.0, abs=5.1)
            state.change(air_temperature_k=301.25)
            assert room.read().air_temperature_k == pytest.approx(301.25, abs=0.051)
            with pytest.raises(DeviceFaultError) as scripted:
                room.read()
            assert scripted.value.code == FAULT_CODE
            state.change(is_door_closed=False)
            wait_for(lambda: not room.read().is_door_closed)
            state.arm("room.emergency_stop")
            wait_for(lambda: state.read().lamp_level == 0.0)
            with pytest.raises(SafetyError):
                room.read()
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=60)
        assert (process.returncode, errors) == (0, "")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--fault", "room.no_such"], "no fault 'room.no_such'; faults: room.door_open"),
        (["--rig", str(RIG), "--serial-dir", "."], "--serial-dir is not for --rig"),
        (["--rig", str(RIG)], "devices.room.options.plc: required key is missing"),
        (["--serial-dir", __file__, "--port", "0"], "a simulated serial port cannot be made here"),
    ],
)
def test_a_mistake_is_one_line(monkeypatch, capsys, arguments: list[str], message: str):
    monkeypatch.setattr("sys.argv", ["simulator", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    errors = capsys.readouterr().err
    assert ended.value.code == 2
    assert errors.startswith("error: ")
    assert message in errors
    assert errors.count("\n") == 1


def test_help_lists_every_fault(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["simulator", "--help"])
    with pytest.raises(SystemExit):
        main()
    text = capsys.readouterr().out
    assert "--serial-dir" in text
    for fault in FAULTS:
        assert fault in text
