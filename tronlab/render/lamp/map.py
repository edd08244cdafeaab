# pyright: basic
"""What of a lamp each node of the terrain sees, worked out once for a lamp that stands still."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.render.kernels import inlined
from tronlab.render.lamp import prefilter
from tronlab.render.lamp.prefilter import Pyramid, make_pyramid
from tronlab.render.lamp.sweep import sweep
from tronlab.render.quadtree import Grid
from tronlab.render.renderer import Lamp, RenderError
from tronlab.render.surface import NO_ALBEDO
from tronlab.terrain.kernels import n_cores

_N_LAMPS = 2
_MOST_SAMPLES = 10**8


class LampMap(NamedTuple):
    """The light of one lamp on the terrain, as the kernels see it."""

    visibility: NDArray[np.uint8]
    """Share of the lamp that is seen from just above each node, 255 for the whole, shape (rows,
    columns). It does not say whether the node faces the lamp."""
    pyramid: Pyramid
    """Mean light of squares of nodes."""


class LampMaps:
    """Makes the maps of one terrain and keeps those of the lamps used last."""

    def __init__(
        self,
        grid: Grid,
        origin_trs_m: FloatArray,
        albedo: NDArray[np.uint16] | None = None,
        *,
        n_threads: int | None = None,
    ) -> None:
        self._grid = grid
        self._origin_trs_m = np.asarray(origin_trs_m, dtype=np.float64)
        self._albedo = NO_ALBEDO if albedo is None else albedo
        self._n_threads = n_threads or n_cores()
        self._maps: dict[bytes, LampMap] = {}

    def of(self, lamp: Lamp) -> LampMap:
        """Give the map of a lamp: at once, if it is one of the two used last.

        Raises:
            RenderError: The terrain is too large.
        """
        n_samples = self._grid.height_m.size
        if n_samples > _MOST_SAMPLES:
            raise RenderError(
                f"lamp map: the terrain has {n_samples} samples, at most {_MOST_SAMPLES} are"
                " possible; render with shadows: rays"
            )
        key = np.array([*lamp.p_trs_m, lamp.radius_m], dtype=np.float64).tobytes()
        lamp_map = self._maps.pop(key, None) or self._made(lamp)
        self._maps[key] = lamp_map
        while len(self._maps) > _N_LAMPS:
            del self._maps[next(iter(self._maps))]
        return lamp_map

    def _made(self, lamp: Lamp) -> LampMap:
        spacing_m = self._grid.spacing_m
        p = (lamp.p_trs_m - self._origin_trs_m) / np.array([spacing_m, spacing_m, 1.0])
        visibility = np.empty(self._grid.height_m.shape, dtype=np.uint8)
        sweep(self._grid, p, lamp.radius_m, visibility, n_threads=self._n_threads)
        pyramid = make_pyramid(self._grid, visibility, self._albedo, p, n_threads=self._n_threads)
        return LampMap(visibility, pyramid)


@inlined
def visibility_at(lamp_map, r, c):
    """Give the share of the lamp seen from a place in grid coordinates, 0 to 1."""
    shares = lamp_map.visibility
    i = min(max(int(r), 0), shares.shape[0] - 2)
    j = min(max(int(c), 0), shares.shape[1] - 2)
    a, b = r - i, c - j
    upper = (1.0 - b) * shares[i, j] + b * shares[i, j + 1]
    lower = (1.0 - b) * shares[i + 1, j] + b * shares[i + 1, j + 1]
    return ((1.0 - a) * upper + a * lower) * (1.0 / 255.0)


@inlined
def filtered_at(lamp_map, r, c, level):
    """Give the mean light around a place; see ``prefilter.filtered_at``."""
    return prefilter.filtered_at(lamp_map.pyramid, r, c, level)
