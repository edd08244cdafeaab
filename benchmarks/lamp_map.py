"""The lamp map of the laboratory's terrain: time, memory, and how it differs from ray tracing.

    python benchmarks/lamp_map.py [--repeats 7] [--picture FILE.png]

Shadows are compared on every node with a ray to the lamp from just off the surface along the
normal of a triangle at the node. Penumbras are compared on random nodes with rays to 256 points of
the disk that faces the node. Nodes that face away from the lamp are counted as well.
"""

import argparse
import resource
import time
from pathlib import Path

import numpy as np

from tronlab.render.lamp.map import LampMaps
from tronlab.render.lamp.prefilter import make_pyramid
from tronlab.render.lamp.sweep import sweep
from tronlab.render.lighting import SHADOW_OFFSET_M
from tronlab.render.quadtree import make_grid
from tronlab.render.raycast import MISSED, first_hit
from tronlab.render.renderer import Lamp
from tronlab.render.surface import NO_ALBEDO, facet_normal
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.kernels import kernel, n_cores, run_interleaved
from tronlab.terrain.load import load_terrain

LAMPS_TRS_M = {
    "rig": (-3.0, -2.5, 3.5),
    "over": (1.1, 2.1, 2.0),
    "low": (-1.0, 2.0, 0.4),
    "low over": (0.5, 1.0, 0.5),
}
LEVEL = np.int64(1)
N_NODES = 20000


@kernel
def trace_nodes(grid, lamp, points, nodes, shares, part, n_parts):  # noqa: PLR0917
    """Give the share of points around the lamp, as (across, up) in metres, that nodes see."""
    for n in range(part, nodes.shape[0], n_parts):
        i, j = nodes[n, 0], nodes[n, 1]
        normal_x, normal_y, normal_z = facet_normal(grid, float(i), float(j))
        r = i + normal_x * SHADOW_OFFSET_M / grid.spacing_m
        c = j + normal_y * SHADOW_OFFSET_M / grid.spacing_m
        z = grid.height_m[i, j] + normal_z * SHADOW_OFFSET_M
        x, y = (lamp[0] - r) * grid.spacing_m, (lamp[1] - c) * grid.spacing_m
        rise = lamp[2] - z
        level = max(np.hypot(x, y), 1e-9)
        away = np.hypot(level, rise)
        n_seen = 0
        for k in range(points.shape[0]):
            across, up = points[k, 0], points[k, 1]
            to_x = x - across * y / level - up * x / level * rise / away
            to_y = y + across * x / level - up * y / level * rise / away
            to_z = rise + up * level / away
            dr, dc = to_x / grid.spacing_m, to_y / grid.spacing_m
            if first_hit(grid, r, c, z, dr, dc, to_z, 1.0, LEVEL) == MISSED:
                n_seen += 1
        shares[n] = n_seen / points.shape[0]


def traced(grid, lamp, points, nodes):
    shares = np.empty(len(nodes))
    run_interleaved(trace_nodes, grid, lamp, points, nodes, shares, n_threads=n_cores())
    return shares


def disk_points(n, radius_m):
    """Points spread evenly over a disk (Vogel, Mathematical Biosciences 44, 1979)."""
    k = np.arange(n) + 0.5
    angle = k * np.pi * (3 - np.sqrt(5))
    return radius_m * np.sqrt(k / n)[:, None] * np.c_[np.cos(angle), np.sin(angle)]


def times_of(n_repeats, function):
    times = []
    for _ in range(n_repeats):
        started = time.perf_counter(), time.process_time()
        function()
        times.append((time.perf_counter() - started[0], time.process_time() - started[1]))
    wall_s, processor_s = np.median(times, axis=0)
    return f"{wall_s:.2f} s, processor {processor_s:.2f} s"


def compare_shadows(n_repeats, name, grid, lamp, visibility):
    text = times_of(n_repeats, lambda: sweep(grid, lamp, 0.0, visibility, n_threads=n_cores()))
    point = np.zeros((1, 2))
    differs = np.empty(visibility.shape, dtype=bool)
    started = time.process_time()
    columns = np.arange(visibility.shape[1])
    for top in range(0, visibility.shape[0], 100):
        rows = np.arange(top, min(top + 100, visibility.shape[0]))
        nodes = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
        seen = traced(grid, lamp, point, nodes).reshape(len(rows), -1) > 0
        differs[rows] = seen != (visibility[rows] > 0)
    print(
        f"{name:8s} {text}; lit {np.mean(visibility > 0):.1%}, differs {differs.mean():.4%}"
        f" of nodes from ray tracing (processor {time.process_time() - started:.1f} s)",
        flush=True,
    )
    return differs


def compare_penumbra(n_repeats, name, grid, lamp, radius_m, visibility):  # noqa: PLR0917
    text = times_of(n_repeats, lambda: sweep(grid, lamp, radius_m, visibility, n_threads=n_cores()))
    nodes = np.random.default_rng(0).integers(0, visibility.shape, size=(N_NODES, 2))
    expected = traced(grid, lamp, disk_points(256, radius_m), nodes)
    error = np.abs(visibility[nodes[:, 0], nodes[:, 1]] / 255 - expected)
    is_penumbra = (expected > 0) & (expected < 1)
    print(
        f"{name:8s} radius {radius_m * 100:.0f} cm: {text}; mean error {error.mean():.5f},"
        f" in the penumbra ({is_penumbra.mean():.2%} of nodes) {error[is_penumbra].mean():.4f}",
        flush=True,
    )


def draw(path, visibility, differs):
    import cv2

    share = cv2.resize(visibility, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    wrong = cv2.resize(differs.astype(np.float32), share.shape[::-1], interpolation=cv2.INTER_AREA)
    picture = np.dstack([share, share, share]).astype(np.float32)
    picture += np.float32([-1, -1, 1]) * 4 * 255 * wrong[..., None]
    cv2.imwrite(str(path), np.clip(picture, 0, 255).astype(np.uint8))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--picture", type=Path, help="map of the rig's lamp, differences in red")
    arguments = parser.parse_args()
    config = ProceduralTerrain()
    heightmap = load_terrain(config, base_dir=Path(), announce=print)
    grid = make_grid(np.ascontiguousarray(heightmap.height_m), heightmap.spacing_m)
    print(f"{heightmap.height_m.shape} samples, {n_cores()} threads, median of {arguments.repeats}")
    per_m = np.array([1 / heightmap.spacing_m, 1 / heightmap.spacing_m, 1.0])
    lamps = {
        name: (np.array(p) - heightmap.origin_trs_m) * per_m for name, p in LAMPS_TRS_M.items()
    }
    visibility = np.empty(heightmap.height_m.shape, dtype=np.uint8)

    def make_all() -> None:
        maps = LampMaps(grid, heightmap.origin_trs_m)
        maps.of(Lamp(np.array(LAMPS_TRS_M["rig"]), 1.0))

    make_all()
    print(f"map and pyramid: {times_of(arguments.repeats, make_all)}")
    rig = lamps["rig"]
    print(
        "pyramid alone: "
        + times_of(
            arguments.repeats,
            lambda: make_pyramid(grid, visibility, NO_ALBEDO, rig, n_threads=n_cores()),
        )
    )
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory with heights, quadtrees, map and pyramid: {peak_mb:.0f} MB", flush=True)
    for name, lamp in lamps.items():
        differs = compare_shadows(arguments.repeats, name, grid, lamp, visibility)
        if name == "rig" and arguments.picture:
            draw(arguments.picture, visibility, differs)
    sweep(grid, rig, 0.1, visibility, n_threads=n_cores())  # compiles
    for name in ("rig", "low over"):
        for radius_m in (0.02, 0.1):
            compare_penumbra(arguments.repeats, name, grid, lamps[name], radius_m, visibility)


if __name__ == "__main__":
    main()
