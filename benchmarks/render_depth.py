"""Depth and shadows of our renderers beside Embree's, and the time of all: prints a table.

    python benchmarks/render_depth.py [--full]

The comparison runs on a terrain of 0.9 x 1.2 m, 601 x 801 samples, whose triangles Embree holds in
one piece. With --full, ours are also timed on the laboratory's model, 4401 x 8401 samples.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.rays import centre_rays, subpixel_rays
from tronlab.render.reference import ReferenceRenderer
from tronlab.render.renderer import Lamp
from tronlab.render.settings import RenderSettings
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.heightmap import HeightMap
from tronlab.terrain.load import load_terrain
from tronlab.terrain.procedural import make_terrain

CAMERA = CameraModel(1024, 1024, 760.0, 761.0, 515.0, 508.0, (-0.12, 0.05, 3e-4, -2e-4, 0.0))
SHADOW_OFFSET_M = 2e-5
RENDERERS = (ReferenceRenderer, HeightfieldRenderer)
POSES = {
    "nadir": ((0.45, 0.6, 0.8), (0, 0, -1), (0, 1, 0)),
    "oblique": ((-0.3, 0.5, 0.5), (0.8, 0.1, -0.6), (0, 1, 0)),
    "grazing": ((0.45, -0.2, 0.18), (0.1, 1, -0.25), (1, 0, 0)),
}


def small_terrain() -> HeightMap:
    config = ProceduralTerrain(
        size_m=(0.9, 1.2), spacing_m=0.0015, relief_m=0.09, origin_trs_m=(0, 0, 0)
    )
    return HeightMap(make_terrain(config), config.spacing_m, np.zeros(3))


def embree_scene(heightmap: HeightMap) -> tuple[EmbreeScene, TriangleMesh]:
    rows, columns = heightmap.height_m.shape
    x, y = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    vertices = np.stack(
        [x * heightmap.spacing_m, y * heightmap.spacing_m, heightmap.height_m], axis=-1
    )
    node = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]
    faces = np.stack([np.stack([a, c, b], -1), np.stack([a, d, c], -1)], axis=-2)
    scene = EmbreeScene()
    mesh = TriangleMesh(
        scene, vertices.reshape(-1, 3).astype(np.float32), faces.reshape(-1, 3).astype(np.int32)
    )
    return scene, mesh


def rays_of(position_m, directions):
    starts = np.broadcast_to(np.float32(position_m), directions.shape)
    return np.ascontiguousarray(starts), directions.astype(np.float32)


def compare(name, heightmap, renderer, scene, lamp):
    position_m, boresight, right = POSES[name]
    pose = pose_along_boresight(position_m, boresight=boresight, right=right)
    rendering = renderer.render(CAMERA, pose, lamp)
    started = time.perf_counter()
    renderer.render(CAMERA, pose, lamp)
    own_s = time.perf_counter() - started

    rays = np.dstack([centre_rays(CAMERA), np.ones(CAMERA.shape)]).reshape(-1, 3)
    directions = rays @ pose.rotation.as_matrix().T
    started = time.perf_counter()
    hits = scene.run(*rays_of(position_m, directions), query="INTERSECT", output=True)
    embree_s = time.perf_counter() - started
    normals = np.where(hits["primID"][:, None] >= 0, hits["Ng"], 1.0).astype(np.float64)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    is_seen = (hits["primID"] >= 0) & (np.sum(normals * directions, axis=1) < 0)
    depth = rendering.depth_m.ravel().astype(np.float64)
    both = is_seen & np.isfinite(depth)
    error = np.abs(depth - hits["tfar"])[both]

    points = np.array(position_m) + depth[both, None] * directions[both]
    starts = points + SHADOW_OFFSET_M * normals[both]
    shadow = scene.run(
        starts.astype(np.float32), (lamp.p_trs_m - starts).astype(np.float32), query="OCCLUDED"
    )
    # Where the smooth normal faces away a pixel is dark without a shadow: not Embree's to say.
    is_lit = rendering.is_lit.ravel()[both]
    cos_facet = np.sum(normals[both] * (lamp.p_trs_m - points), axis=1)
    is_facing = smooth_facing(heightmap, points, lamp) & (cos_facet > 0)
    differs = np.count_nonzero(is_lit != (np.asarray(shadow) == -1) & is_facing)
    print(
        f"{type(renderer).__name__:19s} {name:8s} seen {both.mean():5.1%}"
        f"  hit/miss differs {np.sum(is_seen != np.isfinite(depth)):3d}"
        f"  depth p50 {np.quantile(error, 0.5) * 1e6:.2f}"
        f" p99.9 {np.quantile(error, 0.999) * 1e6:.2f}"
        f" max {error.max() * 1e6:.2f} um  shadow differs {differs / depth.size:.4%}"
        f"  lit {is_lit.mean():.1%}  {own_s:.3f} s (Embree, depth alone, {embree_s:.3f} s)"
    )


def smooth_facing(heightmap, points, lamp):
    from scipy.ndimage import map_coordinates

    place = points[:, :2].T / heightmap.spacing_m
    slopes = np.gradient(heightmap.height_m.astype(np.float64), heightmap.spacing_m)
    x, y = (map_coordinates(slope, place, order=1, mode="nearest") for slope in slopes)
    to_lamp = lamp.p_trs_m - points
    return to_lamp[:, 2] - x * to_lamp[:, 0] - y * to_lamp[:, 1] > 0


def time_the_laboratorys_model() -> None:
    heightmap = load_terrain(ProceduralTerrain(), base_dir=Path(), announce=print)
    lamp = Lamp(np.array([-2.5, -1.5, 2.5]), 8.0)
    started = time.perf_counter()
    centre_rays(CAMERA), subpixel_rays(CAMERA)
    print(f"ray tables, once a camera: {time.perf_counter() - started:.2f} s")
    for make in RENDERERS:
        time_renderer(make(heightmap), lamp)


def time_renderer(renderer, lamp) -> None:
    for distance_m in (4.0, 2.0, 1.0):
        pose = pose_along_boresight((1.08, 2.08, distance_m), boresight=(0, 0, -1), right=(0, 1, 0))
        for rays_per_pixel in (1, 4):
            settings = RenderSettings(rays_per_pixel=rays_per_pixel)
            renderer.render(CAMERA, pose, lamp, settings)
            times = []
            for _ in range(5):
                started = time.perf_counter(), time.process_time()
                renderer.render(CAMERA, pose, lamp, settings)
                times.append((time.perf_counter() - started[0], time.process_time() - started[1]))
            wall_s, processor_s = np.min(times, axis=0)
            print(
                f"{type(renderer).__name__}, {distance_m:.0f} m, {rays_per_pixel} rays a pixel:"
                f" best {wall_s:.3f} s, processor {processor_s:.3f} s"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--full", action="store_true", help="time the laboratory's model as well")
    arguments = parser.parse_args()
    heightmap = small_terrain()
    scene, mesh = embree_scene(heightmap)
    lamp = Lamp(np.array([-0.9, -0.6, 0.9]), 1.0)
    for make in RENDERERS:
        renderer = make(heightmap)
        for name in POSES:
            compare(name, heightmap, renderer, scene, lamp)
    del mesh
    if arguments.full:
        time_the_laboratorys_model()


if __name__ == "__main__":
    main()
