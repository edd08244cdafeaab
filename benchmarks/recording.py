"""Writing a dataset as fast as it goes, beside what h5py and NumPy need for the same arrays.

    python benchmarks/recording.py [--shots 200] [--rows 100000] [--dir DIR]

Prints frames a second and milliseconds a shot (1360 x 1024, Mono12, with mask) for the dataset's
writer, for arrays appended with h5py and a flush a shot, and for one .npy file an array; then the
same for one shot of 1 MP at a time, which the writer forces to the disk. At last it opens a dataset
of 100 000 shots without images. The writer does more than its peers: it checks every value, stores
50 columns and three checksums, and forces everything to the disk once a second; the peers do none
of that. All write to the same disk in the same run, in turns.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.dataset import schema, skeleton
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Provenance, ShotRecord, Truth
from tronlab.dataset.segments import plan_segments
from tronlab.dataset.writer import DatasetWriter
from tronlab.devices.readings import Frame, PoseReading, RobotReading, RoomReading
from tronlab.geometry.camera import CameraModel

SEGMENT_SHOTS = 100
N_IMAGES = 8
"""Different ones, written in turns."""
PAUSE_S = 1.05
"""Longer than the writer lets pass between two fsyncs."""


@dataclass(frozen=True)
class Run:
    """How long each shot took to write."""

    writer: str
    took_s: NDArray[np.float64]
    total_s: float
    """From the first shot until everything is closed and forced to the disk."""
    cpu_s: float
    """What the process worked meanwhile: that does not depend on what else the computer does."""

    @property
    def frames_hz(self) -> float:
        """Get frames a second."""
        return len(self.took_s) / self.total_s

    @property
    def row(self) -> tuple[str, ...]:
        """Get what the table says."""
        took_ms = 1e3 * self.took_s
        numbers = (
            took_ms.mean(),
            np.median(took_ms),
            np.quantile(took_ms, 0.99),
            took_ms.max(),
            1e3 * self.cpu_s / len(took_ms),
        )
        return (self.writer, f"{self.frames_hz:.1f}", *(f"{number:.2f}" for number in numbers))


def camera(width_px: int, height_px: int) -> CameraModel:
    return CameraModel(
        width_px=width_px,
        height_px=height_px,
        fx_px=1000.0,
        fy_px=1000.0,
        cx_px=width_px / 2,
        cy_px=height_px / 2,
        distortion=(0.0,) * 5,
    )


def provenance(model: CameraModel, n_shots: int) -> Provenance:
    return Provenance(
        campaign_name="recording",
        campaign_yaml="name: recording\n" * 50,
        rig_name="none",
        rig_yaml="name: none\n" * 200,
        calibration_json='{"created_utc": ""}' * 1000,
        seed=1,
        software={"tronlab": "0"},
        devices={"camera": "none"},
        plan_sha256="0" * 64,
        n_shots_planned=n_shots,
        camera=model,
    )


def shots(model: CameraModel, n_shots: int, dtype: type, pixel_format: str) -> list[ShotRecord]:
    rng = np.random.default_rng(1)
    top = 4095 if dtype is np.uint16 else 255
    images = [rng.integers(0, top, model.shape, dtype=dtype) for _ in range(N_IMAGES)]
    mask = np.ones(model.shape, np.bool_)
    pose = RigidTransform.from_components([1.0, 2.0, 3.0], Rotation.from_rotvec([0.1, 0.2, 3.0]))
    covariance = 1e-8 * np.eye(6)
    return [
        ShotRecord(
            shot_id=i,
            attempt=1,
            trs_from_cam_nominal=pose,
            robot=RobotReading(rail_m=1.0, base_from_flange=pose, time_s=1.7e9 + i),
            tracker=PoseReading(trk_from_tmac=pose, covariance=covariance, time_s=1.7e9 + i),
            room=RoomReading(293.0, 95_000.0, 0.4, True, True, 1.7e9 + i),
            frame=Frame(images[i % N_IMAGES], pixel_format, 0.01, 0.0, i, 1.7e9 + i),
            mask=mask,
            truth=Truth(pose, covariance, 3.0, 1.0),
        )
        for i in range(n_shots)
    ]


def timed(name: str, write: Callable[[ShotRecord], None], stack: ExitStack, taken: list) -> Run:
    took_s = np.zeros(len(taken))
    begin_s, begin_cpu_s = time.perf_counter(), time.process_time()
    for i, shot in enumerate(taken):
        before_s = time.perf_counter()
        write(shot)
        took_s[i] = time.perf_counter() - before_s
    stack.close()
    total_s = time.perf_counter() - begin_s
    return Run(name, took_s, total_s, time.process_time() - begin_cpu_s)


def by_writer(folder: Path, taken: list[ShotRecord], model: CameraModel) -> Run:
    stack = ExitStack()
    writer = DatasetWriter(
        folder / "a.h5", provenance(model, len(taken)), segment_shots=SEGMENT_SHOTS
    )
    stack.callback(writer.finish, "complete")
    return timed("DatasetWriter", writer.commit, stack, taken)


def by_h5py(folder: Path, taken: list[ShotRecord], model: CameraModel) -> Run:
    stack = ExitStack()
    file = stack.enter_context(h5py.File(folder / "b.h5", "w"))
    stack.callback(lambda: os.fsync(file.id.get_vfd_handle()))
    types = {"image": taken[0].frame.image.dtype, "mask": np.uint8}
    stacks = {
        name: file.create_dataset(
            name, (0, *model.shape), dtype, maxshape=(None, *model.shape), chunks=(1, *model.shape)
        )
        for name, dtype in types.items()
    }

    def write(shot: ShotRecord) -> None:
        for name, array in (("image", shot.frame.image), ("mask", shot.mask)):
            stacks[name].resize(len(stacks[name]) + 1, axis=0)
            stacks[name][-1] = array
        file.flush()

    return timed("h5py, append and flush", write, stack, taken)


def by_numpy(folder: Path, taken: list[ShotRecord], _: CameraModel) -> Run:
    def write(shot: ShotRecord) -> None:
        np.save(folder / f"{shot.shot_id}_image.npy", shot.frame.image)
        np.save(folder / f"{shot.shot_id}_mask.npy", shot.mask)

    stack = ExitStack()
    stack.callback(os.sync)
    return timed("NumPy, one .npy an array", write, stack, taken)


def in_turns(taken: list[ShotRecord], model: CameraModel, parent: Path | None) -> Iterator[Run]:
    for record in (by_writer, by_h5py, by_numpy):
        with tempfile.TemporaryDirectory(dir=parent) as folder:
            os.sync()
            yield record(Path(folder), taken, model)


def one_at_a_time(parent: Path, n_shots: int) -> Run:
    """As in a laboratory: so much time between shots that every one is forced to the disk."""
    model = camera(1000, 1000)
    taken = shots(model, n_shots + 1, np.uint8, "Mono8")
    took_s = np.zeros(n_shots)
    with tempfile.TemporaryDirectory(dir=parent) as folder:
        path = Path(folder) / "a.h5"
        writer = DatasetWriter(path, provenance(model, n_shots + 1), segment_shots=SEGMENT_SHOTS)
        writer.commit(taken[0])  # makes the structure
        cpu_s = time.process_time()
        for i, shot in enumerate(taken[1:]):
            time.sleep(PAUSE_S)
            before_s = time.perf_counter()
            writer.commit(shot)
            took_s[i] = time.perf_counter() - before_s
        cpu_s = time.process_time() - cpu_s
        writer.finish("complete")
    return Run("DatasetWriter, fsync a shot", took_s, took_s.sum(), cpu_s)


def show(title: str, runs: list[Run]) -> None:
    headings = ("writer", "frames/s", "ms a shot", "median", "99 %", "max", "CPU ms", "ratio")
    table = Table(*headings, title=title)
    for run in runs:
        table.add_row(*run.row, f"{run.frames_hz / runs[0].frames_hz:.2f}")
    Console(width=100).print(table)


def open_large(parent: Path, n_rows: int) -> None:
    """Open a dataset whose segments are elsewhere, and read all ground truth."""
    model = camera(1360, 1024)
    with tempfile.TemporaryDirectory(dir=parent) as folder:
        path = Path(folder) / "large.h5"
        with h5py.File(path, "w") as file:
            skeleton.create_skeleton(
                file, provenance(model, n_rows), uuid="benchmark", n_rows=n_rows
            )
            segments = plan_segments(path, (), n_rows=n_rows, segment_shots=SEGMENT_SHOTS)
            skeleton.show_segments(file, segments, shape=model.shape, dtype=np.dtype(np.uint16))
            file[schema.SHOT_ID][:] = np.arange(n_rows)
            file[schema.SESSION][:] = 1
            file[f"{schema.TRUTH}/trs_from_cam"][:] = [1, 2, 3, 0, 0, 0, 1]
            file[schema.N_COMMITTED][()] = n_rows
        opened_s = time.perf_counter()
        with Dataset(path) as dataset:
            opened_s = time.perf_counter() - opened_s
            states_s = time.perf_counter()
            n_unchecked = dataset.truth_states.count("unchecked")
            states_s = time.perf_counter() - states_s
        print(
            f"{n_rows} shots, file of {path.stat().st_size / 1e6:.0f} MB: open in"
            f" {1e3 * opened_s:.0f} ms; state of the truth of {n_unchecked} shots in"
            f" {1e3 * states_s:.0f} ms"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shots", type=int, default=200, help="how many are written")
    parser.add_argument("--rows", type=int, default=100_000, help="of the dataset that is opened")
    parser.add_argument("--dir", type=Path, default=None, help="where; a real disk, not memory")
    arguments = parser.parse_args()
    open_large(arguments.dir, arguments.rows)
    model = camera(1360, 1024)
    taken = shots(model, arguments.shots, np.uint16, "Mono12")
    show(
        f"{arguments.shots} shots of 1360 x 1024, Mono12, with mask: 4.2 MB each",
        list(in_turns(taken, model, arguments.dir)),
    )
    show("one shot of 1 MP a second", [one_at_a_time(arguments.dir, 15)])


if __name__ == "__main__":
    main()
