"""Makes and renders a terrain of 1.6e9 samples, and tells time and memory: prints a table.

    python benchmarks/large_terrain.py --folder FOLDER [--size-m 20] [--spacing-m 0.0005]

FOLDER takes the cache: 6.4 GB of heights and 2.7 GB for the quadtree, to be deleted afterwards.
Each step is a process of its own, watched while it runs: its memory is given as the system counts
it (VmHWM, with the pages of mapped files that happen to be in memory) and without those pages
(RssAnon), which is what the step cannot do without.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

STEPS = ("make", "quadtree", "4 m", "1 m")


def terrain(size_m: float, spacing_m: float):
    from tronlab.terrain.config import ProceduralTerrain

    return ProceduralTerrain(
        size_m=(size_m, size_m), spacing_m=spacing_m, relief_m=0.6, crater_largest_m=2.0
    )


def load(config):
    from tronlab.terrain.load import load_terrain

    return load_terrain(config, base_dir=Path(), announce=lambda text: print("  ", text))


def make(config) -> None:
    start = time.perf_counter()
    load(config)
    print(f"   made in {time.perf_counter() - start:.0f} s, cpu {sum(os.times()[:2]):.0f} s")


def build_quadtree(config) -> None:
    from tronlab.render.quadtree import grid_of

    heightmap = load(config)
    start = time.perf_counter()
    grid_of(heightmap)
    print(f"   built in {time.perf_counter() - start:.1f} s")


def render(config, altitude_m: float) -> None:
    start = time.perf_counter()
    from tronlab.geometry.camera import CameraModel
    from tronlab.geometry.poses import pose_along_boresight
    from tronlab.render.heightfield import HeightfieldRenderer
    from tronlab.render.renderer import Lamp
    from tronlab.render.settings import RenderSettings

    camera = CameraModel(1024, 1024, 773.0, 773.0, 511.5, 511.5, (0.0,) * 5)
    heightmap = load(config)
    renderer = HeightfieldRenderer(heightmap, announce=lambda text: print("  ", text))
    size_m, settings = config.size_m[0], RenderSettings(shadows="rays")
    lamp = Lamp(np.array([-0.2 * size_m, 0.3 * size_m, 0.35 * size_m]), 1.0)
    for name, boresight in (("nadir", (0, 0, -1)), ("oblique", (0.6, 0.2, -0.75))):
        for place in (0.3, 0.55):
            p_trs_m = np.array([place * size_m, place * size_m, altitude_m])
            pose = pose_along_boresight(p_trs_m, boresight=boresight, right=(0, 1, 0))
            times_s = []
            for _ in range(3):
                begin = time.perf_counter()
                rendering = renderer.render(camera, pose, lamp, settings)
                times_s.append(time.perf_counter() - begin)
                if start:
                    print(f"   first image after {time.perf_counter() - start:.2f} s")
                    start = 0.0
            seen = np.isfinite(rendering.depth_m)
            print(
                f"   {name} at {p_trs_m[:2]} m: {times_s[0]:.2f} s, then {min(times_s):.2f} s,"
                f" terrain in {100 * seen.mean():.0f} % of the pixels,"
                f" {100 * rendering.is_lit[seen].mean():.0f} % of it lit"
            )
            _keep(rendering, f"{altitude_m:g}m-{name}-{place}")


def _keep(rendering, name: str) -> None:
    folder = os.environ.get("TRONLAB_PICTURES")
    if folder:
        import cv2

        grey = np.clip(rendering.radiance / np.percentile(rendering.radiance, 99.5), 0, 1)
        cv2.imwrite(f"{folder}/{name}.png", (255 * grey**0.45).astype(np.uint8))


def run_step(step: str, config) -> None:
    if step == "make":
        make(config)
    elif step == "quadtree":
        build_quadtree(config)
    else:
        render(config, float(step.removesuffix(" m")))


def watched(step: str, options: list[str]) -> tuple[float, float]:
    """Run a step in a process of its own.

    Returns:
        Peak of all its memory and of that part that is not mapped from files, GB.
    """
    process = subprocess.Popen([sys.executable, __file__, *options, "--step", step])
    peak_all = peak_anonymous = 0.0
    while process.poll() is None:
        try:
            status = Path(f"/proc/{process.pid}/status").read_text()
        except OSError:
            break
        numbers = {
            key: int(rest.split()[0])
            for key, _, rest in (line.partition(":") for line in status.splitlines())
            if key in {"VmHWM", "RssAnon"}
        }
        peak_all = max(peak_all, numbers.get("VmHWM", 0) / 1e6)
        peak_anonymous = max(peak_anonymous, numbers.get("RssAnon", 0) / 1e6)
        time.sleep(0.02)
    if process.wait():
        raise SystemExit(f"{step}: failed")
    return peak_all, peak_anonymous


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--size-m", type=float, default=20.0)
    parser.add_argument("--spacing-m", type=float, default=0.0005)
    parser.add_argument("--step", choices=STEPS, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    config = terrain(arguments.size_m, arguments.spacing_m)
    os.environ["XDG_CACHE_HOME"] = str(arguments.folder.absolute())
    if arguments.step:
        run_step(arguments.step, config)
        return
    rows, columns = config.shape
    print(
        f"{rows} x {columns} samples: {4e-9 * rows * columns:.1f} GB of heights and"
        f" {1.67e-9 * rows * columns:.1f} GB of quadtree in {arguments.folder}"
    )
    arguments.folder.mkdir(parents=True, exist_ok=True)
    peaks = {}
    for step in STEPS:
        print(step, flush=True)
        peaks[step] = watched(step, sys.argv[1:])
    print(f"{'step':<10} {'peak memory GB':>15} {'not of files GB':>16}")
    for step, (peak_all, peak_anonymous) in peaks.items():
        print(f"{step:<10} {peak_all:>15.2f} {peak_anonymous:>16.2f}")


if __name__ == "__main__":
    main()
