"""Height maps in and out of files: the format follows from the file's suffix."""

import logging
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TypeVar

from tronlab.terrain.formats.geotiff import files_of_geotiff, read_geotiff, write_geotiff
from tronlab.terrain.formats.mesh import MESH_WRITERS, OnProgress, mesh_of
from tronlab.terrain.formats.model import Announce, Raster, Window, WriteReport
from tronlab.terrain.formats.numpy_file import read_npy, write_npy
from tronlab.terrain.formats.pds3 import files_of_pds3, read_pds3
from tronlab.terrain.formats.png import read_png, write_png
from tronlab.terrain.heightmap import HeightMap, TerrainError

__all__ = [
    "MESH_SUFFIXES",
    "READABLE_SUFFIXES",
    "WRITABLE_SUFFIXES",
    "Raster",
    "Window",
    "WriteReport",
    "files_of_raster",
    "read_raster",
    "write_mesh",
    "write_raster",
]

logger = logging.getLogger(__name__)
T = TypeVar("T")

_READERS: Mapping[str, Callable[[Path, Window | None, Announce], Raster]] = {
    ".npy": read_npy,
    ".png": read_png,
    ".tif": read_geotiff,
    ".tiff": read_geotiff,
    ".img": read_pds3,
    ".lbl": read_pds3,
}
_WRITERS: Mapping[str, Callable[[Raster, Path], WriteReport]] = {
    ".npy": write_npy,
    ".png": write_png,
    ".tif": write_geotiff,
    ".tiff": write_geotiff,
}
READABLE_SUFFIXES = tuple(_READERS)
WRITABLE_SUFFIXES = tuple(_WRITERS)
MESH_SUFFIXES = tuple(MESH_WRITERS)


def read_raster(
    path: Path, *, window: Window | None = None, announce: Announce = logger.info
) -> Raster:
    """Read a height map: 16-bit PNG, NumPy file, GeoTIFF, or PDS3 image with its label.

    Args:
        path: The file; for PDS3 the label or the image.
        window: Only this part; the rest of a GeoTIFF, PDS3 or NumPy file is not loaded.
        announce: Is told what the file leaves open and how that was settled.

    Raises:
        TerrainError: No such file, of no known format, damaged, not a height map, or the window
            reaches outside.
    """
    if not path.is_file():
        raise TerrainError(f"{path}: does not exist or is not a file")
    return _of_suffix(_READERS, path, "read")(path, window, announce)


def files_of_raster(path: Path) -> tuple[Path, ...]:
    """Name all files that ``read_raster`` reads: some formats keep a label or a place apart.

    Raises:
        TerrainError: As ``read_raster``.
    """
    find = {
        ".tif": files_of_geotiff,
        ".tiff": files_of_geotiff,
        ".img": files_of_pds3,
        ".lbl": files_of_pds3,
    }.get(path.suffix.lower())
    return (path,) if find is None else find(path)


def write_raster(raster: Raster, path: Path) -> WriteReport:
    """Write a height map as 16-bit PNG, NumPy file or GeoTIFF, whole or not at all.

    Raises:
        TerrainError: The format is not one of these, cannot hold the heights, or the file cannot
            be written.
    """
    return _of_suffix(_WRITERS, path, "written")(raster, path)


def write_mesh(
    height_map: HeightMap,
    path: Path,
    *,
    every_n: int = 1,
    announce: Announce = logger.info,
    on_progress: OnProgress = lambda _done, _all: None,
) -> None:
    """Write the surface as triangles in F_TRS, metres: binary PLY, binary STL or OBJ.

    The triangles are the renderer's: in each cell of four nodes two of them, which share the
    edge from node (i, j) to node (i + 1, j + 1). Rows go to the file a few at a time.

    Args:
        height_map: The surface.
        path: The file, .ply, .stl or .obj.
        every_n: Use only every n-th node along rows and columns; where the last ones do not fit,
            the mesh ends up to n - 1 samples before the height map.
        announce: Is told the size of the mesh.
        on_progress: Is told rows done and rows in all.

    Raises:
        TerrainError: Another suffix, no cell left, too many triangles for the format, or the file
            cannot be written.
    """
    write = _of_suffix(MESH_WRITERS, path, "written")
    write(mesh_of(height_map, every_n, path, announce), path, on_progress)


def _of_suffix(by_suffix: Mapping[str, T], path: Path, verb: str) -> T:
    if path.suffix.lower() not in by_suffix:
        raise TerrainError(f"{path}: cannot be {verb} (allowed: {_listed(by_suffix)})")
    return by_suffix[path.suffix.lower()]


def _listed(suffixes: Iterable[str]) -> str:
    return ", ".join(".png of 16 bit" if suffix == ".png" else suffix for suffix in suffixes)
