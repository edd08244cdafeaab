"""NumPy files: float32 and float64 in metres, int16 and uint16 as numbers without a unit.

tronlab's own file of a terrain model is one too: its description gives the spacing.
"""

from pathlib import Path

import numpy as np

from tronlab.terrain.dem import description_path, open_dem
from tronlab.terrain.formats.model import (
    Announce,
    Raster,
    Window,
    WriteReport,
    check_shape,
    from_numbers,
    window_slices,
)
from tronlab.terrain.formats.writing import written_whole
from tronlab.terrain.heightmap import TerrainError

_OWN_FORMAT = b'"tronlab-dem"'
_TYPES = ("float32", "float64", "int16", "uint16")


def read_npy(path: Path, window: Window | None, announce: Announce) -> Raster:
    """Map a NumPy file into memory: floats stay on disk until they are looked at.

    Raises:
        TerrainError: Not a NumPy file, damaged, or of another type or shape.
    """
    try:
        samples = np.load(path, allow_pickle=False, mmap_mode="r")
    except (OSError, ValueError, EOFError) as error:
        raise TerrainError(f"{path}: cannot be read as a NumPy array: {error}") from error
    if not isinstance(samples, np.ndarray):
        samples.close()
        raise TerrainError(f"{path}: is an archive of arrays, expected a single NumPy array")
    if samples.dtype.name not in _TYPES:
        allowed = ", ".join(_TYPES)
        raise TerrainError(f"{path}: samples are {samples.dtype.name} (allowed: {allowed})")
    check_shape(samples.shape, path)
    part = np.asarray(samples)[window_slices(window, samples.shape, path)]
    return Raster(
        from_numbers(part), _described_spacing_m(path), has_unit=samples.dtype.kind == "f"
    )


def _described_spacing_m(path: Path) -> tuple[float, float] | None:
    """Give the spacing of a terrain model, checking its file; None for any other NumPy file."""
    beside = description_path(path)
    if not beside.is_file() or _OWN_FORMAT not in beside.read_bytes():
        return None
    spacing_m = open_dem(path).spacing_m
    return spacing_m, spacing_m


def write_npy(raster: Raster, path: Path) -> WriteReport:
    """Write the heights alone, in their own type."""
    with written_whole(path) as draft, draft.open("wb") as file:
        np.save(file, raster.height_m)
    known = {
        "spacing": raster.spacing_m,
        "coordinate reference system": raster.crs,
        "place on the map": raster.corner_m,
        "that heights have no unit": not raster.has_unit,
    }
    return WriteReport(path, not_kept=tuple(name for name, value in known.items() if value))
