"""From what the rig file says to a height map, with a cache on disk."""

import hashlib
import json
import logging
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.cache import cache_file, load_heights, save_heights
from tronlab.terrain.config import FileTerrain, ProceduralTerrain
from tronlab.terrain.file import READER_VERSION, read_terrain
from tronlab.terrain.heightmap import HeightMap, TerrainError
from tronlab.terrain.procedural import GENERATOR_VERSION, make_terrain

logger = logging.getLogger(__name__)


def load_terrain(
    config: ProceduralTerrain | FileTerrain,
    *,
    base_dir: Path,
    announce: Callable[[str], None] | None = None,
) -> HeightMap:
    """Make a terrain model, or take it from the cache.

    Args:
        config: The terrain of the rig.
        base_dir: Folder that a relative path of a file terrain starts from.
        announce: Is told what takes time and what is cut off; by default the log.

    Raises:
        TerrainError: The file of a file terrain is missing or unfit.
    """
    announce = announce or logger.info
    if isinstance(config, ProceduralTerrain):
        origin: dict[str, int | str] = {"generator": GENERATOR_VERSION}
        height_m = _cached(config, origin, announce, lambda: make_terrain(config))
    else:
        path = _existing_file(config.path, base_dir)
        origin = {"reader": READER_VERSION, "sha256": _sha256(path)}
        height_m = _cached(
            config, origin, announce, lambda: read_terrain(config, path, announce=announce)
        )
    return HeightMap(height_m, config.spacing_m, np.array(config.origin_trs_m, dtype=np.float64))


def _cached(
    config: ProceduralTerrain | FileTerrain,
    origin: dict[str, int | str],
    announce: Callable[[str], None],
    make: Callable[[], NDArray[np.float32]],
) -> NDArray[np.float32]:
    """Give the heights from the cache, or make and keep them."""
    cache = cache_file(_key(config, origin))
    height_m = load_heights(cache, config.shape)
    if height_m is not None:
        return height_m
    rows, columns = config.shape
    announce(f"making the terrain model of {rows} x {columns} samples (kept for the next time)")
    start = time.perf_counter()
    height_m = make()
    logger.info("terrain model made in %.1f s", time.perf_counter() - start)
    save_heights(cache, height_m)
    return height_m


def _key(config: ProceduralTerrain | FileTerrain, origin: dict[str, int | str]) -> str:
    """Name everything the heights depend on: not where the model stands, not the file's name."""
    settings = config.model_dump(mode="json", exclude={"origin_trs_m", "path"})
    text = json.dumps({**settings, **origin}, sort_keys=True)
    return f"{config.kind}-{hashlib.sha256(text.encode()).hexdigest()[:24]}"


def _existing_file(path: Path, base_dir: Path) -> Path:
    path = base_dir / path
    if not path.is_file():
        raise TerrainError(
            f"terrain file {path} does not exist; a relative path starts from {base_dir}"
        )
    return path


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
