"""What it costs to have a core in another process: time per frame of a core that does nothing.

A frame of 1024 x 1024 with its mask, there and the answer back: in this process, through shared
memory, through pipes, over TCP on this machine. Beside it, in the same run, the peer: the same two
arrays through the standard library's multiprocessing.Pipe, pickled. The ways take turns, so that
what else the computer does falls on all of them.

    python benchmarks/core_transport.py [--frames 200] [--side 1024] [--core "cmd:./my_core"]...
"""

import argparse
import multiprocessing
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from unittest import mock

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.records import ReferenceView
from tronlab.geometry.camera import CameraModel
from tronlab.nav.core import CoreContext, Frame, NavigationResult
from tronlab.nav.foreign import conversation, open_core
from tronlab.nav.specs import CoreSpec, parse_core

HERE = RigidTransform.from_translation([1.0, 2.0, 3.0])
HOSTED = CoreSpec("idle", "python", "benchmarks.core_transport:Idle")
PEER = "multiprocessing.Pipe (peer)"
HOST = "tronlab.nav.foreign.host"
LIMIT_S = 60.0

Ask = Callable[[Frame], object]


class Idle:
    """A core that looks at nothing."""

    name = "idle"

    def __init__(self, context: CoreContext) -> None:
        pass

    def locate(self, frame: Frame) -> NavigationResult:
        return NavigationResult("ok", HERE)


@contextmanager
def listening() -> Generator[CoreSpec]:
    """Serve the idle core on a socket."""
    host = subprocess.Popen(
        [sys.executable, "-m", HOST, HOSTED.target, "--listen", "127.0.0.1:0"],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert host.stdout is not None
        yield parse_core(host.stdout.readline().strip())
    finally:
        host.kill()
        host.communicate()


def echo(connection: Connection) -> None:
    """Take arrays and answer, until there are no more."""
    while connection.recv() is not None:
        connection.send(("ok", [1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0]))


@contextmanager
def multiprocessing_peer() -> Generator[Ask]:
    ours, theirs = multiprocessing.Pipe()
    peer = multiprocessing.get_context("spawn").Process(target=echo, args=(theirs,))
    peer.start()

    def ask(frame: Frame) -> object:
        ours.send((frame.image, frame.mask))
        return ours.recv()

    try:
        yield ask
    finally:
        ours.send(None)
        peer.join()


@contextmanager
def foreign(spec: CoreSpec, context: CoreContext) -> Generator[Ask]:
    with open_core(spec, context, limit_s=LIMIT_S) as core:
        yield core.locate


@contextmanager
def piped(context: CoreContext) -> Generator[Ask]:
    """The hosted core, as where there is no shared memory."""
    with foreign(HOSTED, context) as ask:
        with mock.patch.object(conversation, "IS_POSSIBLE", False):
            ask(frame_of(context, 0))
        yield ask


def context_of(camera: CameraModel) -> CoreContext:
    """Give the camera with one view of a featureless plane, for cores that need one."""
    view = ReferenceView(
        view_id=1,
        trs_from_cam=HERE,
        image=np.full(camera.shape, 100, np.uint8),
        depth_m=np.ones(camera.shape, np.float32),
        mask=np.ones(camera.shape, np.bool_),
    )
    return CoreContext(camera, (view,))


def frame_of(context: CoreContext, number: int) -> Frame:
    image = np.random.default_rng(number).integers(0, 255, context.camera.shape, np.uint8)
    return Frame(image, image > 20, number=number)


def measure(ways: dict[str, Ask], context: CoreContext, n_frames: int) -> dict[str, np.ndarray]:
    """Give wall time and CPU time of this process, ms, shape (n_frames, 2), by way.

    The first frame, which starts the cores, is left out.
    """
    spent_ms: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    for number in range(n_frames + 1):
        frame = frame_of(context, number)
        for name, ask in ways.items():
            wall_s, cpu_s = time.perf_counter(), time.process_time()
            answer = ask(frame)
            wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
            spent_ms[name].append((1e3 * wall_s, 1e3 * cpu_s))
            if isinstance(answer, NavigationResult):
                assert answer.status in {"ok", "no_pose"}, answer.reason
    return {name: np.array(values[1:]) for name, values in spent_ms.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--side", type=int, default=1024, help="of the image, pixels")
    parser.add_argument("--core", action="append", default=[], help="more cores, as score has them")
    arguments = parser.parse_args()
    side = arguments.side
    context = context_of(CameraModel(side, side, side, side, side / 2, side / 2))
    with ExitStack() as stack:
        enter = stack.enter_context
        ways: dict[str, Ask] = {
            "in this process": Idle(context).locate,
            "shared memory": enter(foreign(HOSTED, context)),
            "pipes": enter(piped(context)),
            "TCP": enter(foreign(enter(listening()), context)),
            PEER: enter(multiprocessing_peer()),
        }
        for text in arguments.core:
            ways[text] = enter(foreign(parse_core(text), context))
        spent_ms = measure(ways, context, arguments.frames)
    print(
        f"{arguments.frames} frames of {side} x {side}, milliseconds a frame; CPU: of this process"
    )
    peer_ms = np.median(spent_ms[PEER], axis=0)
    print(f"{'':<30} {'median':>8} {'95 %':>8} {'of peer':>8} {'CPU':>8} {'of peer':>8}")
    for name, values in spent_ms.items():
        (wall_ms, cpu_ms), worst_ms = np.median(values, axis=0), np.percentile(values[:, 0], 95)
        print(
            f"{name:<30} {wall_ms:8.3f} {worst_ms:8.3f} {wall_ms / peer_ms[0]:8.2f}"
            f" {cpu_ms:8.3f} {cpu_ms / peer_ms[1]:8.2f}"
        )


if __name__ == "__main__":
    main()
