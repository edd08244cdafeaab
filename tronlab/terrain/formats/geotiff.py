"""GeoTIFF files by rasterio, north up, in metres whatever the units of the file."""

import math
import warnings
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tronlab.terrain.formats.georeference import metres_a_unit, north_up_grid, place_of
from tronlab.terrain.formats.model import (
    Announce,
    Heights,
    Raster,
    Window,
    WriteReport,
    check_shape,
    from_numbers,
    needs_extra,
    window_slices,
)
from tronlab.terrain.formats.writing import written_whole
from tronlab.terrain.heightmap import TerrainError

_METRES = {
    "m": 1.0,
    "metre": 1.0,
    "meter": 1.0,
    "metres": 1.0,
    "meters": 1.0,
    "km": 1000.0,
    "kilometre": 1000.0,
    "kilometer": 1000.0,
    "cm": 0.01,
    "mm": 0.001,
    "ft": 0.3048,
    "foot": 0.3048,
    "feet": 0.3048,
    "us-ft": 1200 / 3937,
    "us survey foot": 1200 / 3937,
}
_NO_UNIT = "1"
"""How a file of ours says that its heights are plain numbers."""


def read_geotiff(path: Path, window: Window | None, announce: Announce) -> Raster:
    """Read the one band of a GeoTIFF; only the window is loaded.

    Raises:
        TerrainError: rasterio is not installed, the file is damaged, has several bands, samples of
            8 bits, a grid that is turned or sheared, or degrees that cannot be made metres.
    """
    with _opened(path) as dataset:
        return _read(dataset, path, window, announce)


def files_of_geotiff(path: Path) -> tuple[Path, ...]:
    """Name the file and those beside it that say where it lies or what its units are.

    Raises:
        TerrainError: rasterio is not installed, or the file is damaged.
    """
    with _opened(path) as dataset:
        return tuple(map(Path, dataset.files))


def write_geotiff(raster: Raster, path: Path) -> WriteReport:
    """Write the heights in their own type, holes as NaN, with place and reference system.

    Raises:
        TerrainError: rasterio is not installed, or cannot make sense of the reference system.
    """
    rasterio = _rasterio(path)
    place: dict[str, Any] = {}
    if raster.crs is not None:
        place["crs"] = _crs_of(raster.crs, path)
    if raster.spacing_m is not None:
        unit_m = metres_a_unit(place.get("crs"))
        place["transform"] = _transform_of(raster, raster.spacing_m, unit_m)
    rows, columns = raster.height_m.shape
    try:
        with written_whole(path) as draft, warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with rasterio.open(
                draft,
                "w",
                driver="GTiff",
                height=rows,
                width=columns,
                count=1,
                dtype=raster.height_m.dtype.name,
                nodata=math.nan,
                tiled=True,
                compress="deflate",
                predictor=3,
                bigtiff="if_safer",
                **place,
            ) as dataset:
                dataset.write(raster.height_m, 1)
                dataset.units = ("metre" if raster.has_unit else _NO_UNIT,)
    except rasterio.errors.RasterioError as error:
        raise TerrainError(f"{path}: cannot be written as a GeoTIFF: {error}") from error
    return WriteReport(path)


@contextmanager
def _opened(path: Path) -> Generator[Any]:
    rasterio = _rasterio(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with rasterio.open(path, driver="GTiff") as dataset:
                yield dataset
    except rasterio.errors.RasterioError as error:
        raise TerrainError(f"{path}: cannot be read as a GeoTIFF: {error}") from error


def _rasterio(path: Path) -> Any:
    try:
        import rasterio
    except ImportError as error:
        raise needs_extra(path, "rasterio") from error
    return rasterio


def _read(dataset: Any, path: Path, window: Window | None, announce: Announce) -> Raster:
    _check_form(dataset, path)
    rows, columns = window_slices(window, dataset.shape, path)
    if dataset.transform.is_identity:
        announce(f"{path.name}: says neither how far apart its samples are nor where they lie")
        heights, has_unit = _heights(dataset, rows, columns, path)
        return Raster(heights, has_unit=has_unit)
    grid = north_up_grid(dataset.transform, dataset.shape, path)
    heights, has_unit = _heights(
        dataset,
        _from_the_end(rows, dataset.height) if grid.is_south_up else rows,
        _from_the_end(columns, dataset.width) if grid.is_east_left else columns,
        path,
    )
    north_up = heights[:: -1 if grid.is_south_up else 1, :: -1 if grid.is_east_left else 1]
    place = place_of(grid.part(rows, columns), dataset.crs, path, announce)
    return Raster(north_up, place.spacing_m, has_unit, place.crs, place.corner_m)


def _from_the_end(part: slice, length: int) -> slice:
    return slice(length - part.stop, length - part.start)


def _check_form(dataset: Any, path: Path) -> None:
    if dataset.count != 1:
        raise TerrainError(f"{path}: has {dataset.count} bands, a height map has one")
    kind = np.dtype(dataset.dtypes[0])
    if kind.kind not in "iuf" or kind.itemsize < 2:
        raise TerrainError(
            f"{path}: samples are {kind.name}; a height map needs floats or integers of 16 bits or"
            " more"
        )
    check_shape(dataset.shape, path)


def _heights(dataset: Any, rows: slice, columns: slice, path: Path) -> tuple[Heights, bool]:
    """Read a part of the file, in metres if the file has a unit, and whether it has one."""
    samples = dataset.read(
        1, window=((rows.start, rows.stop), (columns.start, columns.stop)), masked=True
    )
    unit, scale = dataset.units[0] or "", dataset.scales[0]
    if unit not in ("", _NO_UNIT) and unit.lower() not in _METRES:
        allowed = ", ".join(_METRES)
        raise TerrainError(f"{path}: heights are in {unit!r} (allowed: {allowed})")
    unit_m = _METRES.get(unit.lower(), 1.0)
    heights = from_numbers(
        samples.data,
        scale=unit_m * scale,
        offset=unit_m * dataset.offsets[0],
        holes=np.ma.getmask(samples),
    )
    is_usual_in_metres = samples.dtype.kind == "f" or scale != 1.0
    return heights, unit != _NO_UNIT and (unit != "" or is_usual_in_metres)


def _crs_of(wkt: str, path: Path) -> Any:
    import rasterio.crs
    import rasterio.errors

    try:
        return rasterio.crs.CRS.from_wkt(wkt)
    except rasterio.errors.CRSError as error:
        raise TerrainError(f"{path}: the reference system cannot be written: {error}") from error


def _transform_of(raster: Raster, spacing_m: tuple[float, float], unit_m: float) -> Any:
    """Give the affine transform to map units; without a known place the first sample lies at 0."""
    from rasterio.transform import Affine

    (along_rows_m, along_columns_m), (x_m, y_m) = spacing_m, raster.corner_m or (0.0, 0.0)
    return Affine(
        along_columns_m / unit_m,
        0.0,
        (x_m - along_columns_m / 2) / unit_m,
        0.0,
        -along_rows_m / unit_m,
        (y_m + along_rows_m / 2) / unit_m,
    )
