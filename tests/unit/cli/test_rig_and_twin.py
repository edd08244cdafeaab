"""``tronlab rig check`` and ``tronlab twin`` as a person meets them."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from ruamel.yaml import YAML

RIGS = Path(__file__).parents[3] / "campaigns" / "rigs"
MAIN = [sys.executable, "-c", "from tronlab.cli import main; main()"]


def tronlab(*arguments: object) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [*MAIN, *map(str, arguments)], capture_output=True, text=True, timeout=120, check=False
    )


def variant(path: Path, **devices: object) -> Path:
    """Write a rig that is the twin but for some devices."""
    twin = YAML().load((RIGS / "twin.yaml").read_text(encoding="utf-8"))["devices"]
    with path.open("w", encoding="utf-8") as file:
        YAML().dump(
            {"extends": str(RIGS / "twin.yaml"), "devices": {**dict(twin), **devices}}, file
        )
    return path


def test_rig_check_says_who_answers(tmp_path: Path):
    done = tronlab("rig", "check", RIGS / "twin.yaml")
    assert done.returncode == 0, done.stderr
    assert "tracker   ok      twin.tracker" in done.stdout
    assert "Leica AT901-MR" in done.stdout
    assert "all 5 devices answer" in done.stdout


def test_rig_check_lists_every_failure_and_goes_on(tmp_path: Path):
    closed = f"127.0.0.1:{unused_port()}"
    rig = variant(
        tmp_path / "rig.yaml",
        operator={"driver": "twin.operator", "options": {"world": closed}},
        room={"driver": "twin.room", "options": {"world": closed}},
    )
    done = tronlab("rig", "check", rig)
    assert done.returncode == 1
    assert "2 of 5 devices failed: room, operator" in done.stderr
    assert done.stdout.count("nobody answers at") == 2
    assert "camera    ok" in done.stdout
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("rig", "check", "nowhere.yaml"), "error: nowhere.yaml: no such file"),
        (("twin", "up", RIGS / "twin.yaml"), "no driver of this rig has a simulator"),
        (("twin", "door", RIGS / "wire.yaml", "ajar"), "a door is 'open' or 'closed'"),
        (("twin", "fault", RIGS / "wire.yaml", "tracker.tired"), "no fault 'tracker.tired'"),
        (("twin", "fault", RIGS / "wire.yaml", "--clear"), "name the fault that --clear"),
        (("twin", "door", RIGS / "twin.yaml", "open"), "devices.operator.options.world"),
    ],
)
def test_a_mistake_is_one_clear_message(arguments: tuple[object, ...], says: str):
    done = tronlab(*arguments)
    assert done.returncode == 2
    assert says in done.stderr
    assert "Traceback" not in done.stderr


def test_a_mistake_in_an_option_is_told_with_its_line_before_anything_starts(tmp_path: Path):
    rig = variant(
        tmp_path / "rig.yaml",
        tracker={"driver": "leica.tracker", "options": {"host": "127.0.0.1", "prot": 1}},
        operator={"driver": "twin.operator", "options": {"world": "127.0.0.1:99999"}},
    )
    done = tronlab("twin", "up", rig)
    assert done.returncode == 2
    assert f"{rig}:" in done.stderr
    assert "devices.tracker.options.prot: unknown key, did you mean port?" in done.stderr
    assert "devices.operator.options.world" in done.stderr
    assert "expected HOST:PORT" in done.stderr
    assert "python -m" not in done.stderr


def test_the_address_of_the_world_must_be_one(tmp_path: Path):
    rig = variant(
        tmp_path / "rig.yaml",
        room={"driver": "plc.room", "options": {"plc": {"host": "127.0.0.1", "port": 10502}}},
        operator={"driver": "twin.operator", "options": {"world": "here"}},
    )
    done = tronlab("twin", "door", rig, "open")
    assert done.returncode == 2
    assert "devices.operator.options.world: 'here': expected HOST:PORT" in done.stderr


def test_faults_are_listed_with_what_happens():
    done = tronlab("twin", "fault", RIGS / "wire.yaml")
    assert done.returncode == 0, done.stderr
    names = {line.split()[0] for line in done.stdout.splitlines()}
    assert {"tracker.beam_broken", "robot.emergency_stop", "camera.gone", "room.silent"} <= names


def test_twin_up_runs_until_ctrl_c_and_its_state_can_be_changed(tmp_path: Path):
    world, modbus = f"127.0.0.1:{unused_port()}", unused_port()
    rig = variant(
        tmp_path / "rig.yaml",
        room={
            "driver": "plc.room",
            "options": {"plc": {"host": "127.0.0.1", "port": modbus}, "lamp_settle_s": 0},
        },
        operator={"driver": "twin.operator", "options": {"world": world}},
    )
    running = subprocess.Popen(
        [*MAIN, "twin", "up", str(rig)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    try:
        assert running.stdout is not None
        lines = [running.stdout.readline().split() for _ in range(2)]
        assert lines == [["world", world], ["room", "plc", f"127.0.0.1:{modbus}"]]
        assert tronlab("rig", "check", rig).returncode == 0
        done = tronlab("twin", "door", rig, "open")
        assert done.stdout == "the door is open\n", done.stderr
        assert tronlab("twin", "fault", rig, "room.silent").stdout == "room.silent: armed\n"
        failed = tronlab("rig", "check", rig)
        assert failed.returncode == 1
        assert "room      FAILED" in failed.stdout
        cleared = tronlab("twin", "fault", rig, "room.silent", "--clear")
        assert cleared.stdout == "room.silent: cleared\n"
    finally:
        running.send_signal(signal.SIGINT)
        _, stderr = running.communicate(timeout=30)
    assert running.returncode == 0
    assert stderr.splitlines()[-1] == "stopped"
    assert "Traceback" not in stderr
    with socket.socket() as again:
        again.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        again.bind(("127.0.0.1", modbus))


def unused_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
