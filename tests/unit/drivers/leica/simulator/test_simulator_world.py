"""The simulated tracker as a view of the simulated laboratory, in this process and in its own."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from drivers.leica.simulator.__main__ import main
from drivers.leica.simulator.scene import SCATTER_M, SCATTER_RAD, WorldScene
from tronlab.campaign.rig import load_rig
from tronlab.devices.accuracy import StatedAccuracy
from tronlab.devices.clock import WallClock
from tronlab.devices.readings import RobotTarget
from tronlab.geometry.uncertainty import pose_difference
from tronlab.twin.instruments import TrackerOptics, noise_of
from tronlab.twin.server import StateServer
from tronlab.twin.world import World

ROOT = Path(__file__).parents[5]
TWIN_YAML = ROOT / "campaigns" / "rigs" / "twin.yaml"
TRACKER = "tracker: {driver: twin.tracker}"
WIRE_TRACKER = (
    "tracker: {driver: leica.tracker, options: {host: 127.0.0.1, port: 7007,"
    " reflectors: {}, tmac: {p_trk_m: [1, 2, 3]}}}"
)
FAULTS = "  faults: []"
SCRIPT = "  faults: [{device: tracker, call: measure_pose, at: 2, error: tracking_lost}]"
LOOSE_M = 4e-4
"""Well above the noise, 15 um + 6 um/m, and well below any mistake."""


@pytest.fixture
def wire_yaml(tmp_path: Path) -> Path:
    text = TWIN_YAML.read_text()
    assert TRACKER in text
    assert FAULTS in text
    path = tmp_path / "wire.yaml"
    path.write_text(text.replace(TRACKER, WIRE_TRACKER).replace(FAULTS, SCRIPT))
    return path


@pytest.fixture
def world(wire_yaml: Path) -> World:
    return World(load_rig(wire_yaml).world_setup(), clock=WallClock())


def noise() -> np.random.Generator:
    return noise_of("tracker", seed=5, session="run")


def test_points_and_poses_are_those_of_the_world(make_rig, world):
    rig = make_rig(scene=WorldScene(world, noise()))
    client = rig.client
    client.prepare()
    for name, p_m in rig.scene.reflectors.items():
        client.do(58, "3d", *p_m)
        seen = client.measure(types=(2,)).floats(20)
        assert seen == pytest.approx(p_m, abs=LOOSE_M), name
    client.do(24, "I", 6)
    client.do(58, "3d", *rig.scene.trk_from_tmac.translation)
    first = client.measure(types=(4,)).floats(48)
    assert first == pytest.approx(rig.scene.trk_from_tmac.translation, abs=LOOSE_M)
    at = world.robot_at
    moved = RobotTarget(at.rail_m + 0.4, RigidTransform.identity() * at.base_from_flange)
    world.stand_robot(moved, actual=moved)
    client.do(49)
    assert client.receive_error().status == 701
    client.do(58, "3d", *rig.scene.trk_from_tmac.translation)
    second = client.measure(types=(4,)).floats(48)
    assert np.linalg.norm(second - first) == pytest.approx(0.4, abs=LOOSE_M)


def test_noise_is_the_stream_of_the_twin_in_one_process(make_rig, world):
    """One draw a measurement, and none for pointing or looking; but for the small scatter."""
    rig = make_rig(scene=WorldScene(world, noise()))
    twin = TrackerOptics(world, noise())
    client = rig.client
    client.prepare()
    for name in ("top_left", "lamp"):
        client.do(58, "3d", *rig.scene.reflectors[name])
        seen = client.measure(types=(2,)).floats(20)
        assert seen == pytest.approx(twin.point(name).p_trk_m, abs=5 * SCATTER_M)
    client.do(24, "I", 6)
    client.do(58, "3d", *rig.scene.trk_from_tmac.translation)
    packet = client.measure(types=(4,))
    expected = twin.pose().trk_from_tmac
    x, y, z, w = expected.rotation.as_quat()
    assert packet.floats(48) == pytest.approx(expected.translation, abs=5 * SCATTER_M)
    assert packet.floats(184, 4) == pytest.approx([w, x, y, z], abs=5 * SCATTER_RAD)


def test_what_the_tracker_reports_and_its_stated_accuracy_make_its_error(world):
    """It reports the scatter only; chi-square of 50 readings of a point and 50 of a pose."""
    scene = WorldScene(world, noise())
    accuracy = StatedAccuracy()
    p_true, pose_true = scene.reflectors["lamp"], scene.trk_from_tmac
    misfit = 0.0
    for _ in range(50):
        point, pose = scene.point("lamp"), scene.pose()
        np.testing.assert_allclose(np.sqrt(np.diag(point.covariance_m2)), SCATTER_M)
        covariance = point.covariance_m2 + accuracy.point_covariance(p_true)
        misfit += chi_square(point.p_trk_m - p_true, covariance)
        covariance = pose.covariance + accuracy.pose_covariance(pose_true.translation)
        misfit += chi_square(pose_difference(pose_true, pose.trk_from_tmac), covariance)
    low, high = chi2.ppf([0.005, 0.995], 50 * 9)
    assert low < misfit < high


def chi_square(error, covariance) -> float:
    return float(error @ np.linalg.solve(covariance, error))


def test_serial_is_that_of_the_laboratory(make_rig, world):
    rig = make_rig(scene=WorldScene(world, noise()))
    assert rig.client.do(132).at(84, "i") == int(world.serial)


@pytest.fixture
def run():
    """Start simulators; each is ended."""
    processes = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "drivers.leica.simulator", *arguments]
        processes.append(
            subprocess.Popen(
                command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
            )
        )
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def announced(process: subprocess.Popen[str]) -> dict:
    return json.loads(process.stdout.readline())


def test_alone_it_announces_itself_serves_and_stops(run, new_client):
    process = run("--port", "0", "--initialize-s", "0.01", "--fault", "tracker.busy:1")
    line = announced(process)
    assert line["device"] == "tracker"
    with new_client((line["host"], line["port"])) as client:
        assert client.ask(7).status == 1
        client.prepare()
        client.do(58, "3d", 1.0, 3.5, 1.9)
        seen = client.measure(types=(2,)).floats(20)
        assert seen == pytest.approx([1.0, 3.5, 1.9], abs=1e-4)
    process.terminate()
    _, errors = process.communicate(timeout=30)
    assert (process.returncode, errors) == (0, "")


def test_with_a_rig_it_shows_the_world_it_shares(run, new_client, wire_yaml, world):
    """The robot moves and a beam is broken in this process; the tracker is in another."""
    states = StateServer(world.state)
    try:
        host, port = states.address
        shared = run("--rig", str(wire_yaml), "--world", f"{host}:{port}", "--port", "0")
        line = announced(shared)
        with new_client((line["host"], line["port"])) as client:
            client.prepare(mode=6)
            moved = RobotTarget(world.robot_at.rail_m + 0.3, world.robot_at.base_from_flange)
            world.stand_robot(moved, actual=moved)
            p_m = WorldScene(world, noise()).trk_from_tmac.translation
            client.do(58, "3d", *p_m)
            assert client.measure(types=(4,)).floats(48) == pytest.approx(p_m, abs=LOOSE_M)
            world.state.arm("tracker.beam_broken")
            assert client.receive_error().status == 701
    finally:
        states.close()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--fault", "tracker.nonsense"), "no fault 'tracker.nonsense'"),
        (("--rig", "wire.yaml"), "port"),
        (("--host", "192.0.2.1"), "cannot listen at 192.0.2.1:10700"),
    ],
)
def test_mistakes_end_it_with_one_line(monkeypatch, capsys, wire_yaml, arguments, expected):
    wire_yaml.write_text(wire_yaml.read_text().replace("port: 7007", "port: 70070"))
    monkeypatch.chdir(wire_yaml.parent)
    monkeypatch.setattr(sys, "argv", ["simulator", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    output, errors = capsys.readouterr()
    assert ended.value.code == 2
    assert output == ""
    assert errors.startswith("error: ")
    assert expected in errors
