"""Statistics of a terrain: its slopes, and how its roughness changes with scale.

All take heights as they lie in memory or in a mapped file, and look at evenly spaced rows of a
large map: neighbours tell little that is new. A sample that is not finite is a hole and takes no
part.

Terms are those of Shepard et al., The roughness of natural terrain: a planetary and remote sensing
perspective (JGR 106, E12, 2001): the *RMS deviation* over a step is the root mean square difference
of height between points so far apart, also called the square root of the structure function or of
the Allan variance; divided by the step it is the *RMS slope*. Of a self-affine surface it grows
with the step to the power of the *Hurst exponent* H.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import gamma, pi, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.terrain.formats.model import Heights
from tronlab.terrain.heightmap import HeightStatistics, HeightSums, bands_of_rows

MOST_FACETS = 4_000_000
MOST_PROFILES = 512
STEPS_PER_OCTAVE = 2
"""How densely the steps of a deviogram lie."""
SHORTEST_FIT_SAMPLES = 4
"""Below so many samples a height map is smoother than its surface."""
LONGEST_STEP_SHARE = 0.1
"""Longest step of a deviogram, of the profile's length: of longer ones too few that do not overlap
fit into a profile to tell anything."""

_BINS_PER_DECADE = 12
_ROWS_AT_ONCE = 64
_LEAST_PROFILE_SAMPLES = 16


@dataclass(frozen=True, slots=True)
class Deviogram:
    """RMS deviation of height against the step; arrays of shape (n,), shortest step first."""

    step_m: FloatArray
    deviation_m: FloatArray


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Mean power spectral density of profiles; arrays of shape (n,), longest wave first."""

    wavenumber_per_m: FloatArray
    """Cycles a metre."""
    density_m3: FloatArray
    """One-sided: its integral over the wave number is the variance of height, m^2."""


@dataclass(frozen=True, slots=True)
class PowerLaw:
    """``y = factor * x ** exponent``, and the range of x it was fitted in."""

    exponent: float
    factor: float
    x_range: tuple[float, float]

    def __call__(self, x: FloatArray) -> FloatArray:
        """Give y, shape as ``x``."""
        return self.factor * x**self.exponent


@dataclass(frozen=True, slots=True)
class SelfAffine:
    """A self-affine surface, in theory: neither a shortest nor a longest wave ends it."""

    hurst_exponent: float
    slope: float
    """RMS slope over ``base_m``, rise over run."""
    base_m: float

    def deviation_m(self, step_m: FloatArray) -> FloatArray:
        """Give the RMS deviation over steps, shape as ``step_m``."""
        return self.slope * self.base_m * (step_m / self.base_m) ** self.hurst_exponent

    def density_m3(self, wavenumber_per_m: FloatArray) -> FloatArray:
        """Give the one-sided power spectral density of a profile, shape as ``wavenumber_per_m``.

        The density ``C k^-(2 H + 1)`` has the squared deviation ``2 C`` times the integral of
        ``(1 - cos(2 pi k s)) k^-(2 H + 1)``, which is known in closed form (Gradshteyn and Ryzhik,
        3.823, with the functional equation of the gamma function).
        """
        two_h = 2 * self.hurst_exponent
        integral = (2 * pi * self.base_m) ** two_h * pi / (gamma(1 + two_h) * sin(pi * two_h / 2))
        factor = (self.slope * self.base_m) ** 2 / integral
        return factor * wavenumber_per_m ** -(two_h + 1)


def facet_gradients(
    height_m: Heights, spacing_m: tuple[float, float], *, most: int = MOST_FACETS
) -> NDArray[np.float32]:
    """Give how steep the facets of the surface are, rise over run along the steepest line.

    Each cell of four samples is two triangles, divided from sample (i, j) to (i + 1, j + 1) as the
    renderer divides it.

    Args:
        height_m: Heights, shape (rows, columns).
        spacing_m: Distance of the samples along rows and columns of the model: X and Y.
        most: Larger maps are represented by evenly spaced rows of cells with about so many facets.

    Returns:
        Shape (n,), without the facets at holes.
    """
    dx, dy = (np.float32(spacing) for spacing in spacing_m)
    n_rows = max(1, most // (2 * (height_m.shape[1] - 1)))
    parts: list[NDArray[np.float32]] = []
    for i in _evenly(height_m.shape[0] - 1, n_rows):
        # The difference in double precision: heights above a datum far below lose no bits.
        upper, lower = height_m[i : i + 2].astype(np.float64)
        down = ((lower - upper) / dx).astype(np.float32)
        along_upper, along_lower = (
            (np.diff(row) / dy).astype(np.float32) for row in (upper, lower)
        )
        parts += [np.hypot(down[:-1], along_lower), np.hypot(down[1:], along_upper)]
    gradients = np.concatenate(parts)
    return gradients[np.isfinite(gradients)]


def known_heights(height_m: Heights) -> HeightStatistics | None:
    """Look at all heights, shape (rows, columns), band by band; None if there are only holes."""
    sums = HeightSums()
    is_any = False
    for first, end in bands_of_rows(height_m.shape):
        band = height_m[first:end]
        band = band[np.isfinite(band)]
        if band.size:
            sums.add(band)
            is_any = True
    return sums.result() if is_any else None


def root_mean_square(values: NDArray[np.floating[Any]]) -> float:
    """Give the root mean square; NaN if there are no values."""
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64)))) if values.size else np.nan


def rms_slope(
    height_m: Heights, spacing_m: tuple[float, float], base_m: float, *, axis: int
) -> float:
    """Give the RMS slope of profiles over a base length, rise over run.

    Between steps of whole samples it is interpolated as a power law.

    Args:
        height_m: Heights, shape (rows, columns).
        spacing_m: Distance of the samples along X and Y.
        base_m: Base length.
        axis: Along which axis the profiles run.

    Returns:
        NaN where the base is shorter than the spacing or longer than the map.
    """
    steps = base_m / spacing_m[axis]
    nearest = round(steps)
    whole = (nearest,) if abs(steps - nearest) < 1e-6 else (int(steps), int(steps) + 1)
    if whole[0] < 1 or whole[-1] >= height_m.shape[axis]:
        return np.nan
    deviations = [_deviation(height_m, step, axis) for step in whole]
    if len(whole) == 1 or min(deviations) <= 0:
        return deviations[0] / base_m
    return float(np.exp(np.interp(np.log(steps), np.log(whole), np.log(deviations)))) / base_m


def deviogram(height_m: Heights, spacing_m: tuple[float, float], *, axis: int) -> Deviogram:
    """Give the RMS deviation of height against the step along one axis.

    The mean difference is taken away at every step, which makes a tilt of the map as a whole vanish
    (Shepard et al. 2001 fit and subtract a line for that).

    Args:
        height_m: Heights, shape (rows, columns).
        spacing_m: Distance of the samples along X and Y.
        axis: Along which axis the steps are taken.
    """
    longest = max(1, int(LONGEST_STEP_SHARE * (height_m.shape[axis] - 1)))
    n_octaves = np.log2(longest)
    steps = np.unique(
        np.round(2.0 ** np.arange(0.0, n_octaves + 1e-9, 1 / STEPS_PER_OCTAVE)).astype(int)
    )
    deviations = np.array([_deviation(height_m, int(step), axis) for step in steps])
    return Deviogram(steps * spacing_m[axis], deviations)


def hurst_fit(deviograms: Sequence[Deviogram], spacing_m: float) -> PowerLaw | None:
    """Fit a power law to deviograms: its exponent is the Hurst exponent.

    Args:
        deviograms: Of one map, such as along both of its axes.
        spacing_m: Distance of the map's samples.

    Returns:
        None if fewer than three steps of at least ``SHORTEST_FIT_SAMPLES`` have a deviation: the
        map is too small, or flat.
    """
    step_m = np.concatenate([each.step_m for each in deviograms])
    deviation_m = np.concatenate([each.deviation_m for each in deviograms])
    is_used = (step_m >= (SHORTEST_FIT_SAMPLES - 1e-6) * spacing_m) & (deviation_m > 0)
    if np.unique(step_m[is_used]).size < 3:
        return None
    return fit_power_law(step_m[is_used], deviation_m[is_used])


def fit_power_law(x: FloatArray, y: FloatArray) -> PowerLaw:
    """Fit a line to the logarithms of positive values, shape (n,); all points weigh the same."""
    exponent, log_factor = np.polyfit(np.log(x), np.log(y), 1)
    return PowerLaw(float(exponent), float(np.exp(log_factor)), (float(x.min()), float(x.max())))


def profile_spectrum(height_m: Heights, spacing_m: tuple[float, float]) -> Spectrum | None:
    """Give the mean power spectral density of the profiles along Y.

    Each profile loses its straight line and is weighed by a Hann window (Welch, IEEE Trans. Audio
    and Electroacoustics 15, 1967, without overlap), and the densities are averaged in steps of a
    twelfth of a decade. Profiles with holes take no part.

    Returns:
        None if no profile is whole, or if they are shorter than 16 samples.
    """
    n = height_m.shape[1]
    if n < _LEAST_PROFILE_SAMPLES:
        return None
    window = np.hanning(n + 1)[:-1]  # periodic, as the discrete Fourier transform is
    total = np.zeros(n // 2 + 1)
    n_profiles = 0
    for profiles in _whole_profiles(height_m):
        total += np.square(np.abs(np.fft.rfft(_detrended(profiles) * window, axis=1))).sum(axis=0)
        n_profiles += len(profiles)
    if not n_profiles:
        return None
    density_m3 = 2 * spacing_m[1] * total / (n_profiles * np.square(window).sum())
    return _binned(np.arange(n // 2 + 1) / (n * spacing_m[1]), density_m3)


def _evenly(n_all: int, most: int) -> NDArray[np.int64]:
    """Give indices below ``n_all``, all or at most so many, evenly spaced."""
    return np.unique(np.linspace(0, n_all - 1, min(n_all, most)).round().astype(np.int64))


def _deviation(height_m: Heights, step: int, axis: int) -> float:
    """Give the standard deviation of the height differences over a step of whole samples."""
    n, total, total_squares = 0, 0.0, 0.0
    n_rows = height_m.shape[0] - (step if axis == 0 else 0)
    for i in _evenly(n_rows, MOST_PROFILES):
        row = height_m[i].astype(np.float64)
        rise = height_m[i + step] - row if axis == 0 else row[step:] - row[:-step]
        rise = rise[np.isfinite(rise)]
        n += rise.size
        total += float(rise.sum())
        total_squares += float(np.square(rise).sum())  # BLAS would start threads for each row
    if not n:
        return np.nan
    variance = total_squares / n - (total / n) ** 2
    # Of a tilted plane nothing but rounding is left.
    return float(np.sqrt(variance)) if variance > 1e-12 * total_squares / n else 0.0


def _whole_profiles(height_m: Heights) -> Iterator[FloatArray]:
    """Yield rows without holes, shape (n, columns), some at a time."""
    rows = _evenly(height_m.shape[0], MOST_PROFILES)
    for first in range(0, len(rows), _ROWS_AT_ONCE):
        profiles = height_m[rows[first : first + _ROWS_AT_ONCE]].astype(np.float64)
        profiles = profiles[np.isfinite(profiles).all(axis=1)]
        if len(profiles):
            yield profiles


def _detrended(profiles: FloatArray) -> FloatArray:
    """Take the best straight line from each row."""
    place = np.linspace(-1, 1, profiles.shape[1])
    level = profiles.mean(axis=1, keepdims=True)
    tilt = profiles @ place / (place @ place)
    return profiles - level - tilt[:, None] * place


def _binned(wavenumber_per_m: FloatArray, density_m3: FloatArray) -> Spectrum:
    """Average a spectrum in bins of equal width on a logarithmic axis.

    Its first two and its last values are left out: the window spreads the mean over the first,
    and the last one is no mean of a positive and a negative wave number.
    """
    k, density = wavenumber_per_m[2:-1], density_m3[2:-1]
    bins = np.floor(_BINS_PER_DECADE * np.log10(k / k[0])).astype(int)
    n = np.bincount(bins)
    held = n > 0
    return Spectrum(
        np.exp(np.bincount(bins, np.log(k))[held] / n[held]),
        np.bincount(bins, density)[held] / n[held],
    )
