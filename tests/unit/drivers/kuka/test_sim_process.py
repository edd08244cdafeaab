"""The simulated robot as a process of its own."""

import json
import select
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

from ruamel.yaml import YAML

TWIN_YAML = Path(__file__).parents[4] / "campaigns" / "rigs" / "twin.yaml"
EKI = ["robot eki command", "robot eki state"]


@contextmanager
def running(*arguments: str):
    process = subprocess.Popen(
        [sys.executable, "-m", "drivers.kuka.simulator", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,  # so that what select sees is all there is
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
        try:
            process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise


def announced(process, n: int) -> dict[str, tuple[str, int]]:
    addresses = {}
    for _ in range(n):
        readable, _, _ = select.select([process.stdout], [], [], 60.0)
        assert readable, "the simulator says nothing"
        line = process.stdout.readline()
        assert line, process.stderr.read().decode()
        said = json.loads(line)
        addresses[said["device"]] = (said["host"], said["port"])
    return addresses


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


def ask(address, name: str) -> bytes:
    from py_openshowvar import openshowvar

    client = openshowvar(*address)
    try:
        return client.read(name, debug=False)
    finally:
        client.close()


def test_alone_it_serves_everything_and_ends_cleanly():
    with running("--port", "0", "--state-port", "0", "--kvp-port", "0") as process:
        addresses = announced(process, 3)
        assert list(addresses) == [*EKI, "robot kvp"]
        assert ask(addresses["robot kvp"], "$MODE_OP") == b"#AUT"
        with socket.create_connection(addresses["robot eki state"], timeout=10.0) as states:
            assert states.recv(10) == b"<RobotStat"
    assert process.returncode == 0


def test_port_is_that_of_the_only_server_and_faults_are_armed():
    arguments = ["--protocol", "kvp", "--port", "0", "--fault", "robot.guard_open"]
    with running(*arguments) as process:
        addresses = announced(process, 1)
        assert ask(addresses["robot kvp"], "$USER_SAF") == b"FALSE"


def rig_with(tmp_path: Path, protocol: dict[str, object], **options: object) -> Path:
    yaml = YAML()
    rig = yaml.load(TWIN_YAML)
    rig["devices"]["robot"] = {
        "driver": "kuka.robot",
        "options": {"host": "127.0.0.1", "protocol": protocol, "rail_range_m": [0.0, 4.4]}
        | options,
    }
    path = tmp_path / "rig.yaml"
    yaml.dump(rig, path)
    return path


def test_with_a_rig_it_listens_where_the_driver_dials(tmp_path):
    ports = free_port(), free_port()
    protocol = {"kind": "eki", "command_port": ports[0], "state_port": ports[1]}
    with running("--rig", str(rig_with(tmp_path, protocol))) as process:
        addresses = announced(process, 2)
        assert list(addresses) == EKI
        assert [port for _, port in addresses.values()] == list(ports)


def test_with_a_rig_the_robot_is_the_one_of_its_world(tmp_path):
    port = free_port()
    rig = rig_with(tmp_path, {"kind": "kvp", "port": port}, rail_zero_mm=250.0)
    with running("--rig", str(rig)) as process:
        assert announced(process, 1) == {"robot kvp": ("127.0.0.1", port)}
        address = ("127.0.0.1", port)
        assert ask(address, "$AXIS_ACT.E1") == b"250.0"
        assert ask(address, "$SOFTN_END[7]") == b"200.0"
        assert ask(address, "$KR_SERIALNO").isdigit()


def test_wrong_option_of_the_rig_is_one_clear_line(tmp_path):
    rig = rig_with(tmp_path, {"kind": "kvp", "port": 7000}, colour="orange")
    process = subprocess.run(
        [sys.executable, "-m", "drivers.kuka.simulator", "--rig", str(rig)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert process.returncode == 2
    assert "colour" in process.stderr
    assert "Traceback" not in process.stderr
