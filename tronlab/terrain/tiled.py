"""A lunar terrain of any size, made in tiles straight into its file.

The same kind of terrain as ``tronlab.terrain.procedural`` makes, of another chance: there, one
Fourier transform of the whole model makes the roughness, here there is one for long waves on a
coarse grid and one a tile for short waves. Every tile is a pure function of the settings, so tiles
join whatever their size, and memory does not grow with the model.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.craters import REACH, Craters, stamp_craters
from tronlab.terrain.dem import DemWriter
from tronlab.terrain.heightmap import HeightSums, TerrainError, bands_of_rows
from tronlab.terrain.procedural import (
    Hills,
    config_craters,
    draw_hills,
    extent_m,
    hill_factor,
    places_m,
)
from tronlab.terrain.tiled_roughness import REACH_PX, TiledRoughness

TILED_VERSION = 1
"""To be raised with every change of the heights made from the same settings."""

_TILE_PX = 3072
_MOST_RELIEF_SAMPLES = 4_000_000
_MOST_CRATERS = 20_000_000
_ANNOUNCED_EVERY_S = 10.0


def write_terrain(
    config: ProceduralTerrain,
    path: Path,
    *,
    made_by: Mapping[str, object],
    announce: Callable[[str], None],
    tile_px: int = _TILE_PX,
) -> None:
    """Make a terrain model from 0 to ``relief_m``, as the file NAME.npy with NAME.json beside it.

    Args:
        config: The terrain.
        path: NAME.npy; it and NAME.json appear when they are complete.
        made_by: Goes into the description.
        announce: Is told of the progress every ten seconds.
        tile_px: Side of a tile, a multiple of 512; for the memory needed, not for the heights.

    Raises:
        TerrainError: The disk has too little room or cannot be written to, or the law of craters
            asks for too many.
    """
    _check_number_of_craters(config)
    rows, columns = config.shape
    announce(
        f"making the terrain model of {rows} x {columns} samples:"
        f" {4e-9 * rows * columns:.1f} GB in {path.parent}"
    )
    # A small model needs no more than one tile.
    tile_px = min(tile_px, -(-max(config.shape) // REACH_PX) * REACH_PX)
    with DemWriter(path, config.shape) as writer:
        progress = _Progress(announce, 4 * rows * columns)
        coarse = _write_ground(writer, config, tile_px, progress)
        hills = _hills_for_relief(config, coarse)
        _add_hills_and_scale(writer, config, hills, progress)
        writer.finish(spacing_m=config.spacing_m, origin_trs_m=config.origin_trs_m, made_by=made_by)


@dataclass(frozen=True, slots=True)
class _CoarseGround:
    """Every ``step``-th row and column of roughness and craters."""

    height_m: NDArray[np.float32]
    step: int


@dataclass(frozen=True, slots=True)
class _ScaledHills:
    """The hills of a model, as high as its relief needs them."""

    hills: Hills
    factor: np.float32
    x_m: FloatArray
    """Of the rows."""
    waves: NDArray[np.float32]
    """Along the columns."""

    def add_to(self, height_m: NDArray[np.float32], first_row: int) -> None:
        """Add them to whole rows in place."""
        if self.factor > 0:
            x_m = self.x_m[first_row : first_row + len(height_m)]
            height_m += (self.factor * self.hills.strengths(x_m)) @ self.waves


def _write_ground(
    writer: DemWriter, config: ProceduralTerrain, tile_px: int, progress: "_Progress"
) -> _CoarseGround:
    """Write roughness and craters, tile by tile."""
    roughness = TiledRoughness(
        config.seed,
        config.shape,
        tile_px=tile_px,
        spacing_m=config.spacing_m,
        hurst_exponent=config.hurst_exponent,
        slope=config.roughness_slope,
    )
    _, crater_rng, _ = np.random.default_rng(config.seed).spawn(3)
    craters = config_craters(crater_rng, config)
    rows, columns = config.shape
    step = int(np.ceil(np.sqrt(rows * columns / _MOST_RELIEF_SAMPLES)))
    coarse_m = np.empty((-(-rows // step), -(-columns // step)), np.float32)
    for row, column in _corners(config.shape, tile_px):
        tile = roughness.tile(row, column)
        _stamp(tile, row, column, config.spacing_m, craters)
        writer.write(row, column, tile)
        inside = tile[-row % step :: step, -column % step :: step]
        i, j = -(-row // step), -(-column // step)
        coarse_m[i : i + inside.shape[0], j : j + inside.shape[1]] = inside
        progress.advance(2 * tile.size)
    return _CoarseGround(coarse_m, step)


def _corners(shape: tuple[int, int], tile_px: int) -> Iterator[tuple[int, int]]:
    for row in range(0, shape[0], tile_px):
        for column in range(0, shape[1], tile_px):
            yield row, column


def _stamp(
    tile: NDArray[np.float32], row: int, column: int, spacing_m: float, craters: Craters
) -> None:
    """Add the craters that reach into a tile, in place."""
    x_m, y_m = row * spacing_m, column * spacing_m
    reach_m = REACH * craters.diameter_m / 2
    touches = _reaches(craters.x_m, reach_m, x_m, x_m + tile.shape[0] * spacing_m)
    touches &= _reaches(craters.y_m, reach_m, y_m, y_m + tile.shape[1] * spacing_m)
    here = Craters(
        craters.diameter_m[touches],
        craters.x_m[touches] - x_m,
        craters.y_m[touches] - y_m,
        craters.wear[touches],
    )
    stamp_craters(tile, spacing_m, here)


def _reaches(
    centre_m: FloatArray, reach_m: FloatArray, begin_m: float, end_m: float
) -> NDArray[np.bool_]:
    return (centre_m + reach_m >= begin_m) & (centre_m - reach_m <= end_m)


def _hills_for_relief(config: ProceduralTerrain, coarse: _CoarseGround) -> _ScaledHills:
    _, _, hill_rng = np.random.default_rng(config.seed).spawn(3)
    size_m = extent_m(config)
    hills = draw_hills(hill_rng, size_m)
    x_m, y_m = places_m(config.shape, size_m)
    coarse_hill = hills.heights(x_m[:: coarse.step], y_m[:: coarse.step])
    factor = hill_factor(coarse.height_m, coarse_hill, config.relief_m)
    return _ScaledHills(hills, factor, x_m, hills.waves(y_m))


def _add_hills_and_scale(
    writer: DemWriter, config: ProceduralTerrain, hills: _ScaledHills, progress: "_Progress"
) -> None:
    """Finish the heights, band by band: once to find the extremes, once to write."""
    sums = HeightSums()
    for first, end in bands_of_rows(config.shape):
        height_m = writer.read_rows(first, end)
        hills.add_to(height_m, first)
        sums.add(height_m)
        progress.advance(height_m.size)
    found = sums.result()
    relief_m = np.float32(config.relief_m)
    scale = relief_m / np.float32(found.highest_m - found.lowest_m)
    for first, end in bands_of_rows(config.shape):
        height_m = writer.read_rows(first, end)
        hills.add_to(height_m, first)
        is_top = height_m == np.float32(found.highest_m)
        height_m -= np.float32(found.lowest_m)
        height_m *= scale
        np.minimum(height_m, relief_m, out=height_m)
        height_m[is_top] = relief_m
        writer.write(first, 0, height_m)
        progress.advance(height_m.size)


def _check_number_of_craters(config: ProceduralTerrain) -> None:
    margin_m = REACH * config.crater_largest_m
    area_m2 = (config.size_m[0] + margin_m) * (config.size_m[1] + margin_m)
    n = config.crater_density_per_m2 * config.crater_smallest_m**-config.crater_exponent * area_m2
    if n > _MOST_CRATERS:
        raise TerrainError(
            f"terrain: the law of craters gives about {n / 1e6:.0f} million of them (at most"
            f" {_MOST_CRATERS // 1_000_000} million): make crater_smallest_m larger than"
            f" {config.crater_smallest_m}"
        )


class _Progress:
    """Tells now and then how much is done and how long the rest takes."""

    def __init__(self, announce: Callable[[str], None], n_total: int) -> None:
        self._announce = announce
        self._n_total = n_total
        self._n_done = 0
        self._start = self._announced = time.monotonic()

    def advance(self, n: int) -> None:
        self._n_done += n
        now = time.monotonic()
        if now < self._announced + _ANNOUNCED_EVERY_S or self._n_done >= self._n_total:
            return
        self._announced = now
        share = self._n_done / self._n_total
        left_s = (now - self._start) * (1 - share) / share
        self._announce(f"terrain model: {100 * share:.0f} % made, about {left_s:.0f} s left")
