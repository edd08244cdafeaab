"""Compiles the kernels before the tests begin: else every worker would, at once."""

import numpy as np

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.nav.matching import load_kernels
from tronlab.nav.settings import MatchingSettings
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.reference import ReferenceRenderer
from tronlab.render.renderer import Lamp
from tronlab.render.settings import RenderSettings
from tronlab.terrain.heightmap import HeightMap

CAMERA = CameraModel(16, 16, 12.0, 12.0, 7.5, 7.5)
POSE = pose_along_boresight((0.5, 0.5, 2.0), boresight=(0, 0, -1), right=(0, 1, 0))


def main() -> None:
    load_kernels(MatchingSettings(method="hashing"))
    load_kernels(MatchingSettings(method="exact"))
    heights = np.random.default_rng(1).random((64, 64)) * 0.05
    heightmap = HeightMap(heights.astype(np.float32), 0.016, np.zeros(3))
    fast, reference = HeightfieldRenderer(heightmap, announce=print), ReferenceRenderer(heightmap)
    for radius_m in (0.0, 0.05):
        lamp = Lamp(np.array([-1.0, -1.0, 2.0]), 1.0, radius_m=radius_m)
        for renderer in (fast, reference):
            renderer.render(CAMERA, POSE, lamp, RenderSettings(rays_per_pixel=4))
        fast.render(CAMERA, POSE, lamp, RenderSettings(shadows="rays"))


if __name__ == "__main__":
    main()
