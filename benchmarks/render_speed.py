"""Seconds an image takes, beside other renderers: prints a table and the ratios asked for.

    python benchmarks/render_speed.py [--peer-python PYTHON] [--n 7]

The laboratory's model with all its samples, 1024 x 1024 pixels, image, depth, points and shadows.
With --peer-python, the interpreter of an environment with open3d and mitsuba (see ``peers.py``),
these are timed in the same run on every second sample. First of all a new process renders one
image. The last line guards the vector instructions of the lanes: without them the ratio halves.
"""

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from peers import figures_lamp, figures_views, peer_timings

from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.rays import centre_rays
from tronlab.render.reference import ReferenceRenderer
from tronlab.render.settings import RenderSettings
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.heightmap import HeightMap
from tronlab.terrain.load import load_terrain

WAYS = {
    "lamp map": RenderSettings(),
    "lamp map, no prefilter": RenderSettings(prefilter=False),
    "lamp map, Hapke": RenderSettings.model_validate({"photometry": "hapke"}),
    "lamp map, four rays": RenderSettings(rays_per_pixel=4),
    "shadow rays": RenderSettings(shadows="rays"),
}
Seconds = dict[str, dict[str, float]]
"""Wall seconds by way and view."""


def median_seconds(render: Callable[[], object], n: int) -> tuple[float, float]:
    """Give the medians of wall and processor time, after a first call."""
    render()
    times = []
    for _ in range(n):
        started = time.perf_counter(), time.process_time()
        render()
        times.append((time.perf_counter() - started[0], time.process_time() - started[1]))
    wall_s, processor_s = np.median(times, axis=0)
    return float(wall_s), float(processor_s)


def render_first_image() -> None:
    """Render as a new process does, and tell what takes how long."""
    steps = {}
    before = time.perf_counter()

    def mark(name: str) -> None:
        nonlocal before
        steps[name], before = time.perf_counter() - before, time.perf_counter()

    heightmap = load_terrain(ProceduralTerrain(), base_dir=Path(), announce=print)
    mark("terrain")
    renderer = HeightfieldRenderer(heightmap, announce=print)
    mark("quadtree")
    view = figures_views(heightmap)["1 m nadir"]
    centre_rays(view.camera)
    mark("rays")
    renderer.render(view.camera, view.trs_from_cam, figures_lamp(heightmap))
    mark("lamp map and image")
    print(
        f"first image {sum(steps.values()):.2f} s:",
        ", ".join(f"{name} {seconds:.2f}" for name, seconds in steps.items()),
        f"; peak {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB",
    )


def time_a_new_process() -> None:
    started = time.perf_counter()
    subprocess.run([sys.executable, __file__, "--first-image"], check=True)
    print(f"with imports {time.perf_counter() - started:.2f} s", flush=True)


def time_ours(heightmap: HeightMap, n: int) -> tuple[Seconds, float]:
    """Give seconds, and how many times the lanes are faster than single rays."""
    lamp, views = figures_lamp(heightmap), figures_views(heightmap)
    fast, reference = HeightfieldRenderer(heightmap, announce=print), ReferenceRenderer(heightmap)
    seconds: Seconds = {}
    processor: Seconds = {}
    ways = {name: (fast, settings) for name, settings in WAYS.items()}
    ways["reference"] = (reference, RenderSettings())
    for name, (renderer, settings) in ways.items():
        seconds[name], processor[name] = {}, {}
        for view_name, view in views.items():
            seconds[name][view_name], processor[name][view_name] = median_seconds(
                lambda r=renderer, v=view, s=settings: r.render(v.camera, v.trs_from_cam, lamp, s),
                n,
            )
        print_row(name, seconds[name], processor[name])
    gain = [
        processor["reference"][view] / processor["lamp map, no prefilter"][view] for view in views
    ]
    return seconds, min(gain)


def print_row(name: str, seconds: dict[str, float], processor: dict[str, float] | None = None):
    cells = [
        f"{view} {value:.3f} s" + (f" (processor {processor[view]:.3f})" if processor else "")
        for view, value in seconds.items()
    ]
    print(f"{name:24s}", "   ".join(cells), flush=True)


def print_ratios(seconds: Seconds) -> None:
    def ratio(a: str, b: str) -> str:
        return "  ".join(f"{seconds[a][v] / seconds[b][v]:.3f}" for v in seconds[a])

    print(
        "four rays to one (at most 4):                   ", ratio("lamp map, four rays", "lamp map")
    )
    if "mitsuba" in seconds:
        print("lamp map to Mitsuba (at most 0.125, 0.25, 0.25):", ratio("lamp map", "mitsuba"))
        print("shadow rays to open3d (at most 1):              ", ratio("shadow rays", "open3d"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--peer-python", type=Path, help="has open3d and mitsuba")
    parser.add_argument("--n", type=int, default=7, help="images of each kind")
    parser.add_argument("--first-image", action="store_true", help="only that")
    arguments = parser.parse_args()
    if arguments.first_image:
        render_first_image()
        return
    time_a_new_process()
    heightmap = load_terrain(ProceduralTerrain(), base_dir=Path(), announce=print)
    seconds, gain = time_ours(heightmap, arguments.n)
    for name in ("open3d", "mitsuba") if arguments.peer_python else ():
        seconds[name] = peer_timings(
            name,
            heightmap,
            every_n=2,
            views=figures_views(heightmap),
            lamp=figures_lamp(heightmap),
            python=arguments.peer_python,
            n=arguments.n,
        )
        print_row(name, seconds[name])
    print_ratios(seconds)
    print(f"single rays to lanes, processor time (at least 2): {gain:.2f}")


if __name__ == "__main__":
    main()
