"""The simulated camera held against hosts that others wrote: viva-genicam and Debian's aravis."""

import importlib.util
import json
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

VIVA_HOST = Path(__file__).with_name("viva_host.py")
ARAVIS_HOST = Path(__file__).with_name("aravis_host.py")
ARAVIS = "arv-camera-test-0.8"
GVCP_PORT = 3956
PATIENCE_S = 120


def own_network() -> list[str]:
    """Give the command that gives a process a network of its own; none if that is not allowed."""
    for command in (["unshare", "-n"], ["unshare", "-rn"]):
        if shutil.which("unshare") is None:
            break
        if subprocess.run([*command, "true"], capture_output=True, check=False).returncode == 0:
            return command
    return []


def is_standard_port_free() -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", GVCP_PORT))
        except OSError:
            return False
        return True


@pytest.fixture(scope="module")
def isolated() -> list[str]:
    """Prefix of a command whose 127.0.0.1:3956 nobody else uses."""
    command = own_network()
    if not command and not is_standard_port_free():
        pytest.skip(f"UDP port {GVCP_PORT} is in use, and `unshare -n` is not allowed here")
    return command


@pytest.fixture(scope="module")
def viva(isolated: list[str]) -> dict[str, Any]:
    """What viva-genicam's host saw of the camera."""
    if importlib.util.find_spec("viva_genicam") is None:
        pytest.skip("needs the package viva-genicam (only for x86-64)")
    return json.loads(run_host(isolated, VIVA_HOST))


def run_host(isolated: list[str], script: Path, *arguments: str) -> str:
    """Give what a host printed."""
    options = ["--own-network"] if isolated else []
    done = subprocess.run(
        [*isolated, sys.executable, str(script), *arguments, *options],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_viva_discovers_and_understands_the_camera(viva):
    assert viva["maker"] == "Allied Vision Technologies"
    assert viva["model"] == "GC1380H (02-2142A)"
    assert viva["serial"] == "02-2142A-06001"
    assert viva["skipped"] == []


def test_viva_sets_features_and_is_refused_what_cannot_be(viva):
    assert (viva["exposure"], viva["gain"]) == (1500, 12)
    assert viva["payload"] == 640 * 480
    assert viva["too long"]
    assert viva["not simulated"]


def test_viva_is_refused_while_another_host_controls(viva):
    assert "denied" in viva["second host"].lower()


@pytest.mark.parametrize("key", ["Mono8", "Mono12", "Mono12Packed", "full"])
def test_viva_receives_every_bit(viva, key):
    assert viva[key] == 10


def test_viva_mends_losses_by_resend(viva):
    assert viva["losses"]["exact"] == 10
    assert viva["losses"]["lost"] > 10
    assert viva["losses"]["recovered"] > 10


def test_viva_ignores_garbage(viva):
    assert viva["garbage"]["exact"] == 10
    assert viva["garbage"]["ignored"] > 10


def test_viva_gets_one_frame_for_each_software_trigger(viva):
    assert viva["triggered"] == [1, 2, 3]


def test_viva_waits_for_a_slow_command(viva):
    assert viva["slow"]


def test_viva_relates_the_clocks(viva):
    assert viva["clock error s"] < 1.0


@pytest.fixture(scope="module")
def aravis(isolated: list[str]) -> dict[str, int]:
    """What Debian's aravis counted in a few seconds of a camera that loses packets."""
    if shutil.which(ARAVIS) is None:
        pytest.skip(f"needs {ARAVIS}, of Debian's package aravis-tools")
    done = run_host(isolated, ARAVIS_HOST, ARAVIS)
    counts = {name: int(n) for name, n in re.findall(r"(\w[\w ]*\w)\s*= (\d+)", done)}
    assert counts, done
    return counts


def test_aravis_finds_the_largest_packet_by_test_packets(aravis):
    assert aravis["gv packet size"] >= 8200
    assert aravis["n_received_packets"] / aravis["n_completed_buffers"] < 200  # 172 of 8228 bytes


def test_aravis_mends_losses_by_resend(aravis):
    assert aravis["n_completed_buffers"] >= 20
    assert aravis["n_resent_packets"] > 10
    assert aravis["n_error_packets"] == 0
