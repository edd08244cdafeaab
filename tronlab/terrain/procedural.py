"""A lunar terrain from a seed: hills, self-affine roughness and craters.

Roughness and craters have their natural height; the hills are made as high as it takes to reach the
relief asked for, so that slopes and shadows stay those of the Moon.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.craters import Craters, draw_craters, stamp_craters
from tronlab.terrain.kernels import n_cores

GENERATOR_VERSION = 3
"""To be raised with every change of the heights made from the same settings."""

LONGEST_WAVE_M = 1.5
"""Roughness has no longer waves of its own: those are the hills'."""
SLOPE_BASE_M = 0.01
"""Run over which ``roughness_slope`` is meant."""
_SHORTEST_HILL_M = 1.0
_RELIEF_STEP = 8


def make_terrain(config: ProceduralTerrain) -> NDArray[np.float32]:
    """Make the heights, shape ``config.shape``, from 0 to exactly ``relief_m``."""
    roughness_rng, crater_rng, hill_rng = np.random.default_rng(config.seed).spawn(3)
    size_m = extent_m(config)
    height = rough_surface(
        roughness_rng,
        config.shape,
        spacing_m=config.spacing_m,
        hurst_exponent=config.hurst_exponent,
        slope=config.roughness_slope,
        longest_wave_m=LONGEST_WAVE_M,
    )
    stamp_craters(height, config.spacing_m, config_craters(crater_rng, config))
    hill = draw_hills(hill_rng, size_m).heights(*places_m(config.shape, size_m))
    coarse, coarse_hill = (a[::_RELIEF_STEP, ::_RELIEF_STEP] for a in (height, hill))
    factor = hill_factor(coarse, coarse_hill, config.relief_m)
    if factor > 0:
        height += factor * hill
    return scaled_to_relief(height, config.relief_m)


def extent_m(config: ProceduralTerrain) -> tuple[float, float]:
    """Give the lengths from the first to the last row and column: whole numbers of spacings."""
    rows, columns = config.shape
    return (rows - 1) * config.spacing_m, (columns - 1) * config.spacing_m


def config_craters(rng: np.random.Generator, config: ProceduralTerrain) -> Craters:
    """Draw the craters of a terrain."""
    return draw_craters(
        rng,
        extent_m(config),
        exponent=config.crater_exponent,
        density_per_m2=config.crater_density_per_m2,
        smallest_m=config.crater_smallest_m,
        largest_m=config.crater_largest_m,
    )


def rough_surface(
    rng: np.random.Generator,
    shape: tuple[int, int],
    *,
    spacing_m: float,
    hurst_exponent: float,
    slope: float,
    longest_wave_m: float,
) -> NDArray[np.float32]:
    """Make a self-affine surface, shape ``shape``, metres.

    White noise is filtered to a power spectrum ~ k^-(2 H + 2) (Turcotte, Fractals and Chaos in
    Geology and Geophysics, 1997), flat for waves longer than ``longest_wave_m``, and scaled
    so that over 10 mm along a row the root mean square slope is ``slope``.
    """
    from scipy import fft  # not by whoever takes the terrain from the cache

    padded = [int(fft.next_fast_len(n, real=True)) for n in shape]  # pyright: ignore
    spectrum: Any = fft.rfft2(rng.standard_normal(padded, dtype=np.float32), workers=n_cores())
    kx = fft.fftfreq(padded[0], spacing_m).astype(np.float32)
    ky = fft.rfftfreq(padded[1], spacing_m).astype(np.float32)
    k_squared = kx[:, None] ** 2 + ky**2
    np.maximum(k_squared, np.float32(longest_wave_m**-2), out=k_squared)
    spectrum *= k_squared ** np.float32(-(hurst_exponent + 1) / 2)
    spectrum[0, 0] = 0.0
    surface: Any = fft.irfft2(spectrum, s=padded, workers=n_cores(), overwrite_x=True)
    surface = np.ascontiguousarray(surface[: shape[0], : shape[1]])
    run = max(1, min(round(SLOPE_BASE_M / spacing_m), shape[1] - 1))
    rise = surface[:, run:] - surface[:, :-run]
    rms_slope = np.sqrt(np.mean(rise * rise, dtype=np.float64)) / (run * spacing_m)
    surface *= np.float32(slope / rms_slope)
    return surface


@dataclass(frozen=True, slots=True)
class Hills:
    """A smooth surface of half waves along both sides of the model, of any height."""

    amplitudes: FloatArray
    """Shape (waves along x, waves along y)."""
    k_x: FloatArray
    """Half waves a metre along x, shape (waves along x,)."""
    k_y: FloatArray

    def heights(self, x_m: FloatArray, y_m: FloatArray) -> NDArray[np.float32]:
        """Give the heights at places along x and y, shape (places along x, along y)."""
        return self.strengths(x_m) @ self.waves(y_m)

    def strengths(self, x_m: FloatArray) -> NDArray[np.float32]:
        """Give how strong each wave along y is, shape (places along x, waves along y)."""
        across_x = np.cos(np.pi * x_m[:, None] * self.k_x)
        return (across_x @ self.amplitudes).astype(np.float32)

    def waves(self, y_m: FloatArray) -> NDArray[np.float32]:
        """Give the waves along y, shape (waves along y, places along y)."""
        return np.cos(np.pi * y_m[:, None] * self.k_y).T.astype(np.float32)


def draw_hills(rng: np.random.Generator, size_m: tuple[float, float]) -> Hills:
    """Draw waves not much shorter than 1 m, amplitudes falling with the square of wave number."""
    n_x, n_y = (max(1, int(2 * length / _SHORTEST_HILL_M)) for length in size_m)
    k_x = np.arange(n_x + 1) / size_m[0]
    k_y = np.arange(n_y + 1) / size_m[1]
    k_squared = k_x[:, None] ** 2 + k_y**2
    k_squared[0, 0] = np.inf
    return Hills(rng.standard_normal((n_x + 1, n_y + 1)) / k_squared, k_x, k_y)


def places_m(shape: tuple[int, int], size_m: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Give where the rows lie along x and the columns along y."""
    return np.linspace(0, size_m[0], shape[0]), np.linspace(0, size_m[1], shape[1])


def hill_factor(
    coarse_m: NDArray[np.float32], coarse_hill: NDArray[np.float32], relief_m: float
) -> np.float32:
    """Find how high hills must be for the relief; 0 if there is enough without.

    Looked for on a part of the samples, the relief is met within a per cent or so.
    """
    from scipy import optimize

    def lacking(factor: float) -> float:
        return relief_m - float(np.ptp(coarse_m + np.float32(factor) * coarse_hill))

    if lacking(0.0) <= 0:
        return np.float32(0.0)
    # Hills this high have the relief by themselves, and what they lie on adds at most its own.
    most = (relief_m + float(np.ptp(coarse_m))) / float(np.ptp(coarse_hill))
    factor: Any = optimize.brentq(lacking, 0.0, most)
    return np.float32(factor)


def scaled_to_relief(height_m: NDArray[np.float32], relief_m: float) -> NDArray[np.float32]:
    """Scale and shift heights in place so that they go from 0 to exactly ``relief_m``."""
    height_m -= height_m.min()
    height_m *= np.float32(relief_m) / height_m.max()
    np.minimum(height_m, np.float32(relief_m), out=height_m)
    height_m[np.unravel_index(height_m.argmax(), height_m.shape)] = relief_m
    return height_m
