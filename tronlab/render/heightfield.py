"""The fast renderer: rays followed together by tiles, the lamp's light taken from a map."""

import math
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.render.checks import check_lamp, check_pose
from tronlab.render.first_use import announce_first_use
from tronlab.render.lamp.map import LampMaps
from tronlab.render.lanes.kernel import make_scratch, render_tiles
from tronlab.render.lanes.lookup import map_view
from tronlab.render.lanes.tiles import ray_tiles
from tronlab.render.reference import ReferenceRenderer
from tronlab.render.renderer import PLAIN, Lamp, Rendering
from tronlab.render.settings import RenderSettings
from tronlab.terrain.heightmap import HeightMap
from tronlab.terrain.kernels import run_interleaved

_MOST_PARTS_A_THREAD = 8
"""As ``run_interleaved`` divides the work."""
_FILTER = 0.65
"""Width of the square that a lookup's mean is of, in pixels: what it interpolates between squares
widens it by half."""


class HeightfieldRenderer(ReferenceRenderer):
    """Renders one height map as fast as this machine can.

    What a camera sees is what the reference renderer sees, to a micrometre. The lamp's light is
    worked out for all nodes once (``lamp.map``) and kept for the two lamps used last; where the
    nodes around a point do not agree a ray settles it, or for a lamp with a radius the mean. With
    ``shadows: rays`` shadows are found by rays as in the reference.

    The prefilter takes means over the ground, each part of it alike, not over what of it a slanting
    view shows. Against 64 rays a pixel on the laboratory's model that leaves 4 % of the mean
    radiance (rms) from 4 m above, where one ray without it is 20 % off; at 30 degrees over the
    horizon 11 % (of these 4.5 % too bright in the mean) instead of 29 %; four rays halve it.
    """

    def __init__(
        self,
        heightmap: HeightMap,
        *,
        announce: Callable[[str], None] | None = None,
        n_threads: int | None = None,
    ) -> None:
        """Build the quadtree; arguments and errors as ``ReferenceRenderer``."""
        super().__init__(heightmap, announce=announce, n_threads=n_threads)
        self._lamp_maps = LampMaps(
            self._grid,
            self._origin_trs_m,
            self._albedo,
            fingerprint=heightmap.fingerprint,
            n_threads=self._n_threads,
        )

    def render(
        self,
        camera: CameraModel,
        trs_from_cam: RigidTransform,
        lamp: Lamp,
        settings: RenderSettings = PLAIN,
    ) -> Rendering:
        """Render image, depth and points; see ``Renderer``.

        Raises:
            RenderError: A pose or lamp that cannot be; or the terrain is too large for a map of the
                lamp.
        """
        check_pose(trs_from_cam)
        check_lamp(lamp)
        announce_first_use(self._announce, render_tiles)
        rendering = Rendering(
            radiance=np.empty(camera.shape, dtype=np.float32),
            depth_m=np.empty(camera.shape, dtype=np.float32),
            points_trs_m=np.empty((*camera.shape, 3), dtype=np.float32),
            is_lit=np.empty(camera.shape, dtype=np.bool_),
        )
        is_map = settings.shadows == "map"
        run_interleaved(
            render_tiles,
            self._grid,
            self._view(trs_from_cam, settings),
            self._light(lamp, settings),
            map_view(self._lamp_maps.of(lamp), lamp.radius_m) if is_map else None,
            None if is_map else True,
            ray_tiles(camera, settings.rays_per_pixel),
            _pitch(camera, settings),
            (rendering.radiance, rendering.depth_m, rendering.points_trs_m, rendering.is_lit),
            make_scratch(_MOST_PARTS_A_THREAD * self._n_threads),
            n_threads=self._n_threads,
        )
        return rendering


def _pitch(camera: CameraModel, settings: RenderSettings) -> tuple[float, float]:
    """Give how far rays are apart whose light is averaged over the ground between them."""
    if not settings.prefilter or settings.shadows == "rays":
        return 0.0, 0.0
    per_pixel = math.sqrt(settings.rays_per_pixel)
    return _FILTER / (per_pixel * camera.fx_px), _FILTER / (per_pixel * camera.fy_px)
