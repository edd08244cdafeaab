"""The driver through our own producer against our simulated camera, over loopback."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass

import numpy as np
import pytest

pytest.importorskip("harvesters", reason="needs the extra 'lab'")

from drivers.gige.driver import open_camera
from drivers.gige.producer import producer_path, why_missing
from drivers.gige.simulator.scene import pattern
from tronlab.devices.readings import Frame
from tronlab.devices.registry import DeviceContext
from tronlab.errors import (
    AccessDeniedError,
    DeviceTimeoutError,
    IncompleteFrameError,
    LimitError,
    NotConnectedError,
)

pytestmark = pytest.mark.skipif(
    producer_path() is None, reason=f"needs our own GenTL producer: {why_missing()}"
)

SMALL = {"left_px": 16, "top_px": 8, "width_px": 320, "height_px": 240}
SERIAL = "02-2142A-06001"
MODEL = "GC1380H (02-2142A)"


@dataclass
class Simulator:
    """A simulated camera in its own process."""

    process: subprocess.Popen[str]
    port: int

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    def fall_silent(self) -> None:
        """Stop all its threads; the signal alone may take its time."""
        self.process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, self.process.pid, os.WSTOPPED | os.WNOWAIT)

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


Start = Callable[..., Simulator]


def start_simulator(*faults: str, port: int = 0) -> Simulator:
    arguments = [f"--fault={fault}" for fault in faults]
    command = [sys.executable, "-m", "drivers.gige.simulator", f"--port={port}", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return Simulator(process, json.loads(process.stdout.readline())["port"])


@pytest.fixture
def start() -> Iterator[Start]:
    """The factory ``start(*faults, port=0)``."""
    running: list[Simulator] = []

    def start_one(*faults: str, port: int = 0) -> Simulator:
        running.append(start_simulator(*faults, port=port))
        return running[-1]

    yield start_one
    for simulator in running:
        simulator.end()


@pytest.fixture(scope="module")
def sound() -> Iterator[Simulator]:
    """One without faults, for all tests that leave it running."""
    simulator = start_simulator()
    yield simulator
    simulator.end()


@pytest.fixture
def make() -> Iterator[Callable[..., object]]:
    """The factory ``make(simulator, name=..., **options)`` of cameras, not yet connected."""
    cameras: list[object] = []

    def make_one(simulator: Simulator | None = None, *, name: str = "here", **options: object):
        if simulator is not None:
            options["address"] = simulator.address
        options.setdefault("region", SMALL)
        cameras.append(open_camera(DeviceContext(name=name, options=options, seed=0, world=None)))
        return cameras[-1]

    yield make_one
    for camera in cameras:
        camera.close()


@pytest.fixture
def connect(start: Start, sound: Simulator, make):
    """The factory ``connect(*faults, **options)`` of cameras that are configured."""

    def connect_one(*faults: str, exposure_s: float = 0.001, **options: object):
        camera = make(start(*faults) if faults else sound, **options)
        camera.connect()
        camera.configure(exposure_s=exposure_s, gain_db=0.0, pixel_format="Mono8")
        return camera

    return connect_one


def assert_is_pattern(frame: Frame) -> None:
    height, width = frame.image.shape
    expected = pattern(frame.frame_id, width, height, frame.pixel_format)
    assert frame.image.dtype == expected.dtype
    np.testing.assert_array_equal(frame.image, expected)


def test_camera_says_who_it_is(sound: Simulator, make):
    camera = make(sound)
    camera.connect()
    identity = camera.identify()
    assert identity.maker == "Allied Vision Technologies"
    assert (identity.model, identity.serial) == (MODEL, SERIAL)
    assert identity.firmware


@pytest.mark.parametrize(
    ("pixel_format", "is_packed"), [("Mono8", False), ("Mono12", False), ("Mono12", True)]
)
def test_pixels_come_bit_for_bit(connect, pixel_format: str, is_packed: bool):
    camera = connect(is_packed=is_packed, region=None)
    camera.configure(exposure_s=0.002, gain_db=6.0, pixel_format=pixel_format)
    wire = camera._connected("test").features.text("pixel format")
    assert wire == ("Mono12Packed" if is_packed else pixel_format)
    for _ in range(3):
        frame = camera.grab(timeout_s=5.0)
        assert frame.image.shape == (1024, 1360)
        assert (frame.pixel_format, frame.exposure_s, frame.gain_db) == (pixel_format, 0.002, 6.0)
        assert_is_pattern(frame)


@pytest.mark.parametrize(
    "region",
    [SMALL, {"left_px": 1, "top_px": 1, "width_px": 1359, "height_px": 1023}],
)
def test_region_is_read_out(connect, region: dict[str, int]):
    camera = connect(region=region, is_packed=True)
    for pixel_format in ("Mono8", "Mono12"):
        camera.configure(exposure_s=0.001, gain_db=0.0, pixel_format=pixel_format)
        frame = camera.grab(timeout_s=5.0)
        assert frame.image.shape == (region["height_px"], region["width_px"])
        assert_is_pattern(frame)
    features = camera._connected("test").features
    offsets = [features.integer(name, call="test") for name in ("OffsetX", "OffsetY")]
    assert offsets == [region["left_px"], region["top_px"]]


def test_region_beyond_the_sensor_is_refused(sound: Simulator, make):
    camera = make(sound, region={**SMALL, "width_px": 1361})
    with pytest.raises(LimitError, match=r"^here: connect: width is 1361 px, allowed .* 1360 px"):
        camera.connect()
    with pytest.raises(NotConnectedError, match="not connected"):
        camera.identify()


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"exposure_s": 1e-6}, r"exposure is 1e-06 s, allowed 1e-05 s to 60 s"),
        ({"exposure_s": 61.0}, r"exposure is 61 s, allowed 1e-05 s to 60 s"),
        ({"gain_db": 34.0}, r"gain is 34 dB, allowed 0 dB to 33 dB"),
        ({"gain_db": 1.5}, r"gain is 1\.5 dB, .* in steps of 1 dB"),
        ({"gain_db": float("nan")}, r"gain is nan dB, allowed 0 dB to 33 dB"),
        ({"exposure_s": float("inf")}, r"exposure is inf s, allowed 1e-05 s to 60 s"),
        ({"pixel_format": "Bayer"}, r"'Bayer', allowed Mono8, Mono12"),
    ],
)
def test_what_the_camera_cannot_do_changes_nothing(connect, setting, message: str):
    camera = connect(exposure_s=0.005)
    wanted = {"exposure_s": 0.007, "gain_db": 3.0, "pixel_format": "Mono12"}
    with pytest.raises(LimitError, match=rf"^here: configure: .*{message}"):
        camera.configure(**{**wanted, **setting})
    frame = camera.grab(timeout_s=5.0)
    assert (frame.exposure_s, frame.gain_db, frame.pixel_format) == (0.005, 0.0, "Mono8")


def test_exposure_is_changed_while_the_camera_waits_for_triggers(connect):
    camera = connect()
    for i, exposure_s in enumerate((0.003, 0.05), start=1):
        camera.configure(exposure_s=exposure_s, gain_db=float(i), pixel_format="Mono8")
        before_s = time.time()
        frame = camera.grab(timeout_s=5.0)
        assert time.time() - before_s >= exposure_s
        assert (frame.exposure_s, frame.gain_db, frame.frame_id) == (exposure_s, i, i)


def test_packet_size_is_set(connect):
    camera = connect(packet_size_bytes=1500)
    assert_is_pattern(camera.grab(timeout_s=5.0))
    features = camera._connected("test").features
    assert features.integer("packet size", call="test") == 1500


def test_frame_is_dated_to_the_middle_of_its_exposure(connect):
    camera = connect(exposure_s=0.1)
    before_s = time.time()
    first = camera.grab(timeout_s=5.0)
    after_s = time.time()
    second = camera.grab(timeout_s=5.0)
    assert before_s + 0.05 <= first.time_s <= after_s - 0.05
    assert second.device_time_s - first.device_time_s == pytest.approx(
        second.time_s - first.time_s, abs=0.05
    )


def test_frame_that_waits_to_be_fetched_is_not_the_triggers_own(connect):
    camera = connect()
    assert camera.grab(timeout_s=5.0).frame_id == 1
    for _ in range(3):
        camera._connected("test").features.execute("software trigger", call="test")
        time.sleep(0.1)
    frame = camera.grab(timeout_s=5.0)
    assert frame.frame_id == 5
    assert_is_pattern(frame)


def test_frame_on_its_way_is_not_the_triggers_own(connect):
    camera = connect(exposure_s=0.2)
    camera.grab(timeout_s=5.0)
    camera._connected("test").features.execute("software trigger", call="test")
    # Busy with that exposure the camera ignores the next trigger.
    with pytest.raises(DeviceTimeoutError, match=r"1 frames from before the trigger came"):
        camera.grab(timeout_s=0.6)
    before_s = time.time()
    assert camera.grab(timeout_s=5.0).time_s >= before_s + 0.1


def test_exposure_longer_than_allowed_is_not_begun(connect):
    camera = connect(exposure_s=1.0)
    with pytest.raises(DeviceTimeoutError, match=r"exposure takes 1 s, allowed are 0.5 s"):
        camera.grab(timeout_s=0.5)
    camera.configure(exposure_s=0.001, gain_db=0.0, pixel_format="Mono8")
    camera.grab(timeout_s=5.0)


def test_free_running_stream_gives_every_frame_once(connect):
    camera = connect()
    frames = list(camera.stream(30, rate_hz=100.0))
    assert [frame.frame_id for frame in frames] == list(range(1, 31))
    for frame in frames:
        assert_is_pattern(frame)
    assert (camera.counters.n_delivered, camera.counters.n_incomplete) == (30, 0)
    assert camera.counters.n_lost == 0
    times = np.array([(frame.time_s, frame.device_time_s) for frame in frames])
    np.testing.assert_allclose(np.diff(times[:, 0]), np.diff(times[:, 1]), atol=1e-6)


def test_stream_and_grab_do_not_mix_but_follow_each_other(connect):
    camera = connect()
    stream: Generator[Frame] = camera.stream(rate_hz=50.0)
    next(stream)
    with pytest.raises(LimitError, match=r"^here: grab: a stream .* is running; close it first"):
        camera.grab(timeout_s=1.0)
    stream.close()
    assert_is_pattern(camera.grab(timeout_s=5.0))
    with closing(camera.stream(2)) as frames:
        assert len(list(frames)) == 2


def test_stream_that_is_begun_late_begins_all_the_same(connect):
    camera = connect()
    frames = camera.stream(2)
    camera.grab(timeout_s=5.0)
    assert len(list(frames)) == 2


def test_stream_counts_frames_nobody_fetched_in_time(connect):
    camera = connect(n_buffers=4)
    frames = camera.stream(rate_hz=200.0)
    next(frames)
    time.sleep(0.5)
    for _ in range(10):
        assert_is_pattern(next(frames))
    frames.close()
    assert camera.counters.n_lost > 10


def test_closed_camera_ends_its_stream_with_an_error(connect):
    camera = connect()
    frames = camera.stream()
    next(frames)
    camera.close()
    with pytest.raises(NotConnectedError, match="closed meanwhile"):
        next(frames)


def test_stream_of_a_connection_that_is_gone_leaves_the_newer_one_alone(connect):
    camera = connect()
    old = camera.stream(rate_hz=50.0)
    next(old)
    camera.close()
    camera.connect()
    new = camera.stream(rate_hz=50.0)
    next(new)
    old.close()
    with pytest.raises(LimitError, match=r"a stream .* is running"):
        camera.grab(timeout_s=5.0)
    assert_is_pattern(next(new))
    new.close()


def test_rate_the_camera_cannot_do_is_refused(connect):
    camera = connect()
    with pytest.raises(LimitError, match=r"^here: stream: frame rate is 1e\+06 Hz, allowed"):
        next(camera.stream(rate_hz=1e6))
    assert_is_pattern(camera.grab(timeout_s=5.0))


@pytest.mark.parametrize("key", ["serial", "model"])
def test_camera_is_found_by_name(sound: Simulator, make, key: str):
    names = {"serial": SERIAL, "model": MODEL}
    camera = make(interfaces=[sound.address], **{key: names[key]})
    camera.connect()
    assert camera.identify().serial == SERIAL


def test_cameras_that_answered_are_listed(start: Start, sound: Simulator, make):
    places = [start().address, sound.address]
    with pytest.raises(
        NotConnectedError, match=rf"no camera with serial 'x' .*found: .*{SERIAL}.*; .*{SERIAL}"
    ):
        make(serial="x", interfaces=places).connect()
    with pytest.raises(NotConnectedError, match=r"2 cameras have model 'GC1380H.*Say which"):
        make(model=MODEL, interfaces=places).connect()


def test_interface_this_computer_has_not_is_named(make):
    with pytest.raises(NotConnectedError, match=r"no network interface 'eth77'; it has lo"):
        make(serial="x", interfaces=["eth77"]).connect()


def test_address_where_no_camera_is_says_so(start: Start, make):
    simulator = start()
    simulator.end()
    with pytest.raises(NotConnectedError, match=rf"'{simulator.address}' answers.*found: none"):
        make(simulator).connect()


def test_two_cameras_work_in_one_process(start: Start, sound: Simulator, make):
    cameras = [make(simulator, name="twin") for simulator in (start(), sound)]
    for camera in cameras:
        camera.connect()
    for _ in range(3):
        for camera in cameras:
            assert_is_pattern(camera.grab(timeout_s=5.0))
    cameras[0].close()
    assert_is_pattern(cameras[1].grab(timeout_s=5.0))


def test_camera_held_by_another_application_is_denied(
    sound: Simulator, make, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("drivers.gige.connection.HEARTBEAT_S", 0.3)
    holder = make(sound, name="holder")
    holder.connect()
    with pytest.raises(AccessDeniedError, match=r"^here: connect: another application controls"):
        make(sound).connect()
    holder.close()
    second = make(sound)
    second.connect()
    assert second.identify().serial == SERIAL


def test_camera_is_taken_over_from_an_application_that_was_killed(sound: Simulator, make):
    holder = (
        "import os, sys; from drivers.gige.driver import open_camera;"
        "from tronlab.devices.registry import DeviceContext;"
        "options = {'address': sys.argv[1]};"
        "context = DeviceContext(name='holder', options=options, seed=0, world=None);"
        "open_camera(context).connect(); os._exit(0)"
    )
    subprocess.run([sys.executable, "-c", holder, sound.address], check=True)
    camera = make(sound)
    camera.connect()
    assert_is_pattern(camera.grab(timeout_s=5.0))


def test_camera_that_says_it_is_held_is_denied(start: Start, make, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("drivers.gige.connection.HEARTBEAT_S", 0.3)
    with pytest.raises(AccessDeniedError, match="another application controls"):
        make(start("camera.held")).connect()


def test_lost_packets_are_sent_again(connect):
    camera = connect("camera.lose_packets", region=None, packet_size_bytes=1500)
    for frame in camera.stream(20, rate_hz=20.0):
        assert_is_pattern(frame)
    assert (camera.counters.n_incomplete, camera.counters.n_lost) == (0, 0)


def test_garbage_between_packets_does_no_harm(connect):
    camera = connect("camera.bad_packets")
    for frame in camera.stream(10, rate_hz=50.0):
        assert_is_pattern(frame)


def test_incomplete_frame_is_an_error_of_its_own_and_the_next_one_is_whole(connect):
    camera = connect("camera.incomplete:1")
    with pytest.raises(IncompleteFrameError, match=r"^here: grab: parts of the frame were lost"):
        camera.grab(timeout_s=5.0)
    assert_is_pattern(camera.grab(timeout_s=5.0))


def test_incomplete_frames_of_a_stream_are_counted(connect):
    camera = connect("camera.incomplete:2")
    frames = list(camera.stream(5, rate_hz=50.0))
    assert [frame.frame_id for frame in frames] == [3, 4, 5, 6, 7]
    assert (camera.counters.n_incomplete, camera.counters.n_lost) == (2, 0)


@pytest.mark.parametrize("fault", ["camera.lose_frame:1", "camera.ignores_trigger:1"])
def test_frame_that_does_not_come_is_a_timeout_and_the_next_one_comes(connect, fault: str):
    camera = connect(fault)
    with pytest.raises(DeviceTimeoutError, match=r"^here: grab: no frame within 0.5 s"):
        camera.grab(timeout_s=0.5)
    assert_is_pattern(camera.grab(timeout_s=5.0))


def test_stream_that_dries_up_is_a_timeout(connect):
    camera = connect("camera.lose_frame", frame_timeout_s=0.3)
    with pytest.raises(DeviceTimeoutError, match=r"^here: stream: no complete frame within"):
        next(camera.stream())


def test_camera_that_takes_its_time_is_waited_for(connect):
    assert_is_pattern(connect("camera.slow_command:1").grab(timeout_s=5.0))


@pytest.mark.parametrize("fault", ["camera.silent", "camera.gone"])
def test_camera_that_does_not_answer_is_not_connected(start: Start, make, fault: str):
    with pytest.raises(NotConnectedError, match=r"^here: connect: no camera .* answers"):
        make(start(fault)).connect()


def test_camera_that_falls_silent_is_lost_and_can_be_connected_again(start: Start, make):
    simulator = start()
    camera = make(simulator)
    camera.connect()
    camera.grab(timeout_s=5.0)
    simulator.fall_silent()
    with pytest.raises(NotConnectedError, match=r"^here: grab: .*then connect again"):
        camera.grab(timeout_s=1.0)
    camera.close()
    simulator.process.send_signal(signal.SIGCONT)
    camera.connect()
    assert_is_pattern(camera.grab(timeout_s=5.0))


def test_camera_that_was_restarted_obeys_after_connecting_again(start: Start, make):
    simulator = start()
    camera = make(simulator)
    camera.connect()
    camera.grab(timeout_s=5.0)
    simulator.end()
    start(port=simulator.port)
    with pytest.raises(NotConnectedError, match=r"^here: (grab|configure): .*then connect again"):
        camera.grab(timeout_s=2.0)
    camera.close()
    camera.connect()
    assert_is_pattern(camera.grab(timeout_s=5.0))


def test_camera_lost_in_a_stream_is_noticed(start: Start, make):
    simulator = start()
    camera = make(simulator, frame_timeout_s=0.5)
    camera.connect()
    frames = camera.stream(rate_hz=50.0)
    next(frames)
    simulator.end()
    with pytest.raises((NotConnectedError, DeviceTimeoutError), match=r"^here: stream: "):
        list(frames)


def test_nothing_is_left_after_close(sound: Simulator, make):
    camera = make(sound)
    camera.connect()
    camera.close()
    before = _n_native_threads(), threading.active_count(), len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        camera.connect()
        camera.grab(timeout_s=5.0)
        camera.close()
    after = _n_native_threads(), threading.active_count(), len(os.listdir("/proc/self/fd"))
    assert after == before


def _n_native_threads() -> int:
    return len(os.listdir("/proc/self/task"))
