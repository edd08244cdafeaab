"""One sheet about a landmark database: where its landmarks are, and from where they were seen."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import BoundaryNorm, LogNorm
from matplotlib.image import AxesImage
from matplotlib.ticker import FuncFormatter

from tronlab.errors import ConfigError
from tronlab.nav.database_file import Counts, DatabaseFile
from tronlab.nav.survey import CELL_M, Survey
from tronlab.report.style import new_figure, style_context

_BAR_COLOUR = "#0072b2"
_SECOND_COLOUR = "#d55e00"
_MOST_BARS = 40
_SHEET_IN = (11.0, 7.4)
_HEIGHT_RATIOS = (1.35, 1.0)


def save_database_sheet(file: DatabaseFile, survey: Survey, path: Path, *, title: str) -> None:
    """Draw density, coverage by range, and how often points were seen or verified, as PNG.

    Raises:
        ConfigError: The file cannot be written, or is not to be a PNG.
    """
    if path.suffix.lower() != ".png":
        raise ConfigError(f"--plot {path}: the picture is a PNG; name it .png")
    with style_context():
        figure = new_figure(*_SHEET_IN)
        maps, charts = figure.add_gridspec(2, 1, height_ratios=_HEIGHT_RATIOS)
        above, below = figure.add_subfigure(maps), figure.add_subfigure(charts)
        density, coverage = above.subplots(1, 2)
        ranges, points = below.subplots(1, 2)
        _draw_density(density, survey)
        _draw_coverage(coverage, survey)
        _draw_ranges(ranges, survey)
        if file.counts is None:
            _draw_views(points, survey)
        else:
            _draw_verified(points, file.counts)
        database = file.database
        figure.suptitle(
            f"{title}: {len(database)} {database.detector.features} landmarks from"
            f" {len(file.views_trs_from_cam)} views"
        )
        try:
            FigureCanvasAgg(figure).print_png(path, metadata={"Software": None})
        except OSError as error:
            raise ConfigError(f"--plot {path}: cannot be written: {error.strerror}") from error


def _draw_density(axes: Axes, survey: Survey) -> None:
    density = np.where(survey.density_per_m2 > 0, survey.density_per_m2, np.nan)
    low, high = float(np.nanmin(density)), float(np.nanmax(density))
    image = axes.imshow(
        density,
        extent=_extent_m(survey),
        norm=LogNorm(low, max(high, 1.01 * low)),
        cmap="viridis",
        interpolation="nearest",
    )
    decades = FuncFormatter(lambda value, _place: f"{value:g}")
    _colour_bar(axes, image, "landmarks per m²", format=decades)
    _label_map(axes, "density")


def _draw_coverage(axes: Axes, survey: Survey) -> None:
    n_bands = np.count_nonzero(survey.n_in_cell, axis=2)
    most = survey.n_in_cell.shape[2]
    image = axes.imshow(
        np.where(n_bands > 0, n_bands, np.nan),
        extent=_extent_m(survey),
        norm=BoundaryNorm(np.arange(0.5, most + 1), 256),
        cmap="cividis",
        interpolation="nearest",
    )
    label = f"range bands with landmarks, of {most}"
    _colour_bar(axes, image, label, ticks=np.arange(1, most + 1))
    _label_map(axes, "coverage by range")


def _draw_ranges(axes: Axes, survey: Survey) -> None:
    lower, upper = survey.bands_m[:-1], survey.bands_m[1:]
    names = [f"{a:.2g} to {b:.2g}" for a, b in zip(lower, upper, strict=True)]
    bars = axes.bar(names, 100 * survey.covered_share, color=_BAR_COLOUR, width=0.8)
    n_of_band = survey.n_in_cell.sum(axis=(0, 1))
    axes.bar_label(bars, [f"{n:,}".replace(",", " ") for n in n_of_band.tolist()], fontsize=8)
    axes.set_ylim(0, 115)
    axes.set_ylabel("covered area [%]")
    axes.set_xlabel("distance from the camera [m]")
    axes.set_title("covered by each range band (above: landmarks)")
    axes.tick_params(axis="x", labelsize=8)


def _draw_views(axes: Axes, survey: Survey) -> None:
    n_views = survey.n_views_of_point
    step = -(-int(n_views.max()) // _MOST_BARS)
    limits = np.arange(0.5, int(n_views.max()) + step + 0.5, step)
    counts = np.histogram(n_views, limits)[0]
    axes.bar(limits[:-1], 100 * counts / len(n_views), 0.85 * step, align="edge", color=_BAR_COLOUR)
    axes.set_xlabel("views that show the point")
    axes.set_ylabel("landmarks [%]")
    axes.set_title("how many views see a point")


def _draw_verified(axes: Axes, counts: Counts) -> None:
    was_offered = counts.n_offered > 0
    share = counts.n_verified[was_offered] / counts.n_offered[was_offered]
    never = 100 * np.mean(share == 0) if len(share) else 0.0
    axes.hist(
        np.clip(share[share > 0], 0.0, 1.0), bins=np.linspace(0, 1, 21).tolist(),
        color=_SECOND_COLOUR,
    )  # fmt: skip
    axes.set_xlabel("shots in which it verified, of those it was offered in")
    axes.set_ylabel("landmarks")
    axes.set_title(
        f"verification: {np.count_nonzero(was_offered)} offered, {never:.0f} % of them never"
        " verified"
    )


def _colour_bar(axes: Axes, image: AxesImage, label: str, **look: Any) -> None:
    figure = axes.get_figure(root=False)
    if figure is not None:
        figure.colorbar(image, ax=axes, location="bottom", shrink=0.8, label=label, **look)


def _extent_m(survey: Survey) -> tuple[float, float, float, float]:
    """Give left, right, lower and upper border as drawn: Y to the right, X down."""
    (x, y), (rows, columns) = survey.corner_trs_m, survey.n_in_cell.shape[:2]
    return y, y + columns * CELL_M, x + rows * CELL_M, x


def _label_map(axes: Axes, title: str) -> None:
    axes.set_xlabel("Y [m] →")
    axes.set_ylabel("← X [m]")
    axes.set_title(f"{title}, cells of {100 * CELL_M:.0f} cm")
