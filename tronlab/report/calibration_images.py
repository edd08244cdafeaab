"""Calibration pictures that lie over the camera's image: residuals, coverage, uncertainty."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from tronlab.calib.camera.projection_uncertainty import projection_sigma_px
from tronlab.calib.camera.view_checks import GRID
from tronlab.calib.camera.view_residuals import ViewResiduals
from tronlab.calib.results import CameraResult
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.report.style import new_figure, style_context

GOOD_COLOUR = "#0072b2"
OUTLIER_COLOUR = "#d55e00"
_ARROW_LENGTH = 1 / 35
"""Of the image's width, for the residual that 95 % are smaller than."""
_N_FIELD = 41
_LEVELS = 1.0, 1.5, 2.0, 3.0, 5.0, 7.0
"""Times powers of ten: where the bands of a contour picture end."""
_LOWEST_BAND = 0.05
"""Quantile below which all is one band."""
_SMALLEST = 1e-3
"""Of the largest value; smaller ones have no colour."""


def residual_picture(camera: CameraModel, views: Sequence[ViewResiduals]) -> Figure:
    """Draw the residual of every corner where it was found, much enlarged.

    Neighbouring arrows that point the same way tell of a lens the distortion model does not fit;
    one bad view of a bad image or a board that moved.
    """
    uv = np.vstack([view.uv_px for view in views])
    residuals = np.vstack([view.residuals_px for view in views])
    is_outlier = np.concatenate([view.is_outlier for view in views])
    scale_px = _round_down(float(np.percentile(np.linalg.norm(residuals[~is_outlier], axis=1), 95)))
    with style_context():
        figure = new_figure(6.6, 6.0 * camera.height_px / camera.width_px + 0.9)
        axes = figure.add_subplot()
        for chosen, colour, label in (
            (~is_outlier, GOOD_COLOUR, f"{(~is_outlier).sum()} corners in {len(views)} views"),
            (is_outlier, OUTLIER_COLOUR, f"{is_outlier.sum()} left out"),
        ):
            if not chosen.any():
                continue
            arrows = axes.quiver(
                *uv[chosen].T,
                *residuals[chosen].T,
                color=colour,
                angles="xy",
                scale_units="xy",
                scale=scale_px / (_ARROW_LENGTH * camera.width_px),
                width=0.0018,
                label=label,
            )
            if colour == GOOD_COLOUR:
                axes.quiverkey(arrows, 0.93, 1.03, scale_px, f"{scale_px:g} px", labelpos="W")
        rms = float(np.sqrt((residuals[~is_outlier] ** 2).mean()))
        axes.set_title(f"Residuals, {rms:.3f} px rms a coordinate", loc="left", pad=20)
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=8)
        _as_image(axes, camera)
    return figure


def coverage_picture(camera: CameraModel, views: Sequence[ViewResiduals]) -> Figure:
    """Draw how many corners each field of the image has; fields without one are hatched."""
    uv = np.vstack([view.uv_px for view in views]) + 0.5
    edges_v, edges_u = (
        np.linspace(0, size, GRID + 1) for size in (camera.height_px, camera.width_px)
    )
    counts, _, _ = np.histogram2d(uv[:, 1], uv[:, 0], bins=(edges_v, edges_u))
    with style_context():
        figure = new_figure(6.6, 5.4 * camera.height_px / camera.width_px + 0.5)
        axes = figure.add_subplot()
        shown = axes.pcolormesh(
            edges_u - 0.5, edges_v - 0.5, np.ma.masked_equal(counts, 0), cmap="Blues", vmin=0
        )
        axes.patch.set(hatch="///", edgecolor="#bbbbbb")
        middle_u, middle_v = (edges[:-1] + np.diff(edges) / 2 for edges in (edges_u, edges_v))
        for (row, column), count in np.ndenumerate(counts):
            colour = "white" if count > 0.6 * counts.max() else "black"
            axes.text(
                float(middle_u[column]),
                float(middle_v[row]),
                f"{count:.0f}",
                ha="center",
                va="center",
                fontsize=7,
                color=colour,
            )
        figure.colorbar(shown, ax=axes, label="corners in a field", shrink=0.95)
        share = (counts > 0).mean()
        axes.set_title(f"Coverage: {share:.0%} of the image has corners", loc="left")
        _as_image(axes, camera)
    return figure


def projection_picture(result: CameraResult, views: Sequence[ViewResiduals]) -> Figure:
    """Draw how well the camera knows where it projects a direction to, with the corners it is from.

    What a small turn of the camera explains is left out: the hand-eye transform takes it up.
    """
    camera = result.camera
    u = np.linspace(0, camera.width_px - 1, _N_FIELD)
    v = np.linspace(0, camera.height_px - 1, _N_FIELD)
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    sigma = projection_sigma_px(result, uv).reshape(len(v), len(u))
    with style_context():
        figure = new_figure(6.6, 5.4 * camera.height_px / camera.width_px + 0.5)
        axes = figure.add_subplot()
        levels = _levels(sigma)
        filled = axes.contourf(
            u, v, sigma, levels=levels, norm=LogNorm(levels[0], levels[-1]), cmap="viridis"
        )
        axes.contour(u, v, sigma, levels=levels, colors="white", linewidths=0.6)
        for view in views:
            axes.plot(*view.uv_px.T, ".", color="white", markersize=1.2, alpha=0.6)
        figure.colorbar(
            filled,
            ax=axes,
            label="one sigma of a coordinate [px]",
            ticks=levels,
            format=FuncFormatter(lambda value, _: f"{value:.2g}"),
            shrink=0.95,
        )
        axes.set_title(
            f"Uncertainty of projection, {_rms(sigma):.3f} px rms; corners are dots", loc="left"
        )
        _as_image(axes, camera)
    return figure


def _as_image(axes: Axes, camera: CameraModel) -> None:
    axes.set_xlim(-0.5, camera.width_px - 0.5)
    axes.set_ylim(camera.height_px - 0.5, -0.5)
    axes.set_aspect("equal")
    axes.set_xlabel("u [px]")
    axes.set_ylabel("v [px]")


def _levels(values: FloatArray) -> FloatArray:
    """Give where the bands end that hold all values, in steps that grow with the values."""
    high = float(values.max())
    lowest = max(float(values.min()), _SMALLEST * high)
    low = max(float(np.quantile(values, _LOWEST_BAND)), lowest)
    decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    levels = np.outer(10.0**decades, _LEVELS).ravel()
    first, last = np.searchsorted(levels, low, side="right"), np.searchsorted(levels, high)
    return np.append(min(lowest, levels[first - 1]), levels[first : last + 1])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt((values**2).mean()))


def _round_down(value: float) -> float:
    """Give the largest 1, 2 or 5 times a power of ten that is not above a positive value."""
    if value <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)) * power)
