# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""The shadows of a lamp on all nodes of the terrain at once, by a sweep around the lamp.

Straight lines over the plan of the model start under the lamp. Along each, the horizon is carried
outwards: of the slopes from the lamp down to the surface met so far the highest. A node sees the
lamp if the slope down to it is higher still.

The plan falls into four sectors, by the axis along which a line advances faster and the direction
in which it does. Turned by half a turn or with the axes exchanged, the surface has its triangles
cut along the same diagonals: so all sectors are swept alike, row after row away from the lamp.
Neighbouring lines are never farther apart than nodes (``sectors``: closer, fewer errors). Along a
line the surface is straight between the edges of the triangles, so its highest slopes are those at
the crossings of edges. Between two lines the horizon is interpolated linearly, but for the cell
just before a node: there its own ray is followed, which else would often be hidden by a neighbour
of the very triangle that the node is seen over.

For a lamp that has a size the horizons of several points on the vertical through its centre are
carried at once. They tell from which height on the node would see it; the disk's share over that
height is what the node sees.

A band of neighbouring lines is swept by itself, so that its horizons and its part of the heights
stay in the processor's cache.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.render.lamp.sectors import sectors
from tronlab.render.lighting import SHADOW_OFFSET_M
from tronlab.render.quadtree import Grid
from tronlab.render.surface import triangle
from tronlab.terrain.kernels import compiled, inlined, run_interleaved

LIT = np.uint8(255)
DARK = np.uint8(0)

_BAND = 256
_NO_HORIZON = -1e30
# Heights of a finite lamp whose horizons are carried, and how far they reach up and down in radii.
# Seen from below at an angle its disk stands askew and reaches over 1 / cos(elevation) radii of the
# vertical through its centre; lamps over 44 degrees up hardly make shadows.
_N_LEVELS = 6
_REACH = 1.4


class Source(NamedTuple):
    """The lamp as the sweep sees it."""

    z_m: float
    radius_m: float
    heights_m: tuple[float, ...]
    """Of the points straight below and above its centre whose horizons are carried: the centre
    alone of a point."""


def sweep(
    grid: Grid,
    lamp: NDArray[np.float64],
    radius_m: float,
    visibility: NDArray[np.uint8],
    *,
    n_threads: int,
) -> None:
    """Fill in how much of a lamp the nodes see: LIT, DARK or, in a penumbra, between.

    Args:
        grid: The surface.
        lamp: Where the lamp is in grid coordinates: two in cells, the third in metres.
        radius_m: Of the lamp.
        visibility: To be filled, shape as the heights.
        n_threads: How many threads may run at once; the result does not depend on it.
    """
    # A lamp not quite over a row would see it at no distance.
    lamp_r, lamp_c, lamp_z = round(float(lamp[0]), 6), round(float(lamp[1]), 6), float(lamp[2])
    ground_m = _ground_m(grid.height_m, lamp_r, lamp_c)
    if lamp_r.is_integer() and lamp_c.is_integer() and ground_m > -np.inf:
        # The node straight under the lamp is the only one that is in no sector.
        visibility[int(lamp_r), int(lamp_c)] = LIT if lamp_z > ground_m else DARK
    run_interleaved(
        _sweep_bands,
        grid.height_m.reshape(-1),
        visibility.reshape(-1),
        sectors(grid.height_m.shape, lamp_r, lamp_c),
        _source(lamp_z, radius_m),
        ground_m,
        grid.spacing_m,
        n_threads=n_threads,
    )


def _source(z_m: float, radius_m: float) -> Source:
    levels = np.linspace(-1, 1, _N_LEVELS) * _REACH if radius_m > 0 else np.zeros(1)
    return Source(z_m, radius_m, tuple(float(z_m + radius_m * level) for level in levels))


def _ground_m(height_m, lamp_r, lamp_c) -> float:
    """Give the height of the surface where the lamp is, minus infinity beside the model."""
    n_rows, n_columns = height_m.shape
    if not (0 <= lamp_r <= n_rows - 1 and 0 <= lamp_c <= n_columns - 1):
        return -np.inf
    i, j = min(int(lamp_r), n_rows - 2), min(int(lamp_c), n_columns - 2)
    a, b = lamp_r - i, lamp_c - j
    low, slope_r, slope_c = triangle(height_m, i, j, b >= a)
    return low + slope_r * a + slope_c * b


@compiled
def _sweep_bands(height, visibility, sectors, source, ground_m, spacing, part, n_parts):
    """Sweep the part-th of every n_parts bands of lines, over all sectors."""
    horizon = np.empty((_BAND + 1, len(source.heights_m)))
    number = 0
    for sector in sectors:
        for band in range(0, sector.n_lines - 1, _BAND):
            if number % n_parts == part:
                for level in range(len(source.heights_m)):
                    is_buried = source.heights_m[level] < ground_m
                    horizon[:, level] = -_NO_HORIZON if is_buried else _NO_HORIZON
                _sweep_band(height, visibility, sector, source, spacing, band, horizon)
            number += 1


@inlined
def _sweep_band(height, visibility, sector, source, spacing, band, horizon):
    """Sweep the lines from number ``band`` on, and judge the nodes between them."""
    n_gaps = min(horizon.shape[0], sector.n_lines - band) - 1
    least = sector.first_slope + band * sector.slope_step
    most = sector.first_slope + (band + n_gaps) * sector.slope_step
    for row in range(sector.first_row, sector.n_rows):
        distance = row - sector.lamp_row
        first = sector.lamp_column + least * distance
        last = sector.lamp_column + most * distance
        if first > sector.n_columns or last < -1.0:
            continue
        low, high = _own_columns(sector, distance)
        if band > 0:
            low = max(low, int(np.ceil(first)))
        if band + n_gaps < sector.n_lines - 1:
            high = min(high, int(np.ceil(last)))
        # The lines know nothing yet of the cells just before this row: a node looks there itself.
        _judge(height, visibility, sector, source, spacing, row, low, high, first, n_gaps, horizon)
        if row > sector.first_row:
            _raise(height, sector, source, row - 1, least, n_gaps, horizon)


@inlined
def _own_columns(sector, distance):
    """Give the first column of a row's nodes in the sector, and the first beyond."""
    low = max(int(np.ceil(sector.lamp_column - distance)) - 1, 0)
    high = min(int(np.floor(sector.lamp_column + distance)) + 2, sector.n_columns)
    while low < high and not _is_own(sector, low, distance):
        low += 1
    while low < high and not _is_own(sector, high - 1, distance):
        high -= 1
    return low, high


@inlined
def _is_own(sector, column, distance):
    aside = abs(column - sector.lamp_column)
    return aside < distance or (aside == distance and sector.has_diagonals)


@inlined
def _judge(height, visibility, sector, source, spacing, row, low, high, first, n_gaps, horizon):
    """Compare nodes of a row with the horizons of the lines on both sides, and the cell before."""
    distance = row - sector.lamp_row
    per_gap = 1.0 / (sector.slope_step * distance)
    per_m = np.float32(1.0 / spacing)
    to_row = sector.per_row if row > 0 else 0
    for column in range(low, high):
        node = sector.start + row * sector.per_row + column * sector.per_column
        to_column = sector.per_column if column > 0 else 0
        slope_r = (height[node] - height[node - to_row]) * per_m
        slope_c = (height[node] - height[node - to_column]) * per_m
        # So far up the point is that lies SHADOW_OFFSET_M off the surface along its normal.
        steepness = np.sqrt(np.float32(1.0) + slope_r * slope_r + slope_c * slope_c)
        z = float(height[node]) + SHADOW_OFFSET_M * steepness
        edges = _edges_before(height, sector, row, column)
        place = (column - first) * per_gap
        k = min(max(int(place), 0), n_gaps - 1)
        part = min(max(place - k, 0.0), 1.0)
        if len(source.heights_m) == 1:
            over = _over(horizon, k, part, 0, source, z, distance, edges)
            visibility[node] = LIT if over >= 0.0 else DARK
        else:
            aside = column - sector.lamp_column
            away = np.sqrt(distance * distance + aside * aside) * spacing
            visibility[node] = _share(horizon, k, part, source, z, distance, away, edges)


@inlined
def _edges_before(height, sector, row, column):
    """Give where the ray from the lamp to a node meets edges on its last way from row to row.

    That is the side between two nodes of the row before and, running to the left, a diagonal.

    Returns:
        Of each of the two the height, and how many times farther away from the lamp the node is.
    """
    distance = row - sector.lamp_row
    aside = (column - sector.lamp_column) / distance
    left = column - 1 if aside > 0.0 else column
    if distance <= 1.0 or row == 0 or left < 0 or left >= sector.n_columns - 1:
        return _NO_HORIZON, 1.0, _NO_HORIZON, 1.0
    node = sector.start + (row - 1) * sector.per_row + left * sector.per_column
    z00 = float(height[node])
    z01 = float(height[node + sector.per_column])
    near = distance / (distance - 1.0)
    if aside > 0.0:
        return z01 + aside * (z00 - z01), near, _NO_HORIZON, 1.0
    z11 = float(height[node + sector.per_row + sector.per_column])
    part = -aside / (1.0 - aside)
    diagonal = distance / (distance - 1.0 + part)
    return z00 - aside * (z01 - z00), near, z00 + part * (z11 - z00), diagonal


@inlined
def _over(horizon, k, part, level, source, z, distance, edges):
    """Give how far a node is over the line from one height of the lamp that grazes the horizon."""
    lamp_z = source.heights_m[level]
    hidden = ((1.0 - part) * horizon[k, level] + part * horizon[k + 1, level]) * distance
    near, times, diagonal, diagonal_times = edges
    hidden = max(hidden, (near - lamp_z) * times, (diagonal - lamp_z) * diagonal_times)
    return z - lamp_z - hidden


@inlined
def _share(horizon, k, part, source, z, distance, away, edges):
    """Give the share of the lamp's disk over the horizon, 255 for the whole.

    The horizon is taken to be level across the disk.
    """
    below = source.heights_m[0]
    over_below = _over(horizon, k, part, 0, source, z, distance, edges)
    if over_below >= 0.0:
        return LIT
    rise = 0.0
    for level in range(1, len(source.heights_m)):
        above = source.heights_m[level]
        over = _over(horizon, k, part, level, source, z, distance, edges)
        if over >= 0.0:
            grazing = _grazing(below, above, over_below, over, rise)
            break
        rise = (over - over_below) / (above - below)
        below = above
        over_below = over
    else:
        return DARK
    up = grazing - source.z_m
    fall = source.z_m - z
    t = up / source.radius_m * away / np.sqrt(away * away + fall * fall)
    if t <= -1.0:
        return LIT
    if t >= 1.0:
        return DARK
    return np.uint8(np.floor((np.arccos(t) - t * np.sqrt(1.0 - t * t)) / np.pi * 255.0 + 0.5))


@inlined
def _grazing(below, above, over_below, over, rise):
    """Give the height of the lamp from which the node is just seen, between two levels.

    What hides the lower level goes on to rise with the lamp at the rate it had below, if any level
    is below that; once it hides the lamp no longer, the ground before the node does nearly.
    """
    if rise > 0.0:
        return min(below - over_below / rise, above)
    return below + (above - below) * over_below / (over_below - over)


@inlined
def _raise(height, sector, source, row, least, n_gaps, horizon):
    """Raise the lines' horizons by what lies from this row on to just before the next one.

    In a cell a line enters by its near side, at ``f``, and crosses edges on its way to the far one:
    the diagonal from the near side's left end to the far side's right end, or first the right side;
    running to the left the diagonal, and perhaps the left side and the diagonal behind it.
    """
    distance = row - sector.lamp_row
    spacing = sector.slope_step * distance
    lowest = sector.lamp_column + least * distance
    low = max(int(np.ceil(-lowest / spacing)), 0)
    high = min(int(np.floor((sector.n_columns - 1 - lowest) / spacing)), n_gaps)
    to_next = sector.per_row if row < sector.n_rows - 1 else 0
    for k in range(low, high + 1):
        place = lowest + k * spacing
        column = min(max(int(place), 0), sector.n_columns - 2)
        f = min(max(place - column, 0.0), 1.0)
        node = sector.start + row * sector.per_row + column * sector.per_column
        z00 = float(height[node])
        z01 = float(height[node + sector.per_column])
        _lift(horizon, k, source, z00 + f * (z01 - z00), 1.0, distance)
        if to_next != 0:
            z11 = float(height[node + to_next + sector.per_column])
            aside = least + k * sector.slope_step
            if aside >= 0.0:
                is_diagonal = f + aside < 1.0 or aside == 0.0
                z = z00 if is_diagonal else z01
                part = f if is_diagonal else 1.0 - f
                whole = 1.0 - aside if is_diagonal else aside
                _lift_at(horizon, k, source, z, z11, part, whole, distance)
            else:
                _lift_at(horizon, k, source, z00, z11, f, 1.0 - aside, distance)
                if f < -aside and column > 0:
                    z10 = float(height[node + to_next])
                    z = float(height[node - sector.per_column])
                    _lift_at(horizon, k, source, z00, z10, f, -aside, distance)
                    _lift_at(horizon, k, source, z, z10, 1.0 + f, 1.0 - aside, distance)


@inlined
def _lift_at(horizon, k, source, z_0, z_1, part, whole, distance):
    """Raise a line's horizons to part / whole of an edge from a row to the next one."""
    _lift(horizon, k, source, z_0 * whole + part * (z_1 - z_0), whole, distance * whole + part)


@inlined
def _lift(horizon, k, source, z, whole, distance):
    """Raise a line's horizons to a height at a distance, both times ``whole``."""
    per_distance = 1.0 / distance
    for level in range(len(source.heights_m)):
        slope = (z - source.heights_m[level] * whole) * per_distance
        horizon[k, level] = max(horizon[k, level], slope)
