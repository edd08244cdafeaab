"""Mitsuba 3 behind the Protocol: another's meeting of rays and triangles, to hold ours against.

Rays come from our table, so that lens distortion is exact; Mitsuba finds where they and the rays to
the lamp meet the terrain's triangles (Embree within it, single precision). What the light does
there is written anew with Dr.Jit's arrays.
"""

from collections.abc import Callable, Iterator, Sequence
from threading import Lock

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.render.checks import check_lamp, check_pose
from tronlab.render.mitsuba.backend import Backend, load_backend
from tronlab.render.mitsuba.light import light_on
from tronlab.render.mitsuba.scene import TerrainScene, check_terrain_fits
from tronlab.render.rays import centre_rays, subpixel_rays
from tronlab.render.renderer import PLAIN, Lamp, Rendering
from tronlab.render.settings import RenderSettings
from tronlab.terrain.heightmap import HeightMap

# Dr.Jit keeps its memory and the code it has compiled for the whole process.
_lock = Lock()


def open_mitsuba(
    heightmap: HeightMap, *, announce: Callable[[str], None] | None = None
) -> "MitsubaRenderer":
    """Make a renderer of a terrain; see ``OpenRenderer``.

    Raises:
        RenderError: Mitsuba or LLVM's library is missing, or the terrain does not fit into memory.
    """
    backend = load_backend()
    size = check_terrain_fits(heightmap)
    if announce is not None:
        announce(size)
    with _lock:
        return MitsubaRenderer(backend, TerrainScene(backend, heightmap))


class MitsubaRenderer:
    """Renders one height map.

    There are always true shadow rays and no prefilter. A lamp with a radius is looked for at 32
    points of its disk, so that the share of it that a ray's point sees comes in steps of 1/32.
    """

    def __init__(self, backend: Backend, terrain: TerrainScene) -> None:
        self._backend = backend
        self._terrain = terrain

    def render(
        self,
        camera: CameraModel,
        trs_from_cam: RigidTransform,
        lamp: Lamp,
        settings: RenderSettings = PLAIN,
    ) -> Rendering:
        """Render image, depth and points; see ``Renderer``."""
        check_pose(trs_from_cam)
        check_lamp(lamp)
        with _lock:
            centre = self._look(centre_rays(camera), trs_from_cam, lamp, settings)
            radiance = centre.radiance
            if settings.rays_per_pixel > 1:
                subrays = subpixel_rays(camera)
                looks = [self._look(rays, trs_from_cam, lamp, settings) for rays in subrays]
                radiance = np.mean([look.radiance for look in looks], axis=0)
        return Rendering(radiance, centre.depth_m, centre.points_trs_m, centre.is_lit)

    def render_batch(
        self,
        camera: CameraModel,
        trs_from_cams: Sequence[RigidTransform],
        lamp: Lamp,
        settings: RenderSettings = PLAIN,
    ) -> Iterator[Rendering]:
        """Render from many poses; see ``Renderer``."""
        for trs_from_cam in trs_from_cams:
            yield self.render(camera, trs_from_cam, lamp, settings)

    def _look(
        self,
        rays: FloatArray,
        trs_from_cam: RigidTransform,
        lamp: Lamp,
        settings: RenderSettings,
    ) -> Rendering:
        """Render with one ray a pixel; rays of shape (rows, columns, 2)."""
        backend, terrain = self._backend, self._terrain
        mi, dr = backend
        eye = backend.point(trs_from_cam.translation - terrain.origin_trs_m)
        x, y, z = (backend.vector(axis) for axis in trs_from_cam.rotation.as_matrix().T)
        xy = np.asarray(rays, dtype=np.float32).reshape(-1, 2).T
        directions = x * mi.Float(xy[0]) + y * mi.Float(xy[1]) + z
        hits = terrain.hits(mi.Ray3f(eye, directions))
        light = light_on(backend, terrain, hits, lamp, settings.photometry)
        radiance = light.radiance
        if settings.ambient > 0:
            ambient = backend.number(settings.ambient * lamp.intensity) * hits.albedo
            radiance += dr.select(hits.is_seen, ambient, 0)
        if settings.vignetting_power > 0:
            radiance *= dr.power(dr.rcp(dr.norm(directions)), settings.vignetting_power)
        depth = dr.select(hits.is_seen, hits.depth, dr.nan)
        points = dr.select(hits.is_seen, hits.p, dr.nan)
        dr.eval(radiance, light.is_lit, depth, points)
        shape = rays.shape[:2]
        points_trs_m = points.numpy().T.astype(np.float64) + terrain.origin_trs_m
        return Rendering(
            radiance.numpy().reshape(shape),
            depth.numpy().reshape(shape),
            points_trs_m.astype(np.float32).reshape(*shape, 3),
            light.is_lit.numpy().reshape(shape),
        )
