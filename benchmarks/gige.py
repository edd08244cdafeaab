"""The camera driver on the simulated camera, over loopback, beside a host that others wrote.

    python benchmarks/gige.py [--quick]

Prints frames a second, lost and wrong frames, how late another thread gets its turn meanwhile, and
the time from a trigger to its frame. The peer is the host of viva-genicam, a GigE Vision stack in
Rust that shares nothing with ours; it receives from the same simulated camera in the same run. As
it looks for cameras at UDP port 3956 only, it is left out where that port of 127.0.0.1 is in use.
Frames are compared bit by bit with what the camera has sent, but not in the runs at full speed.
"""

import argparse
import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import viva_genicam
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from drivers.gige.driver import open_camera
from drivers.gige.simulator.scene import pattern
from tronlab.devices.registry import DeviceContext

LOOPBACK, STANDARD_PORT = "127.0.0.1", 3956
RATE_HZ, HIGHEST_RATE_HZ = 20.0, 2000.0
EXPOSURE_S = 0.0001
TICK_S = 0.001
PACKET_BYTES = 8228  # what our producer agrees on with the camera
N_BLOCK_IDS = 65535
HEADINGS = ("run", "receiver", "frames", "Hz", "lost", "wrong", "late ms p99.9", "max", "CPU %")

Received = Iterator[tuple[int, NDArray]]


@dataclass(frozen=True)
class Run:
    """One measurement of one receiver."""

    what: str
    receiver: str
    block_ids: list[int]
    duration_s: float
    n_wrong: int | None
    late_ms: tuple[float, float]
    """99.9th percentile and maximum."""
    cpu_s: float

    @property
    def rate_hz(self) -> float:
        """Get frames a second."""
        return (len(self.block_ids) - 1) / self.duration_s

    @property
    def row(self) -> tuple[str, ...]:
        """Get what the table says."""
        n_lost = sum(
            (after - before - 1) % N_BLOCK_IDS for before, after in pairwise(self.block_ids)
        )
        return (
            self.what,
            self.receiver,
            str(len(self.block_ids)),
            f"{self.rate_hz:.2f}",
            str(n_lost),
            "-" if self.n_wrong is None else str(self.n_wrong),
            *(f"{late:.1f}" for late in self.late_ms),
            f"{100 * self.cpu_s / self.duration_s:.0f}",
        )


class Ticker:
    """A thread that wants its turn every millisecond, and notes how late it comes."""

    def __enter__(self) -> "Ticker":
        self._late_s: list[float] = []
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._tick)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join()

    def _tick(self) -> None:
        while not self._stopped.is_set():
            started_s = time.perf_counter()
            time.sleep(TICK_S)
            self._late_s.append(time.perf_counter() - started_s - TICK_S)

    @property
    def late_ms(self) -> tuple[float, float]:
        """Get 99.9th percentile and maximum."""
        return tuple(1e3 * np.quantile(self._late_s, (0.999, 1.0)))


@contextmanager
def simulator(port: int, *arguments: str) -> Generator[str]:
    command = [sys.executable, "-m", "drivers.gige.simulator", f"--port={port}", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        address = json.loads(process.stdout.readline())
        yield f"{address['host']}:{address['port']}"
    finally:
        process.terminate()
        process.wait()
        process.stdout.close()


@contextmanager
def own_camera(address: str, pixel_format: str) -> Generator:
    options = {"address": address, "n_buffers": 32}
    camera = open_camera(DeviceContext(name="camera", options=options, seed=0, world=None))
    camera.connect()
    try:
        camera.configure(exposure_s=EXPOSURE_S, gain_db=0.0, pixel_format=pixel_format)
        yield camera
    finally:
        camera.close()


@contextmanager
def peer_camera(pixel_format: str) -> Generator:
    found = viva_genicam.discover(timeout_ms=500, all=True)
    (info,) = [info for info in found if info.ip == LOOPBACK]
    with viva_genicam.connect_gige(info) as camera:
        camera.disable_trigger("FrameStart")
        camera.set("PixelFormat", pixel_format)
        camera.set_exposure_time(EXPOSURE_S * 1e6)
        yield camera


@contextmanager
def own_stream(address: str, pixel_format: str, rate_hz: float) -> Generator[Received]:
    with own_camera(address, pixel_format) as camera:
        frames = camera.stream(rate_hz=rate_hz)
        yield ((frame.frame_id, frame.image) for frame in frames)
        frames.close()


@contextmanager
def peer_stream(address: str, pixel_format: str, rate_hz: float) -> Generator[Received]:
    with peer_camera(pixel_format) as camera:
        camera.set_frame_rate(rate_hz)
        with camera.stream(packet_size=PACKET_BYTES) as frames:
            yield ((frame.block_id, frame.to_numpy()) for frame in frames)


@contextmanager
def own_trigger(address: str) -> Generator[Callable[[], object]]:
    with own_camera(address, "Mono8") as camera:
        yield lambda: camera.grab(timeout_s=5.0)


@contextmanager
def peer_trigger(address: str) -> Generator[Callable[[], object]]:
    with peer_camera("Mono8") as camera:
        camera.enable_trigger("FrameStart", "Software")
        with camera.stream(packet_size=PACKET_BYTES) as frames:

            def shoot() -> NDArray:
                camera.trigger_software()
                return next(frames).to_numpy()

            yield shoot


def is_as_sent(block_id: int, image: NDArray) -> bool:
    height, width = image.shape
    pixel_format = "Mono8" if image.dtype == np.uint8 else "Mono12"
    return np.array_equal(image, pattern(block_id, width, height, pixel_format))


def receive(what: str, receiver: str, frames: Received, n_frames: int, *, is_checked: bool) -> Run:
    n_wrong, block_ids = 0, [next(frames)[0]]
    with Ticker() as ticker:
        started_s, cpu_s = time.perf_counter(), time.process_time()
        while len(block_ids) < n_frames:
            block_id, image = next(frames)
            block_ids.append(block_id)
            n_wrong += is_checked and not is_as_sent(block_id, image)
        duration_s, cpu_s = time.perf_counter() - started_s, time.process_time() - cpu_s
    return Run(
        what,
        receiver,
        block_ids,
        duration_s,
        n_wrong if is_checked else None,
        ticker.late_ms,
        cpu_s,
    )


def lateness_without_camera(duration_s: float) -> tuple[float, float]:
    """Give how late the ticker comes on this computer when nothing is received, ms."""
    with Ticker() as ticker:
        time.sleep(duration_s)
    return ticker.late_ms


def measure_streams(streams: dict, port: int, *, duration_s: float) -> Generator[Run]:
    """Give the runs of every receiver, one after the other."""
    paced, fast = int(RATE_HZ * duration_s), int(100 * duration_s)
    for what, pixel_format, arguments, rate_hz, n_frames in (
        ("Mono8 at 20 Hz", "Mono8", (), RATE_HZ, paced),
        ("Mono12 at 20 Hz", "Mono12", (), RATE_HZ, paced),
        ("1 % of packets lost", "Mono8", ("--fault=camera.lose_packets",), RATE_HZ, paced),
        ("unthrottled", "Mono8", ("--unthrottled",), HIGHEST_RATE_HZ, fast),
        (
            "unthrottled, offload",
            "Mono8",
            ("--unthrottled", "--segmentation-offload"),
            HIGHEST_RATE_HZ,
            fast,
        ),
    ):
        with simulator(port, *arguments) as address:
            for receiver, stream in streams.items():
                is_checked = rate_hz == RATE_HZ
                with stream(address, pixel_format, rate_hz) as frames:
                    yield receive(what, receiver, frames, n_frames, is_checked=is_checked)


def time_triggers(triggers: dict, port: int, *, n_shots: int) -> dict[str, NDArray]:
    """Give seconds from trigger to frame, shape (n_shots,), of every receiver."""
    times_s = {}
    with simulator(port, "--unthrottled", "--segmentation-offload") as address:
        for receiver, trigger in triggers.items():
            with trigger(address) as shoot:
                shoot()  # the first one also starts the acquisition
                times_s[receiver] = np.array([seconds_of(shoot) for _ in range(n_shots)])
    return times_s


def seconds_of(call: Callable[[], object]) -> float:
    started_s = time.perf_counter()
    call()
    return time.perf_counter() - started_s


def is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            return False
    return True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="runs of 5 s instead of 60")
    duration_s, n_shots = (5.0, 50) if parser.parse_args().quick else (60.0, 500)
    console = Console(width=110)

    streams = {"driver": own_stream, "viva-genicam": peer_stream}
    triggers = {"driver": own_trigger, "viva-genicam": peer_trigger}
    port = STANDARD_PORT
    if not is_free(STANDARD_PORT):
        console.print(f"no peer: UDP port {STANDARD_PORT} of {LOOPBACK} is in use")
        del streams["viva-genicam"], triggers["viva-genicam"]
        port = 0

    table = Table(*HEADINGS, title="1360 x 1024 over loopback; exposure 0.1 ms")
    rates: dict[str, list[float]] = {}
    for run in measure_streams(streams, port, duration_s=duration_s):
        table.add_row(*run.row)
        rates.setdefault(run.what, []).append(run.rate_hz)
    console.print(table)
    console.print(
        "no camera: late ms p99.9 {:.1f}, max {:.1f}".format(*lateness_without_camera(duration_s))
    )
    for what, (own_hz, *peer_hz) in rates.items():
        for hz in peer_hz:
            console.print(f"{what}: driver / viva-genicam {own_hz / hz:.2f}")

    times_s = time_triggers(triggers, port, n_shots=n_shots)
    for receiver, seconds in times_s.items():
        median_ms, p99_ms = 1e3 * np.quantile(seconds, (0.5, 0.99))
        console.print(
            f"trigger to frame, {receiver}: median {median_ms:.2f} ms, p99 {p99_ms:.2f} ms"
        )
    medians_s = [float(np.median(seconds)) for seconds in times_s.values()]
    if len(medians_s) == 2:
        console.print(f"trigger to frame: driver / viva-genicam {medians_s[0] / medians_s[1]:.2f}")


if __name__ == "__main__":
    main()
