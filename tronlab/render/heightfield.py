"""The reference renderer: one ray at a time against the height map, a true shadow ray each."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray, unit
from tronlab.render import raycast
from tronlab.render.quadtree import make_grid
from tronlab.render.rays import centre_rays, subpixel_rays
from tronlab.render.renderer import (
    Lamp,
    Photometry,
    RaysPerPixel,
    RenderError,
    Rendering,
)
from tronlab.terrain.heightmap import HeightMap
from tronlab.terrain.kernels import n_cores, run_interleaved

_PHOTOMETRY = {"lambert": raycast.LAMBERT, "lunar_lambert": raycast.LUNAR_LAMBERT}
_N_LAMPS = 2
"""So many lamps' shadow tables are kept, each a sixteenth of the heights' memory."""


class HeightfieldRenderer:
    """Renders one height map; keeps its quadtree."""

    def __init__(self, heightmap: HeightMap, *, n_threads: int | None = None) -> None:
        self._origin_trs_m = np.asarray(heightmap.origin_trs_m, dtype=np.float64)
        self._cells_per_m = np.array([1 / heightmap.spacing_m, 1 / heightmap.spacing_m, 1.0])
        self._n_threads = n_threads or n_cores()
        self._shadow_reaches: dict[bytes, NDArray[np.float32]] = {}
        self._grid = make_grid(np.ascontiguousarray(heightmap.height_m), heightmap.spacing_m)

    def render(
        self,
        camera: CameraModel,
        trs_from_cam: RigidTransform,
        lamp: Lamp,
        *,
        photometry: Photometry = "lambert",
        rays_per_pixel: RaysPerPixel = 1,
    ) -> Rendering:
        """Render image, depth and points; see ``Renderer``.

        Raises:
            RenderError: An unknown photometric function, not 1 or 4 rays, or a pose or lamp that is
                not finite.
        """
        view = self._view(trs_from_cam, lamp, photometry)
        if rays_per_pixel not in {1, 4}:
            raise RenderError(f"rays_per_pixel is {rays_per_pixel}, must be 1 or 4")
        rendering = Rendering(
            radiance=np.empty(camera.shape, dtype=np.float32),
            depth_m=np.empty(camera.shape, dtype=np.float32),
            points_trs_m=np.empty((*camera.shape, 3), dtype=np.float32),
            is_lit=np.empty(camera.shape, dtype=np.bool_),
        )
        rays = centre_rays(camera)
        subrays = subpixel_rays(camera) if rays_per_pixel == 4 else rays[None][:0]
        run_interleaved(
            raycast.render_strips,
            self._grid,
            view,
            rays,
            subrays,
            (rendering.radiance, rendering.depth_m, rendering.points_trs_m, rendering.is_lit),
            n_threads=self._n_threads,
        )
        return rendering

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
        t = raycast.first_hit(self._grid, *start, *direction, np.inf, 0)
        return float(t) if t >= 0.0 else float("nan")

    def _in_grid(self, p_trs_m: ArrayLike) -> FloatArray:
        return (np.asarray(p_trs_m, dtype=np.float64) - self._origin_trs_m) * self._cells_per_m

    def _view(
        self, trs_from_cam: RigidTransform, lamp: Lamp, photometry: Photometry
    ) -> raycast.View:
        if photometry not in _PHOTOMETRY:
            raise RenderError(f"photometry is {photometry!r}, must be one of {list(_PHOTOMETRY)}")
        if not np.isfinite(trs_from_cam.as_matrix()).all():
            raise RenderError(f"camera pose: is not finite: {trs_from_cam.as_matrix().tolist()}")
        if not (np.isfinite(lamp.p_trs_m).all() and np.isfinite(lamp.intensity)):
            raise RenderError(f"lamp: is not finite: {lamp}")
        rotation = trs_from_cam.rotation.as_matrix()
        return raycast.View(
            self._origin_trs_m,
            self._in_grid(trs_from_cam.translation),
            np.ascontiguousarray(self._cells_per_m[:, None] * rotation),
            self._in_grid(lamp.p_trs_m),
            float(lamp.intensity),
            _PHOTOMETRY[photometry],
            self._shadow_reach(lamp),
        )

    def _shadow_reach(self, lamp: Lamp) -> NDArray[np.float32]:
        """Give the lamp's table of shadow reaches, for the lamps used last: they seldom move."""
        key = np.asarray(lamp.p_trs_m, dtype=np.float64).tobytes()
        table = self._shadow_reaches.pop(key, None)
        if table is None:
            table = np.zeros(raycast.block_shape(self._grid), dtype=np.float32)
        self._shadow_reaches[key] = table
        while len(self._shadow_reaches) > _N_LAMPS:
            del self._shadow_reaches[next(iter(self._shadow_reaches))]
        return table
