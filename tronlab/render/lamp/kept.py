"""Maps of lamps kept on disk, so that a new process need not make that of the same lamp again.

A map that is missing, damaged or cannot be kept is no error: it is made again.
"""

import contextlib
import logging
import mmap
import os
import threading
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.render.lamp.prefilter import n_squares
from tronlab.render.lighting import SHADOW_OFFSET_M
from tronlab.terrain.cache import cache_folder
from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.new_file import NewFile

logger = logging.getLogger(__name__)

MAP_VERSION = 1
"""To be raised with every change of what is in a map of the same lamp."""

LEAST_SAMPLES = 4_000_000
"""Maps of smaller terrains are made as fast as they are read."""
_MOST_MAPS = 4
"""So many are kept of all terrains, those used last."""


def map_file(
    fingerprint: str, spacing_m: float, lamp: FloatArray, albedo: NDArray[np.uint16]
) -> Path:
    """Give where the map of a lamp is kept.

    Args:
        fingerprint: Names the heights.
        spacing_m: Between them.
        lamp: Where the lamp is in grid coordinates, and its radius in metres, shape (4,).
        albedo: Of the terrain.
    """
    numbers = np.array([spacing_m, *lamp, SHADOW_OFFSET_M], dtype=np.float64).tobytes()
    key = f"{zlib.crc32(numbers):08x}{zlib.adler32(numbers):08x}{zlib.crc32(albedo.data):08x}"
    return cache_folder() / f"lamp-{MAP_VERSION}-{fingerprint}-{key}.map"


def find_map(
    path: Path, shape: tuple[int, int]
) -> tuple[NDArray[np.uint8], NDArray[np.int16]] | None:
    """Give the visibility and the means of a map that is kept, mapped from its file; else None."""
    n_means = 4 * n_squares(shape)
    try:
        if path.stat().st_size != 2 * n_means + shape[0] * shape[1]:
            logger.warning("the kept lamp map %s is damaged and is made again", path)
            return None
        with path.open("rb") as file:
            # Kernels tell read-only arrays from others.
            mapping = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    except OSError:
        return None
    with contextlib.suppress(OSError):
        os.utime(path)
    means = np.frombuffer(mapping, np.int16, n_means).reshape(-1, 4)
    visibility = np.frombuffer(mapping, np.uint8, shape[0] * shape[1], 2 * n_means)
    return visibility.reshape(shape), means


def keep_map(path: Path, visibility: NDArray[np.uint8], means: NDArray[np.int16]) -> None:
    """Keep a map, in the background: nobody waits for the disk."""
    arguments = (path, visibility, means)
    threading.Thread(target=_write, args=arguments, name="keep lamp map").start()


def _write(path: Path, visibility: NDArray[np.uint8], means: NDArray[np.int16]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with NewFile(path, means.nbytes + visibility.nbytes) as new:
            with os.fdopen(os.dup(new.descriptor), "wb") as file:
                file.write(means.data)
                file.write(visibility.data)
            new.put_in_place()
        _remove_oldest(path.parent)
    except (OSError, TerrainError) as error:
        logger.warning("the lamp map is not kept: %s", error)


def _remove_oldest(folder: Path) -> None:
    maps = sorted(folder.glob("lamp-*.map"), key=lambda path: path.stat().st_mtime_ns)
    for path in maps[:-_MOST_MAPS]:
        path.unlink(missing_ok=True)
