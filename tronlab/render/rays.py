"""Rays of a camera's pixels, kept for the cameras used last: inverting a distortion takes time."""

from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.terrain.kernels import n_cores

_OFFSETS_PX = (-0.25, 0.25)
_ROWS_AT_ONCE = 16
"""So few that the intermediate arrays stay in the processor's cache, which is four times faster."""


@lru_cache(maxsize=4)
def centre_rays(camera: CameraModel) -> FloatArray:
    """Give the rays through the pixel centres, shape (rows, columns, 2), read-only."""
    rays = np.empty((*camera.shape, 2))
    _fill(rays, camera, du_px=0.0, dv_px=0.0)
    rays.setflags(write=False)
    return rays


@lru_cache(maxsize=2)
def subpixel_rays(camera: CameraModel) -> FloatArray:
    """Give the rays through a 2 x 2 grid in each pixel, shape (4, rows, columns, 2), read-only."""
    rays = np.empty((4, *camera.shape, 2))
    offsets = [(du, dv) for dv in _OFFSETS_PX for du in _OFFSETS_PX]
    for table, (du, dv) in zip(rays, offsets, strict=True):
        _fill(table, camera, du_px=du, dv_px=dv)
    rays.setflags(write=False)
    return rays


def _fill(rays: FloatArray, camera: CameraModel, *, du_px: float, dv_px: float) -> None:
    """Do what ``CameraModel.ray_table`` does, a few rows at a time."""
    u = np.arange(camera.width_px) + du_px

    def fill(first: int) -> None:
        v = np.arange(first, min(first + _ROWS_AT_ONCE, camera.height_px)) + dv_px
        rays[first : first + len(v)] = camera.rays(np.stack(np.meshgrid(u, v), axis=-1))

    with ThreadPoolExecutor(n_cores()) as pool:
        list(pool.map(fill, range(0, camera.height_px, _ROWS_AT_ONCE)))
