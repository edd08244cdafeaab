"""Terrain models kept on disk, as files of the same form as ``tronlab.terrain.dem``.

A file that is missing, damaged or unreadable is no error: the heights are made again. A folder
that cannot be written to costs time, not the run, unless the heights do not fit into memory.
"""

import logging
from collections.abc import Callable
from pathlib import Path

import platformdirs

from tronlab.terrain.dem import describe_dem, description_path
from tronlab.terrain.heightmap import HeightMap, TerrainError

logger = logging.getLogger(__name__)


def cache_folder() -> Path:
    """Give where terrain models and what is derived from them are kept."""
    return platformdirs.user_cache_path("tronlab") / "terrain"


def cache_file(key: str) -> Path:
    """Give where the heights with this key are kept: in the user's cache folder."""
    return cache_folder() / f"{key}.npy"


def find_cached(
    path: Path, shape: tuple[int, int] | None, open_file: Callable[[Path], HeightMap]
) -> HeightMap | None:
    """Open a kept terrain model; None if there is none or it is damaged.

    Args:
        path: The file.
        shape: What it must have; None if that is not known.
        open_file: Opens the file.
    """
    if not (path.exists() and description_path(path).exists()):
        return None
    try:
        if shape in {None, describe_dem(path).shape}:
            return open_file(path)
        reason = f"{path}: its shape is {describe_dem(path).shape}, expected {shape}"
    except TerrainError as error:
        reason = str(error)
    logger.warning("the cached terrain is damaged and is made again: %s", reason)
    return None


def keep(save: Callable[[], None]) -> None:
    """Keep a terrain model that is in memory; a warning if that fails."""
    try:
        cache_folder().mkdir(parents=True, exist_ok=True)
        save()
    except (OSError, TerrainError) as error:
        logger.warning("the terrain is not cached: %s", error)
