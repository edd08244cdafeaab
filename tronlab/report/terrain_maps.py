"""Maps of a terrain: shaded relief coloured by height, and slope."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.terrain.lengths import height_unit, length_text

HEIGHT_COLOURS = "cividis"
SLOPE_COLOURS = "inferno"
HOLE_COLOUR = "#e41a1c"

_COLOUR_SHARE = 0.55
"""How much of the height's colour is mixed into the grey of the relief."""
_AMBIENT = 0.08
_LEVEL_GROUND = 0.55
"""Brightness of level ground: slopes that face the light are brighter, others darker."""
_STEEPEST_PERCENTILE = 99.5
_BAR_SHARE = 0.25


@dataclass(frozen=True, slots=True)
class TerrainMap:
    """What the maps are drawn from: averaged heights, and where they lie."""

    height_m: FloatArray
    """Shape (rows, columns); NaN where there is a hole."""
    spacing_m: tuple[float, float]
    """Distance of these heights along X and Y."""
    corner_m: tuple[float, float]
    """X and Y of the map's outer corner."""

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """Get left, right, lower and upper border as drawn: Y to the right, X down."""
        (x, y), (rows, columns) = self.corner_m, self.height_m.shape
        return y, y + columns * self.spacing_m[1], x + rows * self.spacing_m[0], x

    @property
    def gradient(self) -> tuple[FloatArray, FloatArray]:
        """Get the rise over run along X and along Y, by central differences."""
        return (
            np.asarray(np.gradient(self.height_m, self.spacing_m[0], axis=0)),
            np.asarray(np.gradient(self.height_m, self.spacing_m[1], axis=1)),
        )

    @property
    def height_range_m(self) -> tuple[float, float]:
        """Get the lowest and the highest height drawn."""
        return float(np.nanmin(self.height_m)), float(np.nanmax(self.height_m))


def shading(terrain: TerrainMap, p_light_m: FloatArray) -> FloatArray:
    """Give the brightness of a matt surface lit by a point, level ground in the middle at 1.

    Args:
        terrain: The surface.
        p_light_m: Where the light is, shape (3,), in the coordinates of the map; may be far away.

    Returns:
        Cosines of incidence, shape as the heights; 0 where a slope faces away. Nothing casts a
        shadow: this is how slopes are read best, not how the terrain looks.
    """
    left, right, low, high = terrain.extent_m
    rows, columns = terrain.height_m.shape
    x = high + (np.arange(rows)[:, None] + 0.5) * terrain.spacing_m[0]
    y = left + (np.arange(columns) + 0.5) * terrain.spacing_m[1]
    # Beside a hole nobody knows the slope: it is drawn level.
    along_x, along_y = map(np.nan_to_num, terrain.gradient)
    to_x, to_y = p_light_m[0] - x, p_light_m[1] - y
    to_z = p_light_m[2] - terrain.height_m
    facing = to_z - along_x * to_x - along_y * to_y
    facing /= np.sqrt((1 + along_x**2 + along_y**2) * (to_x**2 + to_y**2 + to_z**2))
    middle = np.array([(high + low) / 2, (left + right) / 2, np.nanmean(terrain.height_m)])
    to_light = p_light_m - middle
    return np.maximum(facing, 0.0) * float(np.linalg.norm(to_light) / to_light[2])


def relief_picture(terrain: TerrainMap, p_light_m: FloatArray) -> NDArray[np.float64]:
    """Give the shaded relief coloured by height, shape (rows, columns, 3), 0 to 1."""
    low, high = terrain.height_range_m
    colours = colormaps[HEIGHT_COLOURS]((terrain.height_m - low) / max(high - low, 1e-300))
    tint = _COLOUR_SHARE * colours[..., :3] / colours[..., :3].mean() + 1 - _COLOUR_SHARE
    brightness = _AMBIENT + (1 - _AMBIENT) * _LEVEL_GROUND * shading(terrain, p_light_m)
    picture = np.clip(tint * brightness[..., None], 0.0, 1.0)
    picture[~np.isfinite(terrain.height_m)] = tuple(
        int(HOLE_COLOUR[i : i + 2], 16) / 255 for i in (1, 3, 5)
    )
    return picture


def draw_relief(axes: Axes, terrain: TerrainMap, p_light_m: FloatArray) -> None:
    """Draw the shaded relief with a colour bar of the heights and a scale bar."""
    picture = relief_picture(terrain, p_light_m)
    axes.imshow(picture, extent=terrain.extent_m, interpolation="antialiased")
    low, high = terrain.height_range_m
    factor, unit = height_unit(high - low)
    heights = ScalarMappable(Normalize(factor * low, factor * high), HEIGHT_COLOURS)
    _colour_bar(axes, heights, f"Z [{unit}]")
    _label(axes)
    _draw_scale_bar(axes, terrain)


def draw_slopes(axes: Axes, terrain: TerrainMap) -> None:
    """Draw the slope in degrees, as steep as it is over twice the distance of the heights."""
    slope_deg = np.degrees(np.arctan(np.hypot(*terrain.gradient)))
    steepest = float(np.nanpercentile(slope_deg, _STEEPEST_PERCENTILE))
    image = axes.imshow(
        slope_deg,
        extent=terrain.extent_m,
        cmap=SLOPE_COLOURS,
        vmin=0.0,
        vmax=max(steepest, 1e-6),
        interpolation="antialiased",
    )
    base_m = 2 * max(terrain.spacing_m)
    axes.set_facecolor(HOLE_COLOUR)
    _colour_bar(axes, image, f"slope over {length_text(base_m)} [deg]", extend="max")
    _label(axes)


def round_length(most_m: float) -> float:
    """Give the longest of 1, 2 and 5 times a power of ten that is not longer."""
    power = 10.0 ** np.floor(np.log10(most_m))
    return float(max(step * power for step in (1, 2, 5) if step * power <= most_m * (1 + 1e-9)))


def _label(axes: Axes) -> None:
    axes.set_xlabel("Y [m] →")
    axes.set_ylabel("← X [m]")


def _colour_bar(axes: Axes, mappable: ScalarMappable, label: str, **look: Any) -> None:
    figure = axes.get_figure(root=True)
    if figure is not None:
        figure.colorbar(mappable, ax=axes, shrink=0.85, pad=0.01, aspect=30, label=label, **look)


def _draw_scale_bar(axes: Axes, terrain: TerrainMap) -> None:
    left, right, low, high = terrain.extent_m
    width, height = right - left, low - high
    length = round_length(_BAR_SHARE * width)
    x, y = left + 0.03 * width, low - 0.04 * height
    thick = 0.012 * height
    axes.add_patch(
        Rectangle((x, y - thick), length, thick, facecolor="white", edgecolor="black", lw=0.8)
    )
    axes.text(
        x + length / 2,
        y - 1.6 * thick,
        length_text(length),
        ha="center",
        va="bottom",
        fontsize=8,
        color="white",
        bbox={"facecolor": "black", "alpha": 0.5, "pad": 1.5, "edgecolor": "none"},
    )
