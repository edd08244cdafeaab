# pyright: basic
"""What of a lamp each node of the terrain sees, worked out once for a lamp that stands still."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.render.lamp import prefilter
from tronlab.render.lamp.kept import LEAST_SAMPLES, find_map, keep_map, map_file
from tronlab.render.lamp.prefilter import Pyramid, lay_out, make_pyramid
from tronlab.render.lamp.sweep import sweep
from tronlab.render.quadtree import Grid
from tronlab.render.renderer import Lamp, RenderError
from tronlab.render.surface import NO_ALBEDO
from tronlab.terrain.kernels import inlined, n_cores

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
    """Makes the maps of one terrain and keeps those of the lamps used last.

    That of the first lamp is kept on disk too: the next process most often has the same one. Those
    of later lamps are not, as they may be of a lamp that moves.
    """

    def __init__(
        self,
        grid: Grid,
        origin_trs_m: FloatArray,
        albedo: NDArray[np.uint16] | None = None,
        *,
        fingerprint: str | None = None,
        n_threads: int | None = None,
    ) -> None:
        """Make no map yet.

        Args:
            grid: The terrain.
            origin_trs_m: Where its node (0, 0) would lie at height 0, shape (3,).
            albedo: Of its nodes, ``WHITE`` for 1; None: 1 everywhere.
            fingerprint: Names the heights; without it nothing is kept on disk.
            n_threads: Threads to use; as many as cores without it.
        """
        self._grid = grid
        self._origin_trs_m = np.asarray(origin_trs_m, dtype=np.float64)
        self._albedo = NO_ALBEDO if albedo is None else albedo
        self._fingerprint = fingerprint if grid.height_m.size >= LEAST_SAMPLES else None
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
        if self._fingerprint is None:
            return self._swept(p, lamp.radius_m)
        numbers = np.array([*p, lamp.radius_m])
        path = map_file(self._fingerprint, spacing_m, numbers, self._albedo)
        self._fingerprint = None
        found = find_map(path, self._grid.height_m.shape)
        if found is not None:
            return LampMap(found[0], lay_out(self._grid.height_m.shape, found[1]))
        made = self._swept(p, lamp.radius_m)
        keep_map(path, made.visibility, made.pyramid.means)
        return made

    def _swept(self, p: FloatArray, radius_m: float) -> LampMap:
        """Make the map of a lamp at a place in grid coordinates."""
        visibility = np.empty(self._grid.height_m.shape, dtype=np.uint8)
        sweep(self._grid, p, radius_m, visibility, n_threads=self._n_threads)
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
