"""Re-scoring as a person does it: everything new, pose settings changed, nothing changed.

    python benchmarks/rescore.py DATASET [--shots 289] [--workers 2]
                                 [--folder DIR]

DATASET is a recorded one, as ``tronlab run campaigns/straight_line.yaml`` makes it. If it has fewer
shots than asked for, they are repeated with other noise of one grey value, so that no image is
there twice. Each step is the command ``tronlab score`` in a process of its own, with a cache folder
of its own that is empty at the beginning: cold; the same again; other pose settings; the same
again; and one that is killed half way through and goes on. Prints how long each took on the wall
and in CPU time of all its processes, against the cold one, and checks that what was kept gives the
same rows as what is new.

What is asked for, two cores on two processors: at most 240 s cold, 15 s when only pose settings
changed, 5 s when nothing changed.
"""

import argparse
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table

from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import ShotRecord
from tronlab.dataset.writer import DatasetWriter

CORES = ("akaze-refined", "brisk-refined")
SWEEP = "cores:\n" + "".join(
    f"  {core}: {{settings: {{pose: {{gate_px: 5.0}}}}}}\n" for core in CORES
)


@dataclass(frozen=True, slots=True)
class Taken:
    """How long a command took."""

    wall_s: float
    cpu_s: float


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--shots", type=int, default=289)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="keep everything there")
    arguments = parser.parse_args()
    with TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        dataset = folder / "dataset.h5"
        if not dataset.exists():
            repeat_shots(arguments.dataset, dataset, arguments.shots)
        show(measure(dataset, folder, n_workers=arguments.workers))


def repeat_shots(source: Path, target: Path, n_shots: int) -> None:
    """Write a dataset of so many shots, those of another over and over."""
    with Dataset(source) as dataset:
        provenance = replace(dataset.provenance, n_shots_planned=n_shots)
        with DatasetWriter(target, provenance) as writer:
            writer.add_references(dataset.references())
            for i in range(n_shots):
                writer.commit(_noisy(dataset.shot(i % dataset.n_shots), i))
            writer.finish("complete")


def measure(dataset: Path, folder: Path, *, n_workers: int) -> dict[str, Taken]:
    """Score a dataset again and again; give how long each time took."""
    named = [argument for core in CORES for argument in ("--core", core)]
    sweep = folder / "sweep.yaml"
    sweep.write_text(SWEEP)
    changed = ["--sweep", str(sweep)]

    def score(name: str, cores: Sequence[str], *, cache: str = "cache", **more: float) -> Taken:
        arguments = [str(dataset), *cores, "--workers", str(n_workers)]
        took = run([*arguments, "--out", str(folder / name)], folder / cache, **more)
        print(f"{name}: {took.wall_s:.1f} s, CPU {took.cpu_s:.1f} s", flush=True)
        return took

    taken = {
        "cold": score("cold", named),
        "nothing changed": score("same", named),
        "pose settings changed": score("pose", changed),
        "nothing changed, again": score("pose-again", changed),
    }
    taken["killed half way"] = score(
        "killed", named, cache="second", kill_after_s=taken["cold"].wall_s / 2
    )
    taken["going on after that"] = score("killed", named, cache="second")
    check_same(folder / "cold", folder / "same", but=())
    check_same(folder / "pose", folder / "pose-again", but=())
    times = ("time_detect_s", "time_match_s", "time_pose_s")
    check_same(folder / "cold", folder / "killed", but=times)
    return taken


def run(arguments: Sequence[str], cache: Path, *, kill_after_s: float | None = None) -> Taken:
    """Run ``tronlab score``; as a person's Ctrl-C would not, kill it after a while if told to."""
    command = [sys.executable, "-c", "from tronlab.cli import main; main()", "score"]
    before_s, start_s = _children_cpu_s(), time.perf_counter()
    child = subprocess.Popen(
        [*command, *arguments],
        env=os.environ | {"XDG_CACHE_HOME": str(cache)},
        stdout=subprocess.DEVNULL,
    )
    try:
        child.wait(kill_after_s)
    except subprocess.TimeoutExpired:
        child.send_signal(signal.SIGKILL)
        child.wait()
    else:
        if child.returncode:
            raise SystemExit(f"tronlab score {' '.join(arguments)}: {child.returncode}")
    return Taken(time.perf_counter() - start_s, _children_cpu_s() - before_s)


def check_same(one: Path, other: Path, *, but: Sequence[str]) -> None:
    """See that two scorings have the same rows."""
    rows = (pd.read_csv(folder / "scores.csv", dtype=str) for folder in (one, other))
    pd.testing.assert_frame_equal(*(table.drop(columns=list(but)) for table in rows))


def show(taken: dict[str, Taken]) -> None:
    """Print the times."""
    table = Table("", "wall [s]", "CPU [s]", "of cold")
    cold_s = taken["cold"].wall_s
    for name, each in taken.items():
        table.add_row(
            name, f"{each.wall_s:.1f}", f"{each.cpu_s:.1f}", f"{100 * each.wall_s / cold_s:.1f} %"
        )
    Console().print(table)


def _noisy(shot: ShotRecord, i: int) -> ShotRecord:
    noise = np.random.default_rng(i).normal(0.0, 1.0, shot.frame.image.shape)
    most = np.iinfo(shot.frame.image.dtype).max
    image = np.clip(np.rint(shot.frame.image + noise), 0, most).astype(shot.frame.image.dtype)
    return replace(shot, shot_id=i, attempt=1, frame=replace(shot.frame, image=image), session=1)


def _children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
