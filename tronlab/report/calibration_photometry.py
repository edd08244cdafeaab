"""The photometry of a calibration: grey as measured and as explained, and what is left of it."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tronlab.calib.inputs import PhotometryInput
from tronlab.calib.photometry.fit import Fits, fit_families
from tronlab.calib.photometry.regression import Family
from tronlab.calib.results import PhotometryResult
from tronlab.geometry.poses import FloatArray
from tronlab.report.calibration_images import GOOD_COLOUR, OUTLIER_COLOUR
from tronlab.report.style import new_figure, style_context

_N_BINS = 16
_SHOWN = 99.5
"""Per cent of the residuals that the axis has room for."""


def photometry_chart(measured: PhotometryInput, result: PhotometryResult) -> Figure:
    """Draw grey as explained against measured, and residuals against angles.

    The last panel has what Lommel-Seeliger gives over what Lambert gives, 2 / (mu0 + mu): a wrong
    share of it shows as a slope there.
    """
    fits = fit_families(measured)
    patches = fits.patches
    ratio = patches.terms[:, 1] / np.where(patches.terms[:, 0] > 0, patches.terms[:, 0], np.nan)
    with style_context():
        figure = new_figure(11.0, 4.0)
        grey, by_phase, by_ratio = figure.subplots(1, 3)
        _draw_grey(grey, fits)
        _draw_residuals(by_phase, fits, np.degrees(patches.phase_rad))
        by_phase.set_xlabel("phase angle [deg]")
        by_phase.set_ylabel("measured minus explained [% of the grey]")
        by_phase.legend(fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))
        _draw_residuals(by_ratio, fits, ratio)
        by_ratio.set_xlabel("Lommel-Seeliger over Lambert")
        figure.suptitle(
            f"Share of Lommel-Seeliger {fits.mixtures['lunar_lambert'].weight:.3f} +-"
            f" {result.weight_sigma:.3f},"
            f" {len(measured.images)} images of {measured.dataset_name}",
            fontsize=10,
        )
    return figure


def _draw_grey(axes: Axes, fits: Fits) -> None:
    measured = fits.patches.grey
    explained = fits.mixtures["lunar_lambert"].grey(fits.patches)
    axes.plot(explained, measured, ".", color=GOOD_COLOUR, markersize=2, rasterized=True)
    end = 1.05 * float(max(explained.max(), measured.max()))
    axes.plot([0, end], [0, end], color="black", linewidth=0.6)
    axes.set(xlim=(0, end), ylim=(0, end), aspect="equal")
    axes.set_xlabel("grey of a patch as explained [full scale]")
    axes.set_ylabel("as measured [full scale]")


def _draw_residuals(axes: Axes, fits: Fits, x: FloatArray) -> None:
    families: tuple[tuple[Family, str, str], ...] = (
        ("lambert", "Lambert", OUTLIER_COLOUR),
        ("lunar_lambert", "lunar-Lambert", GOOD_COLOUR),
    )
    is_known = np.isfinite(x)
    largest = 0.0
    for family, name, colour in families:
        fit = fits.mixtures[family]
        y = 100 * fit.residuals(fits.patches)
        largest = max(largest, float(np.percentile(np.abs(y), _SHOWN)))
        axes.plot(x, y, ".", color=colour, markersize=2, alpha=0.25, rasterized=True)
        label = f"{name}, {100 * fit.rms(fits.patches):.2f} % rms"
        middles, means = _binned(x[is_known], y[is_known])
        axes.plot(middles, means, "o-", color=colour, markersize=4, label=label)
    axes.axhline(0.0, color="black", linewidth=0.6)
    axes.set_ylim(-largest, largest)


def _binned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Give middle and mean of y in bins of as many values each, ordered by x."""
    bins = np.array_split(np.argsort(x), _N_BINS)
    return np.array([x[one].mean() for one in bins]), np.array([y[one].mean() for one in bins])
