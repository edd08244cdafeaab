"""Times open3d or Mitsuba on a terrain: what ``peers.peer_timings`` starts in their environment.

    python peer_scenes.py {open3d,mitsuba,mitsuba_rays} FOLDER

FOLDER holds heights.npy and, for each view, its rays in scene.json and NAME.npy. Needs numpy and
the peer alone. Prints a line of JSON: seconds by view.
"""

import json
import os
import resource
import sys
import time
from pathlib import Path

import numpy as np

SHADOW_OFFSET_M = 2e-5


def main() -> None:
    name, folder = sys.argv[1], Path(sys.argv[2])
    scene = json.loads((folder / "scene.json").read_text(encoding="utf-8"))
    started = time.perf_counter()
    peer = PEERS[name](*triangles(np.load(folder / "heights.npy"), scene["spacing_m"]), scene)
    build_s = time.perf_counter() - started
    seconds = {}
    for view in scene["views"]:
        image = peer.view(view, np.load(folder / f"{view['name']}.npy"))
        image()  # compiles, and fills caches
        seconds[view["name"]] = float(np.median([image() for _ in range(scene["n"])]))
    peak_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"{name} {peer.version}: built in {build_s:.1f} s, {peak_gb:.1f} GB", file=sys.stderr)
    print(json.dumps(seconds))


def triangles(height_m, spacing_m):
    """Give vertices (n, 3) and faces (m, 3) of the heights; the same split as the renderers'."""
    rows, columns = height_m.shape
    vertices = np.empty((rows, columns, 3), dtype=np.float32)
    vertices[..., 0] = (np.arange(rows) * spacing_m)[:, None]
    vertices[..., 1] = np.arange(columns) * spacing_m
    vertices[..., 2] = height_m
    node = np.arange(rows * columns, dtype=np.uint32).reshape(rows, columns)
    a, b, c, d = node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]
    faces = np.empty((rows - 1, columns - 1, 2, 3), dtype=np.uint32)
    for k, corner in enumerate((a, c, b)):
        faces[..., 0, k] = corner
    for k, corner in enumerate((a, d, c)):
        faces[..., 1, k] = corner
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


class Open3d:
    """Embree as open3d brings it: depth, then shadows, no shading."""

    def __init__(self, vertices, faces, scene):
        import open3d

        self.version = open3d.__version__
        self._tensor = open3d.core.Tensor
        self._lamp = np.float32(scene["lamp_m"])
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=scene["n_threads"])
        self._scene.add_triangles(self._tensor(vertices), self._tensor(faces))
        self._scene.cast_rays(self._tensor(np.float32([[0, 0, 9, 0, 0, -1]])))  # builds the tree

    def view(self, view, directions):
        directions = directions.reshape(-1, 3)
        starts = np.broadcast_to(np.float32(view["eye_m"]), directions.shape)
        rays = self._tensor(np.hstack([starts, directions]))
        hits = self._scene.cast_rays(rays)
        t = hits["t_hit"].numpy()
        seen = np.isfinite(t)
        normals = hits["primitive_normals"].numpy()[seen]
        points = (starts + directions * np.where(seen, t, 0)[:, None])[seen]
        points = points + SHADOW_OFFSET_M * normals * np.sign(normals[:, 2:])
        to_lamp = self._tensor(np.float32(np.hstack([points, self._lamp - points])))

        def image():
            started = time.perf_counter()
            self._scene.cast_rays(rays)
            self._scene.test_occlusions(to_lamp, tnear=0.0, tfar=1.0)
            return time.perf_counter() - started

        return image


class Mitsuba:
    """Mitsuba's own camera and integrators: image with direct light, depth and position."""

    def __init__(self, vertices, faces, scene):
        library = Path(sys.prefix) / "lib" / "libLLVM.so"
        if library.exists():
            os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(library))
        import drjit
        import mitsuba

        mitsuba.set_variant("llvm_ad_mono")
        drjit.set_thread_count(scene["n_threads"])
        self.version = mitsuba.__version__
        self._mi, self._dr = mitsuba, drjit
        self._lamp = scene["lamp_m"]
        properties = mitsuba.Properties()
        properties["bsdf"] = mitsuba.load_dict({"type": "diffuse", "reflectance": 0.5})
        mesh = mitsuba.Mesh("terrain", len(vertices), len(faces), props=properties)
        parameters = mitsuba.traverse(mesh)
        parameters["vertex_positions"] = vertices.ravel()
        parameters["faces"] = faces.ravel()
        parameters.update()
        self._scene = mitsuba.load_dict(
            {
                "type": "scene",
                "integrator": {
                    "type": "aov",
                    "aovs": "depth:depth,position:position",
                    "image": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
                },
                "terrain": mesh,
                "lamp": {"type": "point", "position": self._lamp, "intensity": 8.0},
            }
        )

    def view(self, view, directions):
        rows, columns = directions.shape[:2]
        axes = np.array(view["axes"])  # of the camera, as columns: right, down, ahead
        to_world = np.eye(4)
        to_world[:3] = np.column_stack([-axes[:, 0], -axes[:, 1], axes[:, 2], view["eye_m"]])
        sensor = self._mi.load_dict(
            {
                "type": "perspective",
                "fov": view["fov_deg"],
                "fov_axis": "x",
                "to_world": self._mi.ScalarTransform4f(to_world),
                "near_clip": 0.01,
                "far_clip": 100.0,
                "film": {
                    "type": "hdrfilm",
                    "width": columns,
                    "height": rows,
                    "rfilter": {"type": "box"},
                    "pixel_format": "luminance",
                    "component_format": "float32",
                },
                "sampler": {"type": "independent", "sample_count": 1},
            }
        )

        def image():
            started = time.perf_counter()
            np.array(self._mi.render(self._scene, sensor=sensor, spp=1))
            return time.perf_counter() - started

        return image


class MitsubaRays(Mitsuba):
    """Mitsuba's rays alone, from a table: depth, shadows and Lambert's law."""

    def view(self, view, directions):
        mi, dr = self._mi, self._dr
        eye, lamp = mi.Point3f(view["eye_m"]), mi.Point3f(self._lamp)
        dr.make_opaque(eye, lamp)
        directions = mi.Vector3f(np.ascontiguousarray(directions.reshape(-1, 3).T))
        dr.eval(directions)

        def image():
            started = time.perf_counter()
            rays = mi.Ray3f(eye, directions)
            hits = self._scene.ray_intersect_preliminary(rays, coherent=True)
            seen = hits.is_valid()
            surface = hits.compute_surface_interaction(rays, mi.RayFlags.Minimal)
            start = surface.p + SHADOW_OFFSET_M * surface.n
            way = lamp - start
            is_lit = seen & ~self._scene.ray_test(mi.Ray3f(start, way, 1.0, 0.0, []), seen)
            light = dr.maximum(dr.dot(surface.n, dr.normalize(way)), 0) / dr.squared_norm(way)
            light = dr.select(is_lit, light, 0)
            dr.eval(light, hits.t, surface.p)
            for values in (light, hits.t, surface.p):
                np.array(values)
            return time.perf_counter() - started

        return image


PEERS = {"open3d": Open3d, "mitsuba": Mitsuba, "mitsuba_rays": MitsubaRays}

if __name__ == "__main__":
    main()
