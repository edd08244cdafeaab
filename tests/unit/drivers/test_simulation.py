"""What the simulators on the wire have in common: command line, faults, ready line, life, death."""

import json
import os
import re
import signal
import subprocess
import sys
from argparse import ArgumentParser
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from drivers.simulation import LOOPBACK, Simulation, announce, fail, start
from tronlab.campaign.rig import load_rig
from tronlab.devices.clock import WallClock
from tronlab.errors import ConfigError
from tronlab.twin.instruments import noise_of
from tronlab.twin.server import StateServer
from tronlab.twin.state import LocalState
from tronlab.twin.world import initial_state

RIGS = Path(__file__).parents[3] / "campaigns" / "rigs"
FAULTS = {"tracker.deaf": "hears nothing", "tracker.dumb": "says nothing"}
TIMEOUT_S = 60

READY = """
from drivers.simulation import announce, start, wait_until_stopped
simulation = start("tracker", faults={"tracker.deaf": "hears nothing"})
try:
    announce("tracker", *simulation.address("127.0.0.1", 10700))
    wait_until_stopped()
finally:
    print("closed", flush=True)
"""
"""A simulator that is ready at once."""

STARTING = """
import time
from drivers.simulation import start
start("tracker", faults={})
try:
    print("starting", flush=True)
    time.sleep(600)
finally:
    print("closed", flush=True)
"""
"""One that is not ready yet."""

SLOWER_THAN_ITS_PARENT = """
import os, time
from drivers.simulation import start, wait_until_stopped
parent = os.getppid()
start("tracker", faults={})
print("starting", flush=True)
while os.getppid() == parent:
    time.sleep(0.01)
wait_until_stopped()
print("closed", flush=True)
"""
"""One whose parent is gone before it is ready."""

PARENT = "import subprocess, sys; subprocess.run([sys.executable, '-c', sys.argv[1]])"


@pytest.fixture(autouse=True)
def _signals() -> Iterator[None]:
    """Take back what ``start`` does about signals."""
    before = {kind: signal.getsignal(kind) for kind in (signal.SIGINT, signal.SIGTERM)}
    yield
    for kind, handler in before.items():
        signal.signal(kind, handler)


def started(*arguments: object) -> Simulation:
    return start("tracker", faults=FAULTS, argv=[str(argument) for argument in arguments])


def refusal(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Start with a mistake, and give what stderr says of it."""
    with pytest.raises(SystemExit) as end:
        started(*arguments)
    assert end.value.code == 2
    said = capsys.readouterr()
    assert said.out == ""
    return said.err


@pytest.fixture
def served() -> Iterator[tuple[LocalState, str]]:
    """The state of the wire rig's laboratory, and where it is served."""
    setup = load_rig(RIGS / "wire.yaml").world_setup()
    assert setup is not None
    state = LocalState(initial_state(setup))
    server = StateServer(state)
    host, port = server.address
    yield state, f"{host}:{port}"
    server.close()


def test_alone_it_has_no_world_no_options_and_no_faults():
    simulation = started()
    assert simulation.world is None
    assert simulation.context.name == "tracker"
    assert simulation.context.options == {}
    assert not any(simulation.faults.is_armed(name) for name in FAULTS)


def test_it_listens_as_the_command_line_says_else_as_its_caller():
    assert started().address(LOOPBACK, 700) == (LOOPBACK, 700)
    assert started("--port", 0).address(LOOPBACK, 700) == (LOOPBACK, 0)
    assert started("--host", "127.0.0.2").address(LOOPBACK, 700) == ("127.0.0.2", 700)


def test_its_noise_is_that_of_the_device_in_one_process():
    noise = started("--seed", 5, "--session", "calibrate").noise
    expected = noise_of("tracker", seed=5, session="calibrate")
    assert noise.standard_normal(4).tolist() == expected.standard_normal(4).tolist()


def test_arguments_of_one_simulator_only():
    def add(parser: ArgumentParser) -> None:
        parser.add_argument("--colour")

    simulation = start("tracker", faults={}, add_arguments=add, argv=["--colour", "red"])
    assert simulation.arguments.colour == "red"


def test_a_fault_lasts_or_strikes_so_often():
    faults = started("--fault", "tracker.deaf", "--fault", "tracker.dumb:2").faults
    assert all(faults.strike("tracker.deaf") for _ in range(10))
    assert [faults.strike("tracker.dumb") for _ in range(3)] == [True, True, False]


def test_help_lists_every_fault(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as end:
        started("--help")
    assert end.value.code == 0
    text = capsys.readouterr().out
    assert all(re.search(rf"{name} +{what}", text) for name, what in FAULTS.items())


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--fault", "tracker.tired"), "no fault 'tracker.tired'; faults: tracker.deaf, "),
        (("--fault", "tracker.deaf:often"), "'often' is no number of times"),
        (("--fault", "tracker.deaf:0"), "'0' is no number of times"),
        (("--fault", "tracker.deaf:"), "'' is no number of times"),
        (("--port", 65536), "argument --port: '65536' is no whole number from 0 to 65535"),
        (("--port", -1), "argument --port: '-1' is no whole number"),
        (("--seed", "x"), "argument --seed: 'x' is no whole number"),
        (("--world", "127.0.0.1:10600"), "--world needs --rig"),
        (("--rig", "nowhere.yaml"), "error: nowhere.yaml: no such file"),
        (("--rig", RIGS / "wire.yaml", "--world", "here"), "--world here: expected HOST:PORT"),
    ],
)
def test_a_mistake_is_one_clear_error(
    capsys: pytest.CaptureFixture[str], arguments: tuple[object, ...], says: str
):
    assert says in refusal(capsys, *arguments)


def test_a_rig_of_hardware_has_nothing_to_simulate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    text = (RIGS / "twin.yaml").read_text(encoding="utf-8")
    path = tmp_path / "rig.yaml"
    path.write_text(text[: text.index("\nworld:")], encoding="utf-8")
    assert f"{path}: world: a simulator needs this section" in refusal(capsys, "--rig", path)


def test_with_a_rig_it_is_what_the_driver_on_the_other_side_expects():
    simulation = started("--rig", RIGS / "wire.yaml", "--fault", "tracker.deaf")
    assert simulation.world is not None
    assert isinstance(simulation.world.clock, WallClock)
    assert simulation.context.options["port"] == 10700
    assert simulation.context.base_dir == RIGS
    assert simulation.faults.is_armed("tracker.deaf")
    assert not simulation.world.truth.is_lamp_on


def test_simulators_of_one_world_share_state_and_faults(served: tuple[LocalState, str]):
    state, address = served
    simulation = started(
        "--rig", RIGS / "wire.yaml", "--world", address, "--fault", "tracker.dumb:1"
    )
    assert simulation.world is not None
    state.change(lamp_level=1.0)
    assert simulation.world.truth.is_lamp_on
    assert state.strike("tracker.dumb")
    assert not simulation.faults.is_armed("tracker.dumb")
    simulation.world.state.close()


def test_a_world_that_nobody_serves_is_told_at_the_start(
    served: tuple[LocalState, str], capsys: pytest.CaptureFixture[str]
):
    _, address = served
    unused = StateServer(LocalState(served[0].read()))
    unused.close()
    host, port = unused.address
    assert address != f"{host}:{port}"
    said = refusal(capsys, "--rig", RIGS / "wire.yaml", "--world", f"{host}:{port}")
    assert said.startswith(f"error: simulated world: nobody answers at {host}:{port}")


def test_a_failure_is_one_line(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as end:
        fail(ConfigError("no such colour", key="colour"))
    assert end.value.code == 2
    assert capsys.readouterr().err == "error: colour: no such colour\n"


@pytest.mark.parametrize("port", [10700, "/dev/pts/7"])
def test_the_ready_line_is_json(capsys: pytest.CaptureFixture[str], port: int | str):
    announce("tracker", LOOPBACK, port)
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line) == {"device": "tracker", "host": LOOPBACK, "port": port}


@contextmanager
def running(*arguments: str) -> Iterator["subprocess.Popen[str]"]:
    """Run Python; what the test has not ended of it and its children is ended by force."""
    process = subprocess.Popen(
        [sys.executable, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):  # all of them have ended
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate(timeout=TIMEOUT_S)


def first_line(process: "subprocess.Popen[str]") -> str:
    assert process.stdout is not None
    return process.stdout.readline()


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("program", [READY, STARTING])
def test_told_to_stop_it_ends_cleanly(kind: signal.Signals, program: str):
    with running("-c", program) as process:
        assert first_line(process)
        process.send_signal(kind)
        out, err = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, out, err) == (0, "closed\n", "")


@pytest.mark.parametrize("program", [READY, SLOWER_THAN_ITS_PARENT])
def test_it_ends_when_the_process_that_started_it_is_gone(program: str):
    with running("-c", PARENT, program) as parent:
        assert first_line(parent)
        parent.kill()
        out, err = parent.communicate(timeout=TIMEOUT_S)  # both ends are the simulator's now
    assert (out, err) == ("closed\n", "")
