"""Where the samples of a GeoTIFF lie: from its transform and reference system to metres."""

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tronlab.terrain.formats.model import Announce
from tronlab.terrain.heightmap import TerrainError

_LARGEST_STRETCH = 2.0
"""How many times wider a degree of longitude may be at one place of a map than at another."""
_SPHEROID = re.compile(r'(?:SPHEROID|ELLIPSOID)\["[^"]*",\s*([-+.\deE]+),\s*([-+.\deE]+)')


@dataclass(frozen=True, slots=True)
class NorthUpGrid:
    """A grid in map units whose row 0 is the northern one and whose column 0 the western one.

    A file may have them the other way round; ``is_south_up`` and ``is_east_left`` say so.
    """

    shape: tuple[int, int]
    first: tuple[float, float]
    """Map coordinates x and y of the centre of sample (0, 0)."""
    step: tuple[float, float]
    """From one column and from one row to the next, both positive."""
    is_south_up: bool
    is_east_left: bool

    @property
    def last(self) -> tuple[float, float]:
        """Get the map coordinates of the last sample's centre."""
        rows, columns = self.shape
        (x, y), (step_x, step_y) = self.first, self.step
        return x + (columns - 1) * step_x, y - (rows - 1) * step_y

    def part(self, rows: slice, columns: slice) -> "NorthUpGrid":
        """Give the grid of some of its rows and columns."""
        (x, y), (step_x, step_y) = self.first, self.step
        return replace(
            self,
            shape=(rows.stop - rows.start, columns.stop - columns.start),
            first=(x + columns.start * step_x, y - rows.start * step_y),
        )


@dataclass(frozen=True, slots=True)
class Place:
    """How far apart samples are, and where the first one lies if that is known."""

    spacing_m: tuple[float, float]
    corner_m: tuple[float, float] | None
    crs: str | None


def north_up_grid(transform: Any, shape: tuple[int, int], path: Path) -> NorthUpGrid:
    """Make the grid of a file's affine transform.

    Raises:
        TerrainError: The grid is turned or sheared.
    """
    if transform.b != 0.0 or transform.d != 0.0:
        angle_deg = math.degrees(math.atan2(transform.d, transform.a))
        raise TerrainError(
            f"{path}: the grid is turned or sheared against the map (its rows run at"
            f" {angle_deg:.1f} deg); make it north-up first: gdalwarp IN.tif OUT.tif"
        )
    rows, columns = shape
    step_x, step_y = abs(transform.a), abs(transform.e)
    west = min(transform.c, transform.c + columns * transform.a)
    north = max(transform.f, transform.f + rows * transform.e)
    return NorthUpGrid(
        shape=shape,
        first=(west + step_x / 2, north - step_y / 2),
        step=(step_x, step_y),
        is_south_up=transform.e > 0.0,
        is_east_left=transform.a < 0.0,
    )


def place_of(grid: NorthUpGrid, crs: Any, path: Path, announce: Announce) -> Place:
    """Place a grid in metres.

    Args:
        grid: A file's grid or a part of it.
        crs: rasterio's reference system, or None.
        path: The file.
        announce: Is told what had to be assumed.

    Raises:
        TerrainError: Degrees that cannot be made metres.
    """
    if crs is None:
        announce(f"{path.name}: names no reference system: its map units are taken as metres")
    elif crs.is_geographic:
        return _place_of_degrees(grid, crs, path, announce)
    unit_m = metres_a_unit(crs)
    (x, y), (step_x, step_y) = grid.first, grid.step
    return Place(
        (step_y * unit_m, step_x * unit_m),
        (x * unit_m, y * unit_m),
        None if crs is None else crs.to_wkt(),
    )


def metres_a_unit(crs: Any) -> float:
    """Give how long a map unit of a reference system that is not geographic is."""
    return 1.0 if crs is None else float(crs.units_factor[1])


def _place_of_degrees(grid: NorthUpGrid, crs: Any, path: Path, announce: Announce) -> Place:
    """Lay an equirectangular map (true to scale at its middle latitude) over degrees.

    The sphere has the Gaussian radius of curvature of the body there (Snyder, Map Projections: A
    Working Manual, USGS Professional Paper 1395, 1987, chapters 4 and 12).
    """
    unit_rad = float(crs.units_factor[1])
    west_rad, north_rad = (unit_rad * angle for angle in grid.first)
    east_rad, south_rad = (unit_rad * angle for angle in grid.last)
    step_x_rad, step_y_rad = (unit_rad * angle for angle in grid.step)
    latitude_rad = (north_rad + south_rad) / 2
    stretch = _stretch(north_rad, south_rad, path)
    radius_m = _gaussian_radius_m(crs.to_wkt(), latitude_rad, path)
    longitude_deg = math.degrees((west_rad + east_rad) / 2)
    spacing_m = (
        radius_m * step_y_rad,
        radius_m * step_x_rad * math.cos(latitude_rad),
    )
    announce(
        f"{path.name}: degrees made metres at latitude {math.degrees(latitude_rad):.4g} deg:"
        f" samples are {spacing_m[0]:.6g} m apart along rows, {spacing_m[1]:.6g} m along columns;"
        f" the true width of a sample changes by {100 * (stretch - 1):.2g} % within the map"
    )
    half_width_m = radius_m * math.cos(latitude_rad) * (east_rad - west_rad) / 2
    flat = type(crs).from_proj4(
        f"+proj=eqc +lat_ts={math.degrees(latitude_rad)!r} +lon_0={longitude_deg!r}"
        f" +R={radius_m!r} +units=m +no_defs"
    )
    return Place(spacing_m, (-half_width_m, radius_m * north_rad), flat.to_wkt())


def _stretch(north_rad: float, south_rad: float, path: Path) -> float:
    """Give how many times wider a degree of longitude is at its widest than at its narrowest.

    Raises:
        TerrainError: Too many times.
    """
    narrowest = math.cos(max(abs(north_rad), abs(south_rad)))
    nearest_equator = max(south_rad, min(0.0, north_rad))
    widest = math.cos(nearest_equator)
    if widest > _LARGEST_STRETCH * narrowest:
        raise TerrainError(
            f"{path}: its grid is in degrees, from latitude {math.degrees(south_rad):.2f} to"
            f" {math.degrees(north_rad):.2f} deg: no one length of a degree of longitude fits;"
            " use a smaller part, or make it metres first: gdalwarp -t_srs CRS IN.tif OUT.tif"
        )
    return widest / narrowest


def _gaussian_radius_m(wkt: str, latitude_rad: float, path: Path) -> float:
    match = _SPHEROID.search(wkt)
    if match is None:
        raise TerrainError(f"{path}: its reference system does not say the radius of the body")
    semi_major_m, inverse_flattening = map(float, match.groups())
    flattening = 1.0 / inverse_flattening if inverse_flattening else 0.0
    e_squared = flattening * (2.0 - flattening)
    return (
        semi_major_m * math.sqrt(1.0 - e_squared) / (1.0 - e_squared * math.sin(latitude_rad) ** 2)
    )
