"""Height maps kept on disk: a NumPy file followed by a checksum of its heights.

A file that is missing, damaged or unreadable is no error: the heights are made again. A folder
that cannot be written to costs time, not the run.
"""

import logging
import os
import tempfile
import zlib
from pathlib import Path

import numpy as np
import platformdirs
from numpy.typing import NDArray

logger = logging.getLogger(__name__)

_CHECKSUM_BYTES = 4


def cache_file(key: str) -> Path:
    """Give where the heights with this key are kept: in the user's cache folder."""
    return platformdirs.user_cache_path("tronlab") / "terrain" / f"{key}.npy"


def load_heights(path: Path, shape: tuple[int, int]) -> NDArray[np.float32] | None:
    """Read heights, shape ``shape``; None if there are none or the file is damaged."""
    try:
        with path.open("rb") as file:
            height_m = np.load(file, allow_pickle=False)
            checksum = file.read()
    except FileNotFoundError:
        return None
    except (OSError, ValueError, EOFError) as error:
        logger.warning("cached terrain %s cannot be read and is made again: %s", path, error)
        return None
    if (height_m.shape, height_m.dtype, checksum) != (shape, np.float32, _checksum(height_m)):
        logger.warning("cached terrain %s is damaged and is made again", path)
        return None
    return height_m


def save_heights(path: Path, height_m: NDArray[np.float32]) -> None:
    """Write heights under a temporary name first, so that no half-written file is ever found."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    except OSError as error:
        logger.warning("the terrain is not cached: %s", error)
        return
    try:
        with os.fdopen(handle, "wb") as file:
            np.save(file, height_m)
            file.write(_checksum(height_m))
        Path(name).replace(path)
    except OSError as error:
        Path(name).unlink(missing_ok=True)
        logger.warning("the terrain is not cached: %s", error)


def _checksum(height_m: NDArray[np.float32]) -> bytes:
    return zlib.crc32(np.ascontiguousarray(height_m).data).to_bytes(_CHECKSUM_BYTES)
