"""The simulator as a process: alone, and as a view of a simulated laboratory."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.gige.simulator.__main__ import main
from drivers.gige.simulator.scene import pattern
from tronlab.campaign.rig import load_rig
from tronlab.twin.instruments import CameraOptics, noise_of
from tronlab.twin.server import StateServer
from tronlab.twin.state import LocalState
from tronlab.twin.world import World, initial_state

TWIN_YAML = Path(__file__).parents[5] / "campaigns" / "rigs" / "twin.yaml"
MONO12 = 0x01100005
CCP = 0xA00
LOCAL_PROBLEM = 0x8008

Start = Callable[..., SimpleNamespace]


@pytest.fixture
def process() -> Iterator[Start]:
    """Start the simulator; gives the address it announced."""
    with ExitStack() as stack:

        def start(*arguments: str) -> SimpleNamespace:
            simulator = subprocess.Popen(
                [sys.executable, "-m", "drivers.gige.simulator", *arguments],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )

            def end() -> None:
                simulator.terminate()
                simulator.communicate(timeout=30)
                assert simulator.returncode == 0

            stack.callback(end)
            ready = json.loads(simulator.stdout.readline())
            assert ready["device"] == "camera"
            return SimpleNamespace(address=(ready["host"], ready["port"]))

        yield start


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig file: the twin's with a camera on the wire, a coarse sensor and a coarse terrain."""
    text = TWIN_YAML.read_text()
    for old, new in (
        ("camera: {driver: twin.camera}", "camera: {driver: gige.camera, options: OPTIONS}"),
        ("OPTIONS", "{address: '127.0.0.1:3956'}"),
        ("sensor_width_px: 1360", "sensor_width_px: 85"),
        ("sensor_height_px: 1024", "sensor_height_px: 64"),
        ("left_px: 168", "left_px: 10"),
        ("    width_px: 1024", "    width_px: 64"),
        ("    height_px: 1024", "    height_px: 60"),
        ("pixel_pitch_m: 6.45e-6", "pixel_pitch_m: 1.032e-4"),
        ("spacing_m: 0.0005", "spacing_m: 0.01"),
        ("principal_point_sigma_px: 8.0", "principal_point_sigma_px: 0.5"),
        ("faults: []", "faults: FAULTS"),
        ("FAULTS", "[{device: camera, call: grab, at: 3, error: fault}]"),
    ):
        assert old in text, old
        text = text.replace(old, new)
    path = tmp_path_factory.mktemp("rig") / "coarse.yaml"
    path.write_text(text)
    return path


def test_alone_it_shows_the_pattern(process, hosts, streams, triggered):
    stream = triggered(streams(hosts(process("--port", "0", "--first-block", "9")).take_control()))
    stream.host.set(AcquisitionStart=1, TriggerSoftware=1)
    frame = stream.frame()
    assert frame.block_id == 9
    image = np.frombuffer(frame.data, np.uint8).reshape(48, 64)
    np.testing.assert_array_equal(image, pattern(9, 64, 48, "Mono8"))


def test_faults_are_armed_on_the_command_line(process, hosts):
    host = hosts(process("--port", "0", "--fault", "camera.held:1"))
    assert host.try_write(0xA00, 2) == 0x8006


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--fault", "camera.explodes"], "no fault 'camera.explodes'"),
        (["--host", "203.0.113.7", "--port", "0"], "cannot listen at 203.0.113.7:0"),
        (["--host", "localhost", "--port", "0"], "'localhost': a camera has one IPv4 address"),
        (["--host", "0.0.0.0"], "'0.0.0.0': a camera has one IPv4 address"),  # noqa: S104
        (["--first-block", "0"], "invalid choice"),
    ],
)
def test_a_mistake_is_told_in_a_line(arguments, message, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["simulator", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert message in capsys.readouterr().err


def ask_until(host, *, is_answered: bool) -> None:
    """Ask until the camera answers, or does not: it may hear late what is armed elsewhere."""
    for _ in range(100):
        host.send(0x80, CCP.to_bytes(4))
        try:
            host.receive(timeout_s=0.3)
        except TimeoutError:
            if not is_answered:
                return
        else:
            if is_answered:
                return
    pytest.fail(f"after 100 commands the camera still {'is silent' if is_answered else 'answers'}")


def test_with_a_rig_it_sees_what_the_twin_sees(process, hosts, streams, triggered, rig):
    setup = load_rig(rig).world_setup()
    state = LocalState(initial_state(setup))
    state.change(lamp_level=1.0)
    server = StateServer(state)
    try:
        camera = process(
            "--rig", str(rig), "--port", "0", "--world", "{}:{}".format(*server.address)
        )
        host = hosts(camera).take_control()
        assert (host.get("SensorWidth"), host.get("SensorHeight")) == (85, 64)
        serial = host.read_memory(0xD8, 16)[1].rstrip(b"\0").decode()
        world = World(setup, state=state)
        assert serial == world.serial
        stream = triggered(streams(host))
        host.set(Width=64, Height=60, OffsetX=10, ExposureTimeAbs=20_000, PixelFormat=MONO12)
        host.set(AcquisitionStart=1, TriggerSoftware=1)
        frame = stream.frame()
        twin = CameraOptics(world, noise_of("camera", seed=0, session="run"))
        for _ in range(2):
            image = np.frombuffer(frame.data, "<u2").reshape(60, 64)
            expected = twin.image(exposure_s=0.02, gain_db=0.0, pixel_format="Mono12")
            np.testing.assert_array_equal(image, expected)
            assert image.std() > 100
            state.change(lamp_level=0.5)
            if frame.block_id == 1:
                host.set(TriggerSoftware=1)
                frame = stream.frame()
        assert host.try_set("TriggerSoftware", 1) == LOCAL_PROBLEM  # as the rig's script says
        state.arm("camera.silent")
        ask_until(host, is_answered=False)
        state.arm("camera.silent", times=0)
        ask_until(host, is_answered=True)
    finally:
        server.close()
