# pyright: basic
"""A height map and its quadtrees of maxima, for single rays and for bundles of rays."""

import logging
import mmap
import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.cache import cache_folder
from tronlab.terrain.config import MAX_SAMPLES_IN_MEMORY
from tronlab.terrain.heightmap import HeightMap, TerrainError
from tronlab.terrain.kernels import compiled, n_cores, run_interleaved
from tronlab.terrain.mapped import map_floats, release
from tronlab.terrain.new_file import NewFile

logger = logging.getLogger(__name__)

QUADTREE_VERSION = 1
"""To be raised with every change of the maxima or their order."""

WIDE_LEVEL = np.int64(2)
"""The lowest level of the wide quadtree."""
_BAND_BYTES = 1 << 26


class Grid(NamedTuple):
    """A height map and its quadtree, as the kernels see it."""

    height_m: NDArray[np.float32]
    """Shape (rows, columns)."""
    node_max_m: NDArray[np.float32]
    """Maxima of all levels from 1 up, one after the other, each level by rows."""
    level_start: NDArray[np.int64]
    """Where in ``node_max_m`` a level begins; entry 0 is not used."""
    level_columns: NDArray[np.int64]
    """Columns of a level."""
    wide_max_m: NDArray[np.float32]
    """The wide quadtree: maxima over a square and half its width around it, for levels from
    ``WIDE_LEVEL`` up. What passes over a square's middle line, no wider than the square, is over
    this. Each level has one more square on every side of the model."""
    wide_start: NDArray[np.int64]
    """Where in ``wide_max_m`` the square (0, 0) of a level lies."""
    wide_columns: NDArray[np.int64]
    top_m: float
    """The largest height."""
    bottom_m: float
    """The smallest height."""
    spacing_m: float


@dataclass(frozen=True, slots=True)
class _Level:
    """Where one level lies in the array of all maxima, by rows."""

    start: int
    rows: int
    columns: int

    @property
    def end(self) -> int:
        return self.start + self.rows * self.columns

    def of(self, maxima: NDArray[np.float32]) -> NDArray[np.float32]:
        return maxima[self.start : self.end].reshape(self.rows, self.columns)


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where the levels of both quadtrees lie in one array: all plain ones, then all wide ones."""

    plain: tuple[_Level, ...]
    """From level 1 up."""
    wide: tuple[_Level, ...]
    """From ``WIDE_LEVEL`` up, each made from the plain one of the same index."""

    @classmethod
    def of(cls, shape: tuple[int, ...]) -> "_Layout":
        plain = [(shape[0] // 2, shape[1] // 2)]
        while max(plain[-1]) > 1:
            plain.append(((plain[-1][0] + 1) // 2, (plain[-1][1] + 1) // 2))
        wide = [((rows + 1) // 2 + 2, (columns + 1) // 2 + 2) for rows, columns in plain]
        levels: list[_Level] = []
        for rows, columns in [*plain, *wide]:
            levels.append(_Level(levels[-1].end if levels else 0, rows, columns))
        return cls(tuple(levels[: len(plain)]), tuple(levels[len(plain) :]))

    @property
    def size(self) -> int:
        return self.wide[-1].end

    def steps(
        self, height_m: NDArray[np.float32], maxima: NDArray[np.float32]
    ) -> Iterator["_Step"]:
        """Give how each level is made from one below, in the order of making."""
        # A square of level 1 covers 2 x 2 cells, which are 3 x 3 samples.
        yield _Step(height_m, self.plain[0].of(maxima), 3, 0)
        for below, level in pairwise(self.plain):
            yield _Step(below.of(maxima), level.of(maxima), 2, 0)
        # A wide square, one further on each side: 2 x 2 squares and one around them.
        for below, level in zip(self.plain, self.wide, strict=True):
            yield _Step(below.of(maxima), level.of(maxima), 4, 3)

    def grid(
        self,
        height_m: NDArray[np.float32],
        maxima: NDArray[np.float32],
        bottom_m: float,
        spacing_m: float,
    ) -> Grid:
        n_plain = self.wide[0].start
        # Level 0 is the heights themselves, and the wide quadtree has no levels 0 and 1.
        level_start = [0, *(level.start for level in self.plain)]
        level_columns = [height_m.shape[1] - 1, *(level.columns for level in self.plain)]
        wide_columns = [height_m.shape[1] - 1] * 2 + [level.columns for level in self.wide]
        corner = [0, 0, *(level.start - n_plain for level in self.wide)]
        return Grid(
            height_m,
            maxima[:n_plain],
            np.array(level_start, np.int64),
            np.array(level_columns, np.int64),
            maxima[n_plain:],
            # The first row and column of a wide level lie outside the model.
            np.array(corner, np.int64) + np.array(wide_columns, np.int64) + 1,
            np.array(wide_columns, np.int64),
            float(maxima[self.plain[-1].start]),
            bottom_m,
            spacing_m,
        )


class _Step(NamedTuple):
    """A level and what it is made from: maxima over windows two apart."""

    below: NDArray[np.float32]
    level: NDArray[np.float32]
    width: int
    """Of a window."""
    overhang: int
    """How far the first window begins before the first value."""

    def run(self, first: int, end: int) -> None:
        """Fill rows of the level."""
        window = (self.width, self.overhang)
        run_interleaved(
            _fill_rows, self.below, self.level, *window, first, end, n_threads=n_cores()
        )


def grid_of(heightmap: HeightMap) -> Grid:
    """Build the quadtrees of a height map.

    Those of one too large for memory are kept in a file of the cache, and only what is used of it
    is ever read.

    Raises:
        TerrainError: There is no room on the disk for that file.
    """
    if heightmap.file is None or heightmap.height_m.size <= MAX_SAMPLES_IN_MEMORY:
        return make_grid(heightmap.height_m, heightmap.spacing_m)
    layout = _Layout.of(heightmap.height_m.shape)
    maxima = _mapped_maxima(heightmap, heightmap.file, layout)
    return layout.grid(
        heightmap.height_m, maxima, heightmap.statistics.lowest_m, heightmap.spacing_m
    )


def make_grid(height_m: NDArray[np.float32], spacing_m: float) -> Grid:
    """Build the quadtrees in memory: less than half of that of the heights."""
    layout = _Layout.of(height_m.shape)
    maxima = np.empty(layout.size, np.float32)
    for step in layout.steps(height_m, maxima):
        step.run(0, len(step.level))
    return layout.grid(height_m, maxima, float(height_m.min()), spacing_m)


def _mapped_maxima(heightmap: HeightMap, heights: Path, layout: _Layout) -> NDArray[np.float32]:
    """Give the maxima of all levels from their file; make it where it is not there."""
    path = cache_folder() / f"quadtree-{QUADTREE_VERSION}-{heightmap.fingerprint}.f32"
    maxima = _kept_maxima(path, layout, heightmap.statistics.highest_m)
    if maxima is None:
        _write_maxima(path, heights, heightmap.height_m.shape, layout)
        maxima = _kept_maxima(path, layout, heightmap.statistics.highest_m)
    if maxima is None:
        raise TerrainError(f"{path}: was damaged as soon as it was written; try again")
    return maxima


def _kept_maxima(path: Path, layout: _Layout, highest_m: float) -> NDArray[np.float32] | None:
    if not path.is_file():
        return None
    if path.stat().st_size == 4 * layout.size:
        maxima = map_floats(path, (layout.size,))
        if maxima[layout.plain[-1].start] == highest_m:
            return maxima
    logger.warning("cached quadtree %s is damaged and is made again", path)
    return None


def _write_maxima(path: Path, heights: Path, shape: tuple[int, ...], layout: _Layout) -> None:
    """Fill the file of all levels, in bands that leave memory as soon as they are done."""
    logger.info("building the quadtree of %d x %d heights (kept for the next time)", *shape)
    path.parent.mkdir(parents=True, exist_ok=True)
    with NewFile(path, 4 * layout.size) as new, heights.open("rb") as file:
        ours = mmap.mmap(new.descriptor, 0)
        theirs = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
        n_header = os.stat(heights).st_size - 4 * shape[0] * shape[1]
        height_m = np.frombuffer(theirs, np.float32, offset=n_header).reshape(shape)
        maxima = np.frombuffer(ours, np.float32)
        for step in layout.steps(height_m, maxima):
            rows = max(1, _BAND_BYTES // (4 * step.below.shape[1]))
            for first in range(0, len(step.level), rows):
                step.run(first, min(first + rows, len(step.level)))
                release(ours)
                release(theirs)
        ours.flush()
        new.put_in_place()


@compiled
def _fill_rows(below, level, width, overhang, first, end, part, n_parts):  # noqa: PLR0917
    """Fill the part-th strip of rows first .. end - 1 of a level with maxima over windows."""
    n_rows, n_columns = below.shape
    n_windows = level.shape[1]
    lowest = np.float32(-np.inf)
    highest = np.full(max(overhang + n_columns, 2 * (n_windows - 1) + width), lowest, np.float32)
    strip = first + (end - first) * part // n_parts
    next_strip = first + (end - first) * (part + 1) // n_parts
    for i in range(strip, next_strip):
        begin = 2 * i - overhang
        highest[:] = lowest
        for k in range(max(begin, 0), min(begin + width, n_rows)):
            for m in range(n_columns):
                value = below[k, m]
                highest[overhang + m] = max(highest[overhang + m], value)
        for j in range(n_windows):
            level[i, j] = highest[2 * j]
        for n in range(1, width):
            for j in range(n_windows):
                level[i, j] = max(level[i, j], highest[2 * j + n])
