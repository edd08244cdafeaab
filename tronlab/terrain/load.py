"""From what the rig file says to a height map, with a cache on disk."""

import hashlib
import json
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.albedo import read_albedo
from tronlab.terrain.cache import cache_file, cache_folder, find_cached, keep
from tronlab.terrain.config import (
    MAX_SAMPLES_IN_MEMORY,
    DemTerrain,
    FileTerrain,
    MadeTerrain,
    ProceduralTerrain,
    ScannedTerrain,
    TerrainConfig,
)
from tronlab.terrain.dem import describe_dem, open_dem, read_dem, save_dem
from tronlab.terrain.heightmap import HeightMap, TerrainError
from tronlab.terrain.procedural import GENERATOR_VERSION, make_terrain

logger = logging.getLogger(__name__)


def load_terrain(
    config: TerrainConfig,
    *,
    base_dir: Path,
    announce: Callable[[str], None] | None = None,
) -> HeightMap:
    """Make a terrain model, or take it from the cache.

    Args:
        config: The terrain of the rig.
        base_dir: Folder that a relative path of a file starts from.
        announce: Is told what takes time and what is cut off; by default the log.

    Raises:
        TerrainError: The file of the terrain is missing or unfit, or there is no room on the disk
            for a terrain that does not fit into memory.
    """
    heightmap = _load_heights(config, base_dir, announce or logger.info)
    if config.albedo_map is None:
        return heightmap
    return heightmap.painted(read_albedo(base_dir / config.albedo_map, heightmap.height_m.shape))


def _load_heights(
    config: TerrainConfig, base_dir: Path, announce: Callable[[str], None]
) -> HeightMap:
    if isinstance(config, DemTerrain):
        path = _existing_file(config.path, base_dir)
        return _opener(describe_dem(path).shape)(path, config.origin_trs_m)
    if isinstance(config, ScannedTerrain):
        return _scanned_terrain(config, base_dir, announce)
    if isinstance(config, FileTerrain):
        return _file_terrain(config, base_dir, announce)
    if not _fits_memory(config.shape):
        return _large_terrain(config, announce)
    return _from_cache(config, _origin(config, base_dir), announce, lambda: make_terrain(config))


def _origin(config: MadeTerrain, base_dir: Path) -> dict[str, object]:
    """Give what the heights depend on beyond the settings."""
    if isinstance(config, DemTerrain):
        dem = describe_dem(_existing_file(config.path, base_dir))
        return {
            "dem": dem.fingerprint,
            "spacing_m": dem.spacing_m,
            "origin_trs_m": dem.origin_trs_m,
        }
    if isinstance(config, FileTerrain):
        from tronlab.terrain.file import READER_VERSION
        from tronlab.terrain.raster import files_of_raster

        files = files_of_raster(_existing_file(config.path, base_dir))
        return {"reader": READER_VERSION, "sha256": _sha256(files)}
    if _fits_memory(config.shape):
        return {"generator": GENERATOR_VERSION}
    from tronlab.terrain.tiled import TILED_VERSION

    return {"generator": GENERATOR_VERSION, "tiled": TILED_VERSION}


def make_dem(
    config: ProceduralTerrain, path: Path, *, announce: Callable[[str], None] | None = None
) -> None:
    """Make a procedural terrain of any size as a file of its own.

    Args:
        config: The terrain.
        path: NAME.npy; it and NAME.json are replaced.
        announce: Is told what takes time; by default the log.

    Raises:
        TerrainError: The files cannot be written, or there is no room on the disk.
    """
    from tronlab.terrain.tiled import write_terrain

    announce = announce or logger.info
    made_by = _made_by(config, _origin(config, path.parent))
    if _fits_memory(config.shape):
        announce(_making(config))
        heightmap = _placed(config, make_terrain(config))
        save_dem(path, heightmap, made_by=made_by)
    else:
        write_terrain(config, path, made_by=made_by, announce=announce)


def _fits_memory(shape: tuple[int, int]) -> bool:
    return shape[0] * shape[1] <= MAX_SAMPLES_IN_MEMORY


def _opener(
    shape: tuple[int, int],
) -> Callable[[Path, tuple[float, float, float] | None], HeightMap]:
    """Give how a file of this shape is opened: small ones are faster to use in memory."""
    open_file = read_dem if _fits_memory(shape) else open_dem
    return lambda path, origin_trs_m: open_file(path, origin_trs_m=origin_trs_m)


def _file_terrain(
    config: FileTerrain, base_dir: Path, announce: Callable[[str], None]
) -> HeightMap:
    from tronlab.terrain.file import read_terrain

    path = _existing_file(config.path, base_dir)
    return _from_cache(
        config,
        _origin(config, base_dir),
        announce,
        lambda: read_terrain(config, path, announce=announce),
    )


def _scanned_terrain(
    config: ScannedTerrain, base_dir: Path, announce: Callable[[str], None]
) -> HeightMap:
    from tronlab.terrain.scan import SCAN_VERSION, scan

    origin = {"scanned": _origin(config.of, base_dir), "scanner": SCAN_VERSION}
    cache = cache_file(_key(config, origin))
    heightmap = find_cached(cache, None, read_dem)
    if heightmap is not None:
        return heightmap
    true = _load_heights(config.of, base_dir, announce)
    announce("scanning the terrain model (kept for the next time)")
    scanned = scan(true, config.scan)
    keep(
        lambda: save_dem(
            cache,
            scanned.heightmap,
            made_by=_made_by(config, origin),
            n_holes_filled=scanned.n_holes_filled,
        )
    )
    return scanned.heightmap


def _from_cache(
    config: ProceduralTerrain | FileTerrain,
    origin: Mapping[str, object],
    announce: Callable[[str], None],
    make: Callable[[], NDArray[np.float32]],
) -> HeightMap:
    """Give the model from the cache, or make and keep it."""
    cache = cache_file(_key(config, origin))
    heightmap = _cached(config, cache)
    if heightmap is not None:
        return heightmap
    announce(f"{_making(config)} (kept for the next time)")
    start = time.perf_counter()
    made = _placed(config, make())
    logger.info("terrain model made in %.1f s", time.perf_counter() - start)
    keep(lambda: save_dem(cache, made, made_by=_made_by(config, origin)))
    return made


def _large_terrain(config: ProceduralTerrain, announce: Callable[[str], None]) -> HeightMap:
    """Give a model that stays in its file of the cache; make it first where it is not there."""
    from tronlab.terrain.tiled import write_terrain

    origin = _origin(config, Path())
    cache = cache_file(_key(config, origin))
    heightmap = _cached(config, cache)
    if heightmap is not None:
        return heightmap
    try:
        cache_folder().mkdir(parents=True, exist_ok=True)
        write_terrain(config, cache, made_by=_made_by(config, origin), announce=announce)
    except (OSError, TerrainError) as error:
        raise TerrainError(
            f"{error}\nA terrain of {config.shape[0]} x {config.shape[1]} samples is kept in the"
            " cache folder; XDG_CACHE_HOME names another place for it"
        ) from error
    return open_dem(cache, origin_trs_m=config.origin_trs_m)


def _placed(config: ProceduralTerrain | FileTerrain, height_m: NDArray[np.float32]) -> HeightMap:
    return HeightMap(height_m, config.spacing_m, np.array(config.origin_trs_m, dtype=np.float64))


def _cached(config: ProceduralTerrain | FileTerrain, cache: Path) -> HeightMap | None:
    return find_cached(
        cache, config.shape, lambda path: _opener(config.shape)(path, config.origin_trs_m)
    )


def _making(config: ProceduralTerrain | FileTerrain) -> str:
    rows, columns = config.shape
    return f"making the terrain model of {rows} x {columns} samples"


def _made_by(
    config: ProceduralTerrain | FileTerrain | ScannedTerrain, origin: Mapping[str, object]
) -> dict[str, object]:
    return {**config.model_dump(mode="json"), **origin}


def _key(
    config: ProceduralTerrain | FileTerrain | ScannedTerrain, origin: Mapping[str, object]
) -> str:
    """Name everything the heights depend on: not where the model stands, not the file's name.

    A scan has it in its name where the scanned model stands: its scanners stand elsewhere.
    """
    names = {"path", "albedo_map"}
    settings = config.model_dump(
        mode="json", exclude={"origin_trs_m": True, **dict.fromkeys(names, True), "of": names}
    )
    text = json.dumps({**settings, **origin}, sort_keys=True)
    return f"{config.kind}-{hashlib.sha256(text.encode()).hexdigest()[:24]}"


def _existing_file(path: Path, base_dir: Path) -> Path:
    path = base_dir / path
    if not path.is_file():
        raise TerrainError(
            f"terrain file {path} does not exist; a relative path starts from {base_dir}"
        )
    return path


def _sha256(paths: Sequence[Path]) -> str:
    """Give one digest of all files; of a single one it is the file's own."""
    digests: list[str] = []
    for path in paths:
        with path.open("rb") as file:
            digests.append(hashlib.file_digest(file, "sha256").hexdigest())
    if len(digests) == 1:
        return digests[0]
    return hashlib.sha256("".join(digests).encode()).hexdigest()
