"""Charts of a terrain: heights, slopes, a profile, craters and roughness against what was asked."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from tronlab.geometry.poses import FloatArray
from tronlab.report.style import note
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.crater_counts import CraterCounts, law_per_m2, n_expected
from tronlab.terrain.lengths import height_unit, length_text
from tronlab.terrain.statistics import (
    Deviogram,
    PowerLaw,
    SelfAffine,
    Spectrum,
    root_mean_square,
)

BAR_COLOUR = "#7f7f7f"
MEASURED_COLOUR = "#0072b2"
OTHER_AXIS_COLOUR = "#009e73"
ASKED_COLOUR = "#d55e00"
_N_BINS = 60
_STEEPEST_PERCENTILE = 99.9
_SHORT_AXIS = 100.0


def draw_heights(axes: Axes, height_m: FloatArray) -> None:
    """Draw how much of the area lies at which height; ``height_m`` of any shape."""
    known = height_m[np.isfinite(height_m)]
    factor, unit = height_unit(float(np.ptp(known)))
    _draw_shares(axes, factor * known)
    axes.set_xlabel(f"height Z [{unit}]")
    deviation = factor * float(known.std())
    axes.set_title(
        f"mean {factor * known.mean():.4g} {unit}, RMS about it {deviation:.3g} {unit}", loc="left"
    )


def draw_slope_shares(axes: Axes, gradients: FloatArray, spacing_m: float) -> None:
    """Draw how much of the area is how steep.

    Args:
        axes: Where.
        gradients: Rise over run of facets, shape (n,).
        spacing_m: Their size.
    """
    slope_deg = np.degrees(np.arctan(gradients))
    steepest = float(np.percentile(slope_deg, _STEEPEST_PERCENTILE))
    _draw_shares(axes, slope_deg[slope_deg <= max(steepest, 1e-9)])
    marks = {
        "median": (float(np.median(slope_deg)), ":"),
        "RMS": (float(np.degrees(np.arctan(root_mean_square(gradients)))), "-"),
        "95 %": (float(np.percentile(slope_deg, 95)), "--"),
    }
    for name, (value, linestyle) in marks.items():
        label = f"{name} {value:.1f} deg"
        axes.axvline(value, color="black", linewidth=1.1, linestyle=linestyle, label=label)
    axes.set_xlim(left=0.0)
    axes.set_xlabel(f"slope of the facets, {length_text(spacing_m)} long [deg]")
    axes.legend(fontsize=8, frameon=True, framealpha=0.9, edgecolor="none", loc="upper right")


def draw_profile(axes: Axes, y_m: FloatArray, height_m: FloatArray, x_m: float) -> None:
    """Draw the heights along Y.

    Args:
        axes: Where.
        y_m: Places, shape (n,).
        height_m: Heights there, shape (n,); NaN in holes.
        x_m: X of the profile.
    """
    known = height_m[np.isfinite(height_m)]
    if not known.size:
        note(axes, "nothing but holes")
        return
    factor, unit = height_unit(float(np.ptp(known)))
    axes.plot(y_m, factor * height_m, color=MEASURED_COLOUR, linewidth=0.8)
    axes.set_xlim(y_m[0], y_m[-1])
    axes.set_xlabel("Y [m]")
    axes.set_ylabel(f"Z [{unit}]")
    axes.set_title(f"profile at X = {x_m:.5g} m, the line in the relief", loc="left")
    axes.grid()


def draw_crater_counts(axes: Axes, counts: CraterCounts, config: ProceduralTerrain) -> None:
    """Draw the cumulative size-frequency plot of the craters with the law asked for."""
    smallest_m, largest_m = config.crater_smallest_m, config.crater_largest_m
    diameter_m = np.geomspace(smallest_m, largest_m, 200)[:-1]
    law = f"{config.crater_density_per_m2:g} (D / 1 m)^-{config.crater_exponent:g}"
    endless = config.crater_density_per_m2 * diameter_m**-config.crater_exponent
    axes.plot(diameter_m, endless, ":", color=ASKED_COLOUR, linewidth=1.1, label=f"{law} / m²")
    axes.plot(
        diameter_m,
        law_per_m2(config, diameter_m),
        color=ASKED_COLOUR,
        linewidth=1.4,
        label="asked for: the law, cut off",
    )
    axes.errorbar(
        counts.diameter_m,
        counts.density_per_m2,
        counts.standard_error_per_m2,
        fmt="o",
        color=MEASURED_COLOUR,
        markersize=3.5,
        linewidth=1.0,
        capsize=2,
        label="drawn on the model, ± sqrt(N)",
    )
    for cut_off_m in (smallest_m, largest_m):
        axes.axvline(cut_off_m, color=BAR_COLOUR, linewidth=0.9, linestyle="--")
    axes.set_ylim(bottom=0.3 / counts.area_m2)
    _log_log(axes, "diameter D [m]; dashed: cut-offs", "craters at least so wide [1 / m²]")
    axes.set_title(crater_verdict(counts, config), loc="left")
    axes.legend(fontsize=7.5)


def crater_verdict(counts: CraterCounts, config: ProceduralTerrain) -> str:
    """Say how many craters there are and were asked for, and how unlikely the difference is."""
    n_drawn = int(counts.n_craters[0])
    n_asked = n_expected(config, counts)
    sigmas = (n_drawn - n_asked) / np.sqrt(n_asked) if n_asked > 0 else 0.0
    return f"{n_drawn} craters, law: {n_asked:.0f}, difference {sigmas:+.1f} sigma"


def draw_deviograms(
    axes: Axes,
    deviograms: Sequence[tuple[str, Deviogram]],
    fit: PowerLaw | None,
    asked: SelfAffine | None,
) -> None:
    """Draw the RMS deviation against the step.

    Args:
        axes: Where.
        deviograms: Along X and along Y, each with the name of its axis.
        fit: The power law through them, if there is one.
        asked: What the roughness was to be, craters and hills apart.
    """
    looks = (("s", OTHER_AXIS_COLOUR, 6.5), ("o", MEASURED_COLOUR, 3.5))
    for (name, each), (marker, colour, size) in zip(deviograms, looks, strict=True):
        is_drawn = each.deviation_m > 0
        axes.plot(
            each.step_m[is_drawn],
            each.deviation_m[is_drawn],
            marker,
            color=colour,
            markersize=size,
            markerfacecolor="none" if marker == "s" else colour,
            label=f"along {name}",
        )
    if fit is None:
        note(axes, "too small or too flat\nfor a power law")
        return
    ends = np.array(fit.x_range)
    axes.plot(ends, fit(ends), color="black", linewidth=1.1, label=f"fit: H = {fit.exponent:.2f}")
    if asked is not None:
        axes.plot(
            ends,
            asked.deviation_m(ends),
            "--",
            color=ASKED_COLOUR,
            label=f"roughness asked for: H = {asked.hurst_exponent:g}",
        )
    _log_log(axes, "step [m]", "RMS deviation of height [m]")
    axes.legend(fontsize=8)


def draw_spectrum(axes: Axes, spectrum: Spectrum | None, asked: SelfAffine | None) -> None:
    """Draw the power spectral density of profiles, and what the roughness was to be."""
    if spectrum is None or not (spectrum.density_m3 > 0).any():
        note(axes, "no profile without holes")
        return
    k = spectrum.wavenumber_per_m
    axes.plot(k, spectrum.density_m3, color=MEASURED_COLOUR, linewidth=1.3, label="along Y")
    if asked is not None:
        axes.plot(
            k,
            asked.density_m3(k),
            "--",
            color=ASKED_COLOUR,
            label=f"roughness asked for: k^-{2 * asked.hurst_exponent + 1:.3g}",
        )
    _log_log(axes, "wave number [cycles / m]", "power spectral density [m³]")
    axes.legend(fontsize=8)


def _draw_shares(axes: Axes, values: FloatArray) -> None:
    """Draw a histogram in per cent of all values a bin."""
    counts, edges = np.histogram(values, _N_BINS)
    share_pct = 100 * counts / max(values.size, 1)
    axes.bar(edges[:-1], share_pct, np.diff(edges), align="edge", color=BAR_COLOUR)
    axes.set_ylabel("share of the area [%]")
    axes.grid(axis="y")


def _log_log(axes: Axes, x_label: str, y_label: str) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log", nonpositive="clip")
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        # Decades alone leave a short axis with a single number on it.
        subs = (1.0, 2.0, 5.0) if high < _SHORT_AXIS * low else (1.0,)
        axis.set_major_locator(LogLocator(subs=subs))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.grid()
