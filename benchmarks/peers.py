"""Other renderers on our terrain and views, in their own environment; for ``render_speed.py``.

    python benchmarks/peers.py --peer-python PYTHON [--every-n 2] [--n 7] [--peer NAME ...]

PYTHON is the interpreter of an environment with open3d and mitsuba (pip install open3d mitsuba
karellen-llvm-core): neither is wanted beside tronlab. Alone, this prints the peers' seconds for the
poses of the figures on the laboratory's model.
"""

import argparse
import json
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.render.rays import centre_rays
from tronlab.render.renderer import Lamp
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.heightmap import HeightMap
from tronlab.terrain.kernels import n_cores
from tronlab.terrain.load import load_terrain

PEERS = ("open3d", "mitsuba", "mitsuba_rays")
"""Embree without shading; Mitsuba with a camera and integrator of its own; Mitsuba's rays from our
table. The integrator is what the figures are about."""
_SCENES = Path(__file__).with_name("peer_scenes.py")


class View(NamedTuple):
    """A camera and where it stands."""

    camera: CameraModel
    trs_from_cam: RigidTransform


def peer_timings(
    name: str,
    heightmap: HeightMap,
    *,
    every_n: int,
    views: Mapping[str, View],
    lamp: Lamp,
    python: Path,
    n: int = 7,
) -> dict[str, float]:
    """Give the median seconds a peer takes for an image, depth and shadows of each view.

    Mitsuba's own camera has neither distortion nor an offset of the principal point. Time to build
    the scene and peak memory go to the standard error.

    Args:
        name: One of ``PEERS``.
        heightmap: The terrain.
        every_n: The peer gets every n-th sample.
        views: What is looked at, by name.
        lamp: A point.
        python: Interpreter that has the peer.
        n: Images of each view, after a first one.
    """
    with tempfile.TemporaryDirectory() as folder:
        _write_scene(Path(folder), heightmap, every_n=every_n, views=views, lamp=lamp, n=n)
        command = [python, _SCENES, name, folder]
        run = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(run.stdout.splitlines()[-1])


def _write_scene(
    folder: Path,
    heightmap: HeightMap,
    *,
    every_n: int,
    views: Mapping[str, View],
    lamp: Lamp,
    n: int,
) -> None:
    """Write what ``peer_scenes.py`` reads; its frame begins at the height map's origin."""
    origin = heightmap.origin_trs_m
    np.save(folder / "heights.npy", np.ascontiguousarray(heightmap.height_m[::every_n, ::every_n]))
    written = []
    for name, (camera, trs_from_cam) in views.items():
        axes = trs_from_cam.rotation.as_matrix()
        rays = np.dstack([centre_rays(camera), np.ones(camera.shape)])
        np.save(folder / f"{name}.npy", np.float32(rays @ axes.T))
        written.append(
            {
                "name": name,
                "eye_m": (trs_from_cam.translation - origin).tolist(),
                "axes": axes.tolist(),
                "fov_deg": float(np.degrees(camera.horizontal_fov_rad)),
            }
        )
    scene = {
        "spacing_m": heightmap.spacing_m * every_n,
        "lamp_m": (lamp.p_trs_m - origin).tolist(),
        "n": n,
        "n_threads": n_cores(),
        "views": written,
    }
    (folder / "scene.json").write_text(json.dumps(scene), encoding="utf-8")


def figures_views(heightmap: HeightMap) -> dict[str, View]:
    """Give the three views of the figures: 1 m nadir, 4 m oblique, 10 m nadir; 1024 x 1024."""
    x, y = heightmap.origin_trs_m[:2] + np.divide(heightmap.size_m, 2)
    z = heightmap.mean_height_trs_m
    wide, narrow = (
        CameraModel(1024, 1024, f, f, 511.5, 511.5)
        for f in 512 / np.tan(np.radians([67 / 2, 35 / 2]))
    )
    down = pose_along_boresight
    slant = np.radians(30)
    ahead = np.array([0, -np.cos(slant), -np.sin(slant)])
    return {
        "1 m nadir": View(wide, down((x, y, z + 1), boresight=(0, 0, -1), right=(0, 1, 0))),
        "4 m oblique": View(wide, down((x, y, z) - 4 * ahead, boresight=ahead, right=(-1, 0, 0))),
        "10 m nadir": View(narrow, down((x, y, z + 10), boresight=(0, 0, -1), right=(0, 1, 0))),
    }


def figures_lamp(heightmap: HeightMap) -> Lamp:
    """Give the lamp of the figures: about 20 degrees above the model's middle."""
    x, y = heightmap.origin_trs_m[:2] + np.divide(heightmap.size_m, 2)
    return Lamp(np.array([x - 2.1, y - 5.1, heightmap.mean_height_trs_m + 1.5]), 20.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--peer-python", type=Path, required=True)
    parser.add_argument("--every-n", type=int, default=2)
    parser.add_argument("--n", type=int, default=7)
    parser.add_argument("--peer", nargs="*", default=PEERS, choices=PEERS)
    arguments = parser.parse_args()
    heightmap = load_terrain(ProceduralTerrain(), base_dir=Path(), announce=print)
    for name in arguments.peer:
        seconds = peer_timings(
            name,
            heightmap,
            every_n=arguments.every_n,
            views=figures_views(heightmap),
            lamp=figures_lamp(heightmap),
            python=arguments.peer_python,
            n=arguments.n,
        )
        print(name, *(f" {view}: {value:.3f} s" for view, value in seconds.items()), flush=True)


if __name__ == "__main__":
    main()
