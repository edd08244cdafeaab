"""Simulators in processes of their own; here small programs take their place."""

import os
import time
from contextlib import closing
from pathlib import Path

import pytest

from tronlab.errors import DeviceError, DeviceTimeoutError, ProtocolError
from tronlab.twin import fleet
from tronlab.twin.fleet import Fleet, Simulator

WELL = """
import json, os, sys, time
from pathlib import Path
Path(__file__).with_suffix(f".{os.getpid()}").touch()
for port in (1, "/dev/pts/9"):
    print(json.dumps({"device": "thing", "host": "127.0.0.1", "port": port}), flush=True)
time.sleep(600)
"""
ECHO = """
import json, sys, time
print(json.dumps({"device": "thing", "host": " ".join(sys.argv[1:]), "port": 1}), flush=True)
time.sleep(600)
"""
BROKEN = "raise SystemExit(3)\n"
MUTE = "import time\ntime.sleep(600)\n"
CHATTY = 'import time\nprint("hello", flush=True)\ntime.sleep(600)\n'
DEAF = "import signal\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\n" + WELL


@pytest.fixture(autouse=True)
def _programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    programs = {
        "well": WELL,
        "echo": ECHO,
        "broken": BROKEN,
        "mute": MUTE,
        "chatty": CHATTY,
        "deaf": DEAF,
    }
    for name, text in programs.items():
        (tmp_path / f"sim_{name}.py").write_text(text)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))


def start(*names: str) -> Fleet:
    modules = {name: f"sim_{name}" for name in names}
    return Fleet(modules, rig_path=Path("rig.yaml"), world=("127.0.0.1", 1))


def running(folder: Path, name: str) -> list[int]:
    ids = [int(path.suffix[1:]) for path in folder.glob(f"sim_{name}.*") if path.suffix != ".py"]
    return [pid for pid in ids if Path(f"/proc/{pid}").exists()]


def test_a_fleet_gives_the_addresses_of_all_and_ends_them(tmp_path: Path):
    with closing(start("well")) as ships:
        assert [str(address) for address in ships.addresses] == ["127.0.0.1:1", "/dev/pts/9"]
        ships.check_alive()
        assert len(running(tmp_path, "well")) == 1
    assert running(tmp_path, "well") == []


def test_each_is_told_the_rig_and_what_is_meant_for_its_kind():
    with closing(
        Fleet(
            {"echo": "sim_echo"},
            rig_path=Path("rig.yaml"),
            world=("127.0.0.1", 1),
            seed=4,
            more_arguments={"echo": ("--faster", "20"), "other": ("--never",)},
        )
    ) as ships:
        expected = "--rig rig.yaml --world 127.0.0.1:1 --seed 4 --session run --faster 20"
        assert [address.host for address in ships.addresses] == [expected]


def test_one_that_does_not_start_ends_all(tmp_path: Path):
    with pytest.raises(DeviceError, match="broken: the simulator has ended with exit code 3"):
        start("well", "broken")
    assert running(tmp_path, "well") == []


def test_one_that_ends_later_is_noticed(tmp_path: Path):
    with closing(start("well")) as ships:
        os.kill(running(tmp_path, "well")[0], 9)
        with pytest.raises(DeviceError, match="well: the simulator has ended"):
            check_for(10.0, ships)


def check_for(duration_s: float, ships: Fleet) -> None:
    give_up = time.monotonic() + duration_s
    while time.monotonic() < give_up:
        ships.check_alive()
        time.sleep(0.01)


def test_one_that_says_nothing_is_not_waited_for_ever():
    simulator = Simulator("mute", "sim_mute", ())
    try:
        with pytest.raises(DeviceTimeoutError, match="mute: the simulator is not ready"):
            simulator.wait_until_ready(0.3)
    finally:
        simulator.close()


def test_one_that_prints_something_else_is_refused():
    with pytest.raises(ProtocolError, match=r"printed no address .*68 65 6c 6c 6f"):
        start("chatty")


def test_one_that_does_not_end_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(fleet, "_END_TIMEOUT_S", 0.2)
    with closing(start("deaf")):
        assert len(running(tmp_path, "deaf")) == 1
    assert running(tmp_path, "deaf") == []
