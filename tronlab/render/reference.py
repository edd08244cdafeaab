"""The reference renderer: one ray at a time against the height map, true shadow rays."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray, unit
from tronlab.render.checks import check_lamp, check_pose
from tronlab.render.first_use import announce_first_use
from tronlab.render.lighting import Light, disk_points
from tronlab.render.photometry_kernel import numbers_of
from tronlab.render.quadtree import grid_of
from tronlab.render.raycast import first_hit
from tronlab.render.rays import centre_rays, subpixel_rays
from tronlab.render.reference_kernel import render_rows
from tronlab.render.renderer import PLAIN, Lamp, Rendering
from tronlab.render.settings import RenderSettings
from tronlab.render.shadow_reach import block_shape
from tronlab.render.surface import NO_ALBEDO, cone_numbers
from tronlab.render.view import View
from tronlab.terrain.heightmap import HeightMap
from tronlab.terrain.kernels import n_cores, run_interleaved

_N_LAMPS = 2
"""So many lamps' shadow tables are kept, each a sixteenth of the heights' memory."""


class ReferenceRenderer:
    """Renders one height map as simply as can be; what the fast renderer is held against.

    Whether the lamp is seen from a point is asked by rays from that very point: one to a point
    lamp, 128 to one with a radius (``lighting.disk_points``), which takes some fifty times as long.
    It is as fast for lamps that move as for those that stand.
    The settings ``shadows`` and ``prefilter`` change nothing: there is no map of the lamp's light,
    and the light of a ray is that of the point it meets.
    """

    def __init__(
        self,
        heightmap: HeightMap,
        *,
        announce: Callable[[str], None] | None = None,
        n_threads: int | None = None,
    ) -> None:
        """Build the quadtree.

        Args:
            heightmap: The terrain; between samples its albedo is interpolated bilinearly.
            announce: Is told before kernels are compiled, which takes some seconds, once ever.
            n_threads: Threads to render with; as many as cores without it.
        """
        albedo = heightmap.albedo
        self._albedo = NO_ALBEDO if albedo is None else np.ascontiguousarray(albedo)
        self._origin_trs_m = np.asarray(heightmap.origin_trs_m, dtype=np.float64)
        self._cells_per_m = np.array([1 / heightmap.spacing_m, 1 / heightmap.spacing_m, 1.0])
        self._announce = announce
        self._n_threads = n_threads or n_cores()
        self._shadow_reaches: dict[bytes, NDArray[np.float32]] = {}
        self._grid = grid_of(heightmap)

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
        rendering = Rendering(
            radiance=np.empty(camera.shape, dtype=np.float32),
            depth_m=np.empty(camera.shape, dtype=np.float32),
            points_trs_m=np.empty((*camera.shape, 3), dtype=np.float32),
            is_lit=np.empty(camera.shape, dtype=np.bool_),
        )
        rays = centre_rays(camera)
        subrays = subpixel_rays(camera) if settings.rays_per_pixel == 4 else rays[None][:0]
        announce_first_use(self._announce, render_rows)
        run_interleaved(
            render_rows,
            self._grid,
            self._view(trs_from_cam, settings),
            self._light(lamp, settings),
            rays,
            subrays,
            (rendering.radiance, rendering.depth_m, rendering.points_trs_m, rendering.is_lit),
            n_threads=self._n_threads,
        )
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
            yield self.render(camera, trs_from_cam, lamp, settings)

    def range_along_m(self, p_trs_m: ArrayLike, direction_trs: ArrayLike) -> float:
        """Give the distance from a point to the terrain along a direction.

        Args:
            p_trs_m: Start, shape (3,); outside the model or above its surface.
            direction_trs: Direction, shape (3,), of any length.

        Returns:
            Distance in metres; NaN if the terrain is missed or the point lies below it.

        Raises:
            FrameError: The direction is zero or not finite.
        """
        start = self._in_grid(p_trs_m)
        direction = unit(direction_trs) * self._cells_per_m
        t = first_hit(self._grid, *start, *direction, np.inf, 0)
        return float(t) if t >= 0.0 else float("nan")

    def _in_grid(self, p_trs_m: ArrayLike) -> FloatArray:
        return (np.asarray(p_trs_m, dtype=np.float64) - self._origin_trs_m) * self._cells_per_m

    def _view(self, trs_from_cam: RigidTransform, settings: RenderSettings) -> View:
        rotation = trs_from_cam.rotation.as_matrix()
        return View(
            self._origin_trs_m,
            self._in_grid(trs_from_cam.translation),
            np.ascontiguousarray(self._cells_per_m[:, None] * rotation),
            settings.vignetting_power,
        )

    def _light(self, lamp: Lamp, settings: RenderSettings) -> Light:
        intensity = float(lamp.intensity)
        return Light(
            self._in_grid(lamp.p_trs_m),
            intensity,
            settings.ambient * intensity,
            cone_numbers(lamp.cone),
            disk_points(lamp.radius_m),
            self._shadow_reach(lamp),
            numbers_of(settings.photometry),
            self._albedo,
        )

    def _shadow_reach(self, lamp: Lamp) -> NDArray[np.float32]:
        """Give the lamp's table of shadow reaches, for the lamps used last: they seldom move."""
        if lamp.radius_m > 0:
            return np.empty((0, 0), dtype=np.float32)
        key = np.asarray(lamp.p_trs_m, dtype=np.float64).tobytes()
        table = self._shadow_reaches.pop(key, None)
        if table is None:
            table = np.zeros(block_shape(self._grid), dtype=np.float32)
        self._shadow_reaches[key] = table
        while len(self._shadow_reaches) > _N_LAMPS:
            del self._shadow_reaches[next(iter(self._shadow_reaches))]
        return table
