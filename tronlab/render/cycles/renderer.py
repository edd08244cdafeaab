"""Blender's Cycles behind the Protocol: the renderer of the paper (section 3.2).

It runs in a process of its own, in the Python that ``process.blender_python`` finds, which
is started with the first image and keeps the terrain. Cycles finds what rays see and how much of
the lamp, and reflects it; the lamp's cone, the light from everywhere, vignetting and lens
distortion are put on afterwards.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.render.checks import check_lamp, check_pose
from tronlab.render.cycles.lens import Lens
from tronlab.render.cycles.light import offsets_to_lamp, radiance, sees_half_the_lamp
from tronlab.render.cycles.scene import BlenderScene, Passes, Sampling
from tronlab.render.rays import centre_rays
from tronlab.render.renderer import PLAIN, Lamp, RenderError, Rendering
from tronlab.render.settings import RenderSettings
from tronlab.terrain.heightmap import HeightMap

SPHERE_SAMPLES = 32
"""Rays to a lamp that is no point."""
MOST_AREA_SAMPLES = 16


def open_cycles(
    heightmap: HeightMap, *, announce: Callable[[str], None] | None = None
) -> "CyclesRenderer":
    """Make a renderer of a terrain; see ``OpenRenderer``.

    Raises:
        RenderError: Blender is missing, or the terrain does not fit into memory.
    """
    return CyclesRenderer(BlenderScene(heightmap, announce))


class CyclesRenderer:
    """Renders one height map, of Lambert's reflectance only.

    There are always true shadow rays. Where there are several rays a pixel, or a pixel covers more
    than a sample of the terrain and ``prefilter`` asks for its mean, the pixel's area is sampled at
    random, up to 16 times. A lamp with a radius is a luminous sphere that 32 rays look for: inverse
    square and angles are those of its points, not of its centre. Behind a lens with distortion
    light is interpolated between the pixels of a finer image without: from so far that a pixel
    covers many samples, the light at points (one ray, no prefilter) is then no longer that of one.
    """

    def __init__(self, scene: BlenderScene) -> None:
        self._scene = scene

    def render(
        self,
        camera: CameraModel,
        trs_from_cam: RigidTransform,
        lamp: Lamp,
        settings: RenderSettings = PLAIN,
    ) -> Rendering:
        """Render image, depth and points; see ``Renderer``."""
        (rendering,) = self.render_batch(camera, [trs_from_cam], lamp, settings)
        return rendering

    def render_batch(
        self,
        camera: CameraModel,
        trs_from_cams: Sequence[RigidTransform],
        lamp: Lamp,
        settings: RenderSettings = PLAIN,
    ) -> Iterator[Rendering]:
        """Render from many poses; see ``Renderer``."""
        for trs_from_cam in trs_from_cams:
            check_pose(trs_from_cam)
        check_lamp(lamp)
        if settings.photometry.kind != "lambert":
            raise RenderError(
                f"renderer cycles: photometry is {settings.photometry.kind!r}, must be 'lambert',"
                " the only one Cycles has\n"
                "take that, or renderer heightfield, reference or mitsuba"
            )
        lens = Lens(camera)
        with self._scene.hand_over(trs_from_cams) as poses:
            for i_pose, trs_from_cam in enumerate(trs_from_cams):
                look = partial(self._scene.look, poses, i_pose, lens.pinhole, lamp)
                yield self._rendering(look, lens, trs_from_cam, lamp, settings)

    def close(self) -> None:
        """End Blender; another image would start it anew."""
        self._scene.close()

    def _rendering(
        self,
        look: Callable[[Sampling], Passes],
        lens: Lens,
        trs_from_cam: RigidTransform,
        lamp: Lamp,
        settings: RenderSettings,
    ) -> Rendering:
        n_lamp = SPHERE_SAMPLES if lamp.radius_m > 0 else 1
        centre = area = look(Sampling(n_lamp, over_area=False))
        n_area = self._n_area_samples(centre, lens.camera, settings)
        n_pinhole = math.ceil(n_area / lens.n_pixels)
        if n_pinhole > 1:
            area = look(Sampling(max(n_pinhole, n_lamp), over_area=True))
        to_lamp = offsets_to_lamp(centre.depth_m, lens.pinhole, trs_from_cam, lamp)
        image = radiance(area, to_lamp, lamp, ambient=settings.ambient)
        axes = trs_from_cam.rotation.as_matrix()
        depth_m = lens.depth_m(centre.depth_m, centre.facet_normal @ axes.astype(np.float32))
        rays = np.dstack([centre_rays(lens.camera), np.ones(lens.camera.shape)])
        vignetting = np.linalg.norm(rays, axis=-1) ** -settings.vignetting_power
        points_trs_m = trs_from_cam.translation + depth_m[..., None] * (rays @ axes.T)
        return Rendering(
            (lens.radiance(image, over_area=n_area > 1) * vignetting).astype(np.float32),
            depth_m,
            points_trs_m.astype(np.float32),
            lens.mostly(sees_half_the_lamp(centre, to_lamp)),
        )

    def _n_area_samples(self, centre: Passes, camera: CameraModel, settings: RenderSettings) -> int:
        """Give how many samples of a pixel's area an image takes, 1 where its centre will do."""
        n = settings.rays_per_pixel
        is_seen = np.isfinite(centre.depth_m)
        if settings.prefilter and is_seen.any():
            side_m = self._scene.spacing_m * math.sqrt(camera.fx_px * camera.fy_px)
            n_covered = (float(np.median(centre.depth_m[is_seen])) / side_m) ** 2
            n = max(n, min(math.ceil(n_covered), MOST_AREA_SAMPLES))
        return n
