"""A lunar terrain from a seed: hills, self-affine roughness and craters.

Roughness and craters have their natural height; the hills are made as high as it takes to reach the
relief asked for, so that slopes and shadows stay those of the Moon.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, optimize

from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.craters import draw_craters, stamp_craters
from tronlab.terrain.kernels import n_cores

GENERATOR_VERSION = 3
"""To be raised with every change of the heights made from the same settings."""

_LONGEST_WAVE_M = 1.5
_SHORTEST_HILL_M = 1.0
_SLOPE_BASE_M = 0.01
_RELIEF_STEP = 8


def make_terrain(config: ProceduralTerrain) -> NDArray[np.float32]:
    """Make the heights, shape ``config.shape``, from 0 to exactly ``relief_m``."""
    roughness_rng, crater_rng, hill_rng = np.random.default_rng(config.seed).spawn(3)
    height = rough_surface(
        roughness_rng,
        config.shape,
        spacing_m=config.spacing_m,
        hurst_exponent=config.hurst_exponent,
        slope=config.roughness_slope,
        longest_wave_m=_LONGEST_WAVE_M,
    )
    rows, columns = config.shape
    size_m = ((rows - 1) * config.spacing_m, (columns - 1) * config.spacing_m)
    craters = draw_craters(
        crater_rng,
        size_m,
        exponent=config.crater_exponent,
        density_per_m2=config.crater_density_per_m2,
        smallest_m=config.crater_smallest_m,
        largest_m=config.crater_largest_m,
    )
    stamp_craters(height, config.spacing_m, craters)
    add_hills(height, hills(hill_rng, config.shape, size_m), config.relief_m)
    return scaled_to_relief(height, config.relief_m)


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
    run = max(1, min(round(_SLOPE_BASE_M / spacing_m), shape[1] - 1))
    rise = surface[:, run:] - surface[:, :-run]
    rms_slope = np.sqrt(np.mean(rise * rise, dtype=np.float64)) / (run * spacing_m)
    surface *= np.float32(slope / rms_slope)
    return surface


def hills(
    rng: np.random.Generator, shape: tuple[int, int], size_m: tuple[float, float]
) -> NDArray[np.float32]:
    """Make a smooth surface, shape ``shape``, of waves not much shorter than 1 m, any height.

    Half waves along both sides of the model, their amplitudes falling with the square of the
    wave number.
    """
    n_x, n_y = (max(1, int(2 * length / _SHORTEST_HILL_M)) for length in size_m)
    k_x = np.arange(n_x + 1) / size_m[0]
    k_y = np.arange(n_y + 1) / size_m[1]
    k_squared = k_x[:, None] ** 2 + k_y**2
    k_squared[0, 0] = np.inf
    amplitudes = rng.standard_normal((n_x + 1, n_y + 1)) / k_squared
    across_x = np.cos(np.pi * np.linspace(0, size_m[0], shape[0])[:, None] * k_x)
    across_y = np.cos(np.pi * np.linspace(0, size_m[1], shape[1])[:, None] * k_y)
    return (across_x @ amplitudes).astype(np.float32) @ across_y.T.astype(np.float32)


def add_hills(height_m: NDArray[np.float32], hill: NDArray[np.float32], relief_m: float) -> None:
    """Add hills in place, as high as it takes for the relief; none if there is enough without.

    The factor is found on every eighth sample, so the relief is met within a per cent or so.
    """
    coarse, coarse_hill = (a[::_RELIEF_STEP, ::_RELIEF_STEP] for a in (height_m, hill))

    def lacking(factor: float) -> float:
        return relief_m - float(np.ptp(coarse + np.float32(factor) * coarse_hill))

    if lacking(0.0) <= 0:
        return
    # Hills this high have the relief by themselves, and what they lie on adds at most its own.
    most = (relief_m + float(np.ptp(coarse))) / float(np.ptp(coarse_hill))
    factor: Any = optimize.brentq(lacking, 0.0, most)
    height_m += np.float32(factor) * hill


def scaled_to_relief(height_m: NDArray[np.float32], relief_m: float) -> NDArray[np.float32]:
    """Scale and shift heights in place so that they go from 0 to exactly ``relief_m``."""
    height_m -= height_m.min()
    height_m *= np.float32(relief_m) / height_m.max()
    np.minimum(height_m, np.float32(relief_m), out=height_m)
    height_m[np.unravel_index(height_m.argmax(), height_m.shape)] = relief_m
    return height_m
