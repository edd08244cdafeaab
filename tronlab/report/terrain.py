"""The sheet that shows a terrain: maps above, charts below."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure

from tronlab.geometry.poses import FloatArray
from tronlab.report.style import new_figure, note, style_context
from tronlab.report.terrain_charts import (
    draw_crater_counts,
    draw_deviograms,
    draw_heights,
    draw_profile,
    draw_slope_shares,
    draw_spectrum,
)
from tronlab.report.terrain_maps import TerrainMap, draw_relief, draw_slopes
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.crater_counts import count_craters, craters_of
from tronlab.terrain.formats.model import Heights
from tronlab.terrain.formats.writing import written_whole
from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.lengths import length_text
from tronlab.terrain.overview import overview
from tronlab.terrain.statistics import (
    SelfAffine,
    deviogram,
    facet_gradients,
    hurst_fit,
    profile_spectrum,
)

SUFFIXES = (".png", ".jpg", ".pdf")

_MOST_SAMPLES = 2_000_000
"""Enough for each map to have more samples than pixels."""
_WIDTH_IN = 16.0
_MAP_HEIGHT_IN = (2.4, 9.0)
_CHART_HEIGHT_IN = 3.1
_LIGHT_DISTANCE = 1000.0
"""In widths of the map: rays are parallel as far as one can see."""


@dataclass(frozen=True, slots=True)
class TerrainSubject:
    """What a sheet shows."""

    title: str
    height_m: Heights
    """Shape (rows, columns); rows run along X, columns along Y; NaN in holes."""
    spacing_m: tuple[float, float]
    origin_trs_m: FloatArray
    """Where sample (0, 0) would lie at height 0, shape (3,)."""
    asked: ProceduralTerrain | None = None
    """What it was made from, if it was."""
    p_lamp_trs_m: FloatArray | None = None
    """Where the light is, shape (3,); by default far away to the upper left, 45 degrees high."""

    @property
    def roughness(self) -> SelfAffine | None:
        """Get the roughness asked for."""
        if self.asked is None or self.asked.roughness_slope == 0.0:
            return None
        return SelfAffine(self.asked.hurst_exponent, self.asked.roughness_slope, base_m=0.01)


def terrain_sheet(
    subject: TerrainSubject, *, on_progress: Callable[[int, int], None] | None = None
) -> Figure:
    """Draw a terrain: shaded relief, slopes, histograms, a profile, craters and roughness.

    Args:
        subject: The terrain; its heights may lie in a mapped file of any size.
        on_progress: Is told how much of the map is averaged for drawing.

    Raises:
        TerrainError: It has nothing but holes, or the lamp lies under its surface.
    """
    terrain = _terrain_map(subject, on_progress)
    p_light_m = _light(subject, terrain)
    rows, columns = terrain.height_m.shape
    shape = rows * terrain.spacing_m[0] / (columns * terrain.spacing_m[1])
    map_height_in = float(np.clip(0.42 * _WIDTH_IN * shape + 0.5, *_MAP_HEIGHT_IN))
    with style_context():
        figure = new_figure(_WIDTH_IN, map_height_in + 2 * _CHART_HEIGHT_IN + 0.4)
        holes = "" if np.isfinite(terrain.height_m).all() else "; holes are red"
        figure.suptitle(_heading(subject) + holes, fontsize=10)
        heights_in = [map_height_in, 2 * _CHART_HEIGHT_IN]
        maps, charts = figure.add_gridspec(2, 1, height_ratios=heights_in)
        above, below = figure.add_subfigure(maps), figure.add_subfigure(charts)
        relief, slopes = above.subplots(1, 2)
        draw_relief(relief, terrain, p_light_m)
        draw_slopes(slopes, terrain)
        shape, laws = below.subplots(2, 3)
        _draw_shape(shape, subject, terrain, relief)
        _draw_laws(laws, subject)
    return figure


def save_sheet(figure: Figure, path: Path) -> None:
    """Save a sheet as PNG, JPEG or PDF by suffix.

    Raises:
        TerrainError: It is another suffix, or the file cannot be written.
    """
    check_suffix(path)
    with written_whole(path) as draft, style_context():
        _print(figure, draft)


def _print(figure: Figure, path: Path) -> None:
    match path.suffix.lower():
        case ".png":
            FigureCanvasAgg(figure).print_png(path, metadata={"Software": None})
        case ".jpg":
            options: dict[str, Any] = {"quality": 85, "optimize": True}
            FigureCanvasAgg(figure).print_jpg(path, pil_kwargs=options)
        case _:
            FigureCanvasPdf(figure).print_pdf(path, metadata={"CreationDate": None})


def check_suffix(path: Path) -> None:
    """Refuse what no picture can be saved as.

    Raises:
        TerrainError: The suffix is none of ``SUFFIXES``.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise TerrainError(f"{path}: a picture's name ends in one of {', '.join(SUFFIXES)}")


def _terrain_map(
    subject: TerrainSubject, on_progress: Callable[[int, int], None] | None
) -> TerrainMap:
    height_m, n = overview(subject.height_m, most_samples=_MOST_SAMPLES, on_progress=on_progress)
    if min(height_m.shape) < 2 or not np.isfinite(height_m).any():
        raise TerrainError(f"{subject.title}: has no heights to draw, shape {height_m.shape}")
    dx, dy = subject.spacing_m
    x, y, z = subject.origin_trs_m
    return TerrainMap(height_m + z, (n * dx, n * dy), (x - dx / 2, y - dy / 2))


def _light(subject: TerrainSubject, terrain: TerrainMap) -> FloatArray:
    """Give where the light is."""
    left, right, low, high = terrain.extent_m
    top = terrain.height_range_m[1]
    middle = np.array([(low + high) / 2, (left + right) / 2, top])
    if subject.p_lamp_trs_m is None:
        upper_left = np.array([-1.0, -1.0, np.sqrt(2.0)])
        return middle + _LIGHT_DISTANCE * max(right - left, low - high) * upper_left
    if subject.p_lamp_trs_m[2] <= top:
        raise TerrainError(
            f"the lamp at {subject.p_lamp_trs_m.tolist()} m is not above the terrain, whose highest"
            f" point lies at Z = {top:.4g} m"
        )
    return subject.p_lamp_trs_m


def _heading(subject: TerrainSubject) -> str:
    rows, columns = subject.height_m.shape
    dx, dy = subject.spacing_m
    along_x, along_y = length_text(dx), length_text(dy)
    spacing = along_x if along_x == along_y else f"{along_x} x {along_y}"
    size = f"{length_text((rows - 1) * dx)} x {length_text((columns - 1) * dy)}"
    light = "the upper left, 45 deg high"
    if subject.p_lamp_trs_m is not None:
        light = "a lamp at X {:g}, Y {:g}, Z {:g} m".format(*subject.p_lamp_trs_m)
    return (
        f"{subject.title}: {size}, {rows} x {columns} samples every {spacing};"
        f" hill shade without cast shadows, light from {light}"
    )


def _draw_shape(
    charts: Sequence[Axes], subject: TerrainSubject, terrain: TerrainMap, relief: Axes
) -> None:
    heights, slopes, profile = charts
    draw_heights(heights, terrain.height_m)
    gradients = facet_gradients(subject.height_m, subject.spacing_m)
    if gradients.size:
        draw_slope_shares(slopes, gradients.astype(np.float64), max(subject.spacing_m))
    else:
        note(slopes, "no facet without holes")
    i = subject.height_m.shape[0] // 2
    x, y, z = subject.origin_trs_m
    x_profile = x + i * subject.spacing_m[0]
    y_profile = y + subject.spacing_m[1] * np.arange(subject.height_m.shape[1])
    draw_profile(profile, y_profile, subject.height_m[i].astype(np.float64) + z, x_profile)
    relief.axhline(x_profile, color="#d62728", linewidth=0.9, linestyle="--")


def _draw_laws(charts: Sequence[Axes], subject: TerrainSubject) -> None:
    craters, deviation, spectrum = charts
    heights, spacing_m = subject.height_m, subject.spacing_m
    _draw_craters(craters, subject)
    along = [
        (name, deviogram(heights, spacing_m, axis=axis)) for axis, name in enumerate(("X", "Y"))
    ]
    fit = hurst_fit([each for _, each in along], max(spacing_m))
    draw_deviograms(deviation, along, fit, subject.roughness)
    draw_spectrum(spectrum, profile_spectrum(heights, spacing_m), subject.roughness)


def _draw_craters(axes: Axes, subject: TerrainSubject) -> None:
    asked = subject.asked
    if asked is None or asked.crater_density_per_m2 == 0.0:
        axes.set_axis_off()
        note(axes, "no craters were asked for" if asked else "no law of craters is known")
        return
    counts = count_craters(craters_of(asked), asked.size_m, asked.crater_smallest_m)
    draw_crater_counts(axes, counts, asked)
