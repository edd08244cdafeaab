"""A camera's rays in tiles of neighbouring pixels, kept for the cameras used last."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.render.rays import centre_rays, subpixel_rays

_SIDES_PX = {1: 12, 4: 6}
"""Pixels along a tile's side: a tile has about as many rays with one and with four a pixel."""
LANES = 192
"""Room for the rays of a tile: at most 180, and rows begin at multiples of 32 bytes. What there is
of a tile fits the fastest part of a processor's cache."""


class RayTiles(NamedTuple):
    """Rays (x, y, 1) in cam, by tile.

    A tile's rays are those through the centres of its pixels, row by row, then as many for each of
    the rays in a pixel. Where a tile reaches over the border of the image, its last pixels repeat.
    """

    middle: FloatArray
    """Middle of the tile's rays, shape (tile rows, tile columns, 2)."""
    half_width: FloatArray
    """So far from the middle its rays lie along x and y, shape (tile rows, tile columns, 2)."""
    offset: NDArray[np.float32]
    """From the middle to each ray, shape (tile rows, tile columns, 2, rays): a small number, which
    32 bits hold with room to spare."""
    side_px: int


@lru_cache(maxsize=4)
def ray_tiles(camera: CameraModel, rays_per_pixel: int) -> RayTiles:
    """Give a camera's rays by tile; the arrays are read-only."""
    side_px = _SIDES_PX[rays_per_pixel]
    tables = centre_rays(camera)[None]
    if rays_per_pixel > 1:
        tables = np.concatenate([tables, subpixel_rays(camera)])
    rays = _by_tile(tables, side_px)
    least, most = rays.min(axis=-1), rays.max(axis=-1)
    middle, half_width = 0.5 * (least + most), 0.5 * (most - least)
    offset = (rays - middle[..., None]).astype(np.float32)
    for array in (middle, half_width, offset):
        array.setflags(write=False)
    return RayTiles(middle, half_width, offset, side_px)


def _by_tile(tables: FloatArray, side_px: int) -> FloatArray:
    """Reorder rays, (n, rows, columns, 2) -> (tile rows, tile columns, 2, n * side_px**2)."""
    n_tables, n_rows, n_columns, _ = tables.shape
    missing = (0, -n_rows % side_px), (0, -n_columns % side_px)
    padded = np.pad(tables, ((0, 0), *missing, (0, 0)), mode="edge")
    tile_rows, tile_columns = padded.shape[1] // side_px, padded.shape[2] // side_px
    tiles = padded.reshape(n_tables, tile_rows, side_px, tile_columns, side_px, 2)
    return tiles.transpose(1, 3, 5, 0, 2, 4).reshape(tile_rows, tile_columns, 2, -1)
