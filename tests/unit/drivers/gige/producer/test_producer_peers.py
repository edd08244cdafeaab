"""The producer under harvesters, with cameras that others wrote; each side in its own process."""

import hashlib
import json
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from drivers.gige.producer import producer_path, why_missing

HERE = Path(__file__).parent
MONO12_BYTES = 640 * 480 * 2

Start = Callable[..., "Child"]


class Child:
    """A process that prints lines of JSON."""

    def __init__(self, command: list[str], environment: dict[str, str]) -> None:
        self.process = subprocess.Popen(
            command,
            env=os.environ | environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def read(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, self.process.communicate()[1]
        return json.loads(line)

    def say(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def read_to_the_end(self) -> list[dict[str, Any]]:
        out, errors = self.process.communicate(timeout=60)
        assert self.process.returncode == 0, out + errors
        return [json.loads(line) for line in out.splitlines()]

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()


@pytest.fixture
def start() -> Iterator[Start]:
    with ExitStack() as stack:

        def start(*command: str, **environment: str) -> Child:
            child = Child([*command], environment)
            stack.callback(child.end)
            return child

        yield start


@pytest.fixture
def host(start: Start) -> Start:
    """Start ``harvesters_host.py`` on a camera's address."""
    pytest.importorskip("harvesters")
    path = producer_path()
    if path is None:
        pytest.skip(why_missing())

    def host(address: str, *arguments: str, before: Sequence[str] = ()) -> Child:
        command = [sys.executable, str(HERE / "harvesters_host.py"), str(path), *arguments]
        return start(*before, *command, TRONLAB_GEV_INTERFACES=address)

    return host


@pytest.fixture
def viva(start: Start) -> Callable[..., tuple[Child, str]]:
    """Start viva-genicam's camera at an address of its own."""
    pytest.importorskip("viva_genicam")

    def viva(dropped: list[tuple[int, int]] | None = None) -> tuple[Child, str]:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        script = str(HERE / "viva_camera.py")
        camera = start(sys.executable, script, "127.0.0.1", str(port), json.dumps(dropped or []))
        assert camera.read() == {"ready": True}
        return camera, f"127.0.0.1:{port}"

    return viva


def viva_image(block_id: int) -> bytes:
    """What viva-genicam's camera fills its 16-bit images with."""
    period = bytes((block_id + 7 * i) % 256 for i in range(256))
    return period * (MONO12_BYTES // 256)


def test_frames_of_viva_s_camera_are_exact(host: Start, viva: Any) -> None:
    _, address = viva()
    devices, *frames, counts, done = host(address, "stream", "60").read_to_the_end()
    assert devices == {"devices": [["viva-genicam", "FakeGigE", "FAKE-001"]]}
    assert done == {"done": True}
    assert counts["address"] == 0x7F000001
    assert counts["delivered"] >= len(frames) == 60
    assert counts["lost"] == counts["incomplete"] == 0
    ids = [frame["id"] for frame in frames]
    assert ids == list(range(ids[0], ids[0] + 60))
    ticks = [frame["ticks"] for frame in frames]
    assert ticks == sorted(set(ticks))
    for frame in frames:
        assert (frame["width"], frame["height"], frame["format"]) == (640, 480, "Mono12")
        assert frame["sha256"] == hashlib.sha256(viva_image(frame["id"])).hexdigest()


def test_packets_that_viva_s_camera_drops_are_sent_again(host: Start, viva: Any) -> None:
    """Leader, payload, a run of payload, the whole payload's last and the trailer."""
    n_packets = -(-MONO12_BYTES // (8228 - 36))
    dropped = [(2, 0), (3, 5), (4, 7), (4, 8), (4, 9), (5, n_packets), (6, n_packets + 1)]
    _, address = viva(dropped)
    _, *frames, counts, _ = host(address, "stream", "10").read_to_the_end()
    assert [frame["id"] for frame in frames] == list(range(1, 11))
    assert counts["requested"] >= len(dropped)
    assert counts["incomplete"] == counts["lost"] == 0
    for frame in frames:
        assert frame["sha256"] == hashlib.sha256(viva_image(frame["id"])).hexdigest()


def test_viva_s_camera_is_held_by_one_host_at_a_time(host: Start, viva: Any) -> None:
    camera, address = viva()
    first = host(address, "hold")
    assert first.read()["devices"]
    assert first.read() == {"held": True}
    second = host(address, "hold").read_to_the_end()
    assert {"error": "AccessDeniedException"} in second
    camera.say("who?")
    assert camera.read()["controller"] is not None
    first.say("enough")
    assert first.read_to_the_end() == [{"done": True}]
    camera.say("who?")
    assert camera.read()["controller"] is None
    third = host(address, "hold")
    assert third.read()["devices"]
    assert third.read() == {"held": True}


def test_control_that_viva_s_camera_takes_away_is_a_loss_and_can_be_had_again(
    host: Start, viva: Any
) -> None:
    camera, address = viva()
    consumer = host(address, "lose")
    while "streams" not in consumer.read():
        pass
    camera.say("revoke")
    told = consumer.read_to_the_end()
    errors = [line for line in told if "error" in line]
    assert [error["error"] for error in errors] == ["IoException"]
    assert "the camera was lost" in errors[0]["text"]
    assert told[-1] == {"done": True}
    assert "sha256" in told[-2]  # a frame, after the camera was opened again


@pytest.fixture
def own_network() -> Callable[..., list[str]]:
    """The command that runs another one beside a camera, in a network of their own."""
    for isolate in (["unshare", "-n"], ["unshare", "-rn"]):
        probe = [*isolate, "ip", "link", "add", "cam0", "type", "veth", "peer", "name", "cam1"]
        if subprocess.run(probe, capture_output=True, check=False).returncode == 0:
            script = [*isolate, sys.executable, str(HERE / "own_network.py")]
            return lambda *camera: [*script, json.dumps(camera)]
    pytest.skip("`unshare -n` and `ip link add` are not allowed here")


def test_a_camera_on_a_named_interface_is_found_by_that_interface_s_broadcast(
    host: Start, own_network: Callable[..., list[str]]
) -> None:
    pytest.importorskip("viva_genicam")
    everywhere = "0.0.0.0"  # noqa: S104 - of its own network
    camera = (sys.executable, str(HERE / "viva_camera.py"), everywhere, "3956", "[]")
    consumer = host("cam0", "stream", "3", before=own_network(*camera))
    devices, *frames, counts, _ = consumer.read_to_the_end()
    assert devices == {"devices": [["viva-genicam", "FakeGigE", "FAKE-001"]]}
    assert counts["address"] == 0x0A090001
    for frame in frames:
        assert frame["sha256"] == hashlib.sha256(viva_image(frame["id"])).hexdigest()


def test_frames_of_aravis_camera(host: Start, own_network: Callable[..., list[str]]) -> None:
    aravis = "arv-fake-gv-camera-0.8"
    if shutil.which(aravis) is None:
        pytest.skip(f"{aravis} is not installed (Debian: aravis-tools)")
    consumer = host("lo", "stream", "40", before=own_network(aravis, "-i", "127.0.0.1"))
    devices, *frames, counts, _ = consumer.read_to_the_end()
    assert devices["devices"][0][:2] == ["Aravis", "Fake"]
    ids = [frame["id"] for frame in frames]
    assert ids == list(range(ids[0], ids[0] + 40))
    assert counts["lost"] == counts["incomplete"] == 0
    assert {(frame["width"], frame["height"]) for frame in frames} == {(512, 512)}
    assert len({frame["sha256"] for frame in frames}) > 1
