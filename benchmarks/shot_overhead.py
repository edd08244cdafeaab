"""What a shot costs beyond its devices: engine, truth, quality gate and writer, at 1 megapixel.

The devices are the twin's geometry without its time and its rendering: they answer at once. Beside
it, in the same run, the peer: the same images and masks appended to an HDF5 file by a bare loop.

    python benchmarks/shot_overhead.py [--shots 100] [--out DIR]
"""

import argparse
import statistics
import tempfile
import time
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.brightness import LightModel
from tronlab.campaign.engine import run_shots
from tronlab.campaign.foresight import Foresight, foresee
from tronlab.campaign.job import Files, Job, read_job
from tronlab.campaign.listener import RunListener
from tronlab.campaign.live import SilentLive
from tronlab.campaign.recording import Assignment, provenance_of
from tronlab.campaign.session import new_session
from tronlab.campaign.shot import ShotTaker, TruthSource
from tronlab.dataset.writer import DatasetWriter
from tronlab.devices.clock import WallClock
from tronlab.devices.readings import (
    DeviceIdentity,
    Frame,
    PoseReading,
    RobotReading,
    RobotTarget,
    RoomReading,
)
from tronlab.planning.shots import Plan
from tronlab.render.photometry import Lambert

LIMIT_MS = 25.0
REPOSITORY = Path(__file__).parents[1]


@dataclass
class InstantDevices:
    """Robot, tracker, camera and room that take no time."""

    job: Job
    rng: np.random.Generator
    image: np.ndarray = field(init=False)
    target: RobotTarget = field(init=False)
    trk_from_tmac: RigidTransform = field(init=False)
    name: str = "instant"

    def __post_init__(self) -> None:
        shape = self.job.calibration.camera.shape
        self.image = self.rng.integers(20, 200, shape).astype(np.uint8)
        mounting = self.job.calibration.mounting(self.job.rig.config.laboratory.mounting)
        self._trs_from_cam = mounting.trs_from_cam

    def move(self, target: RobotTarget, *, timeout_s: float) -> None:
        record, self.target = self.job.calibration, target
        self.trk_from_tmac = (
            record.trs_from_trk.inv() * self._trs_from_cam(target) * record.tmac_from_cam.inv()
        )

    def stop(self) -> None: ...

    def measure_pose(self, *, window_s: float) -> PoseReading:
        return PoseReading(self.trk_from_tmac, np.eye(6) * 1e-10, time.time())

    def grab(self, *, timeout_s: float) -> Frame:
        return Frame(self.image, "Mono8", 0.02, 0.0, 1, time.time())

    def robot_reading(self) -> RobotReading:
        return RobotReading(self.target.rail_m, self.target.base_from_flange, time.time())

    def room_reading(self) -> RoomReading:
        return RoomReading(293.15, 101325.0, 0.45, True, True, time.time())


def devices_of(instant: InstantDevices) -> Any:
    robot = SimpleNamespace(
        name="robot", move=instant.move, read=instant.robot_reading, stop=instant.stop
    )
    tracker = SimpleNamespace(name="tracker", measure_pose=instant.measure_pose)
    camera = SimpleNamespace(name="camera", grab=instant.grab)
    room = SimpleNamespace(name="room", read=instant.room_reading)
    return SimpleNamespace(
        robot=robot, tracker=tracker, camera=camera, room=room, clock=WallClock()
    )


def tronlab_ms(job: Job, foresight: Foresight, out: Path) -> list[float]:
    """Give the time of each shot."""
    config, calibration = job.campaign.config, job.calibration
    config = config.model_copy(update={"settle": config.settle.model_copy(update={"wait_s": 0.0})})
    light = LightModel(
        foresight.renderer, foresight.heightmap, calibration.camera, job.lamp, Lambert()
    )
    taker = ShotTaker(
        devices=devices_of(InstantDevices(job, np.random.default_rng(1))),
        config=config,
        truth_source=TruthSource(
            calibration,
            foresight.heightmap,
            foresight.renderer,
            job.rig.config.terrain.registration,
        ),
        light=light,
    )
    nobody = DeviceIdentity("", "", "", "")
    session = new_session(
        job, number=1, kind="run", software={}, devices={"robot": str(nobody)}, accepted=()
    )
    assignment = Assignment(
        job=job,
        foresight=foresight,
        dataset_path=out / "dataset.h5",
        kind="run",
        shots=foresight.plan.shots,
        acceptances=(Acceptance(is_given=False, warn=print),),
    )
    ends_s = [time.perf_counter()]
    with DatasetWriter(
        out / "dataset.h5", provenance_of(assignment, session), session=session, segment_shots=100
    ) as writer:
        run_shots(
            Plan(assignment.shots),
            taker,
            commit=writer.commit,
            listener=RunListener(on_shot=lambda _record: ends_s.append(time.perf_counter())),
        )
        writer.finish("complete")
    return [1e3 * (b - a) for a, b in pairwise(ends_s)][1:]  # the first makes the segment


def peer_ms(job: Job, n_shots: int, out: Path) -> list[float]:
    """Give the time of each shot of a bare loop that appends image and mask, and flushes."""
    shape = job.calibration.camera.shape
    image = np.zeros(shape, np.uint8)
    durations_ms: list[float] = []
    with h5py.File(out / "peer.h5", "x") as file:
        stacks = [
            file.create_dataset(
                name, (0, *shape), maxshape=(None, *shape), chunks=(1, *shape), dtype="u1"
            )
            for name in ("image", "mask")
        ]
        for n in range(1, n_shots + 1):
            begin_s = time.perf_counter()
            for stack in stacks:
                stack.resize(n, axis=0)
                stack[n - 1] = image
            file.flush()
            durations_ms.append(1e3 * (time.perf_counter() - begin_s))
    return durations_ms


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shots", type=int, default=100)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.out) as folder:
        out = Path(folder)
        job = read_job(
            Files(campaign_of(arguments.shots, out)),
            seed=None,
            acceptance=Acceptance(is_given=False, warn=print),
        )
        foresight = foresee(job, job.plan.shots, live=SilentLive())
        ours = tronlab_ms(job, foresight, out)
        peer = peer_ms(job, arguments.shots, out)
    rows, columns = job.calibration.camera.shape
    print(f"{arguments.shots} shots of {columns} x {rows}, milliseconds a shot: median, 95 %")
    for name, durations_ms in (("engine, truth, gate, writer", ours), ("bare HDF5 loop", peer)):
        worst_ms = float(np.percentile(durations_ms, 95))
        print(f"{name:<28} {statistics.median(durations_ms):6.1f} {worst_ms:6.1f}")
    print(f"asked: at most {LIMIT_MS:g}")
    print(f"ratio of the medians: {statistics.median(ours) / statistics.median(peer):.1f}")


def campaign_of(n_shots: int, folder: Path) -> Path:
    """Give the repository's straight line with so many shots."""
    source = REPOSITORY / "campaigns/straight_line.yaml"
    text = source.read_text(encoding="utf-8")
    text = text.replace("rigs/twin.yaml", str(source.parent / "rigs/twin.yaml"))
    text = text.replace("../calibration", str(REPOSITORY / "calibration"))
    path = folder / "campaign.yaml"
    path.write_text(text.replace("n_points: 61", f"n_points: {n_shots}"), encoding="utf-8")
    return path


if __name__ == "__main__":
    main()
