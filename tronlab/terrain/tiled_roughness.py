"""Self-affine roughness in tiles that join: long waves on a coarse grid, short waves by tiles.

The power spectrum is that of ``procedural.rough_surface``. It is split into two parts whose sum it
is: what varies slowly comes from one Fourier transform of a coarse grid and cubic B-splines through
it; the rest is white noise convolved with a kernel of finite reach (overlap-save, Oppenheim and
Schafer, Discrete-Time Signal Processing, 2010, section 8.7.3), the noise being a pure function of
seed and place.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tronlab.geometry.poses import FloatArray
from tronlab.terrain.kernels import compiled, n_cores, run_interleaved
from tronlab.terrain.procedural import LONGEST_WAVE_M, SLOPE_BASE_M

COARSENING = 8
"""Samples of the map a sample of the coarse grid."""
REACH_PX = 512
"""The kernel of short waves ends here; also the side of a block of noise."""

_COARSE_BORDER = 2
_SHORTEST_COARSE_WAVE_PX = 64
_LONGEST_FINE_WAVE_PX = 128
_N_QUADRATURE = 500


class TiledRoughness:
    """A rough surface, shape ``shape``, metres, of which any tile can be asked for.

    Args:
        seed: Of the terrain.
        shape: Rows and columns of the whole.
        tile_px: Side of a tile, a multiple of ``REACH_PX``.
        spacing_m: Between two samples.
        hurst_exponent: H of the power spectrum ~ k^-(2 H + 2).
        slope: Root mean square to be expected of the rise over a run of 10 mm along a row.
    """

    def __init__(
        self,
        seed: int,
        shape: tuple[int, int],
        *,
        tile_px: int,
        spacing_m: float,
        hurst_exponent: float,
        slope: float,
    ) -> None:
        self._seed = seed
        self._shape = shape
        self._tile_px = tile_px
        self._law = _Law.of_slope(slope, spacing_m, hurst_exponent)
        self._kernel_spectrum = self._law.kernel_spectrum(tile_px + 2 * REACH_PX)
        self._long_waves = self._make_long_waves()

    def tile(self, row: int, column: int) -> NDArray[np.float32]:
        """Make the tile whose first sample is (row, column), multiples of the tile's side."""
        rows = min(self._tile_px, self._shape[0] - row)
        columns = min(self._tile_px, self._shape[1] - column)
        tile = self._short_waves(row, column)[:rows, :columns].copy()
        run_interleaved(
            _add_spline,
            tile,
            self._long_waves[row // COARSENING :, column // COARSENING :],
            _spline_weights(),
            n_threads=n_cores(),
        )
        return tile

    def _short_waves(self, row: int, column: int) -> NDArray[np.float32]:
        """Convolve the noise in and around a tile; only where it is right, the tile, is given."""
        noise = self._noise(row // REACH_PX, column // REACH_PX)
        spectrum: Any = fft.rfft2(noise, workers=n_cores(), overwrite_x=True)
        spectrum *= self._kernel_spectrum
        surface: Any = fft.irfft2(spectrum, s=noise.shape, workers=n_cores(), overwrite_x=True)
        return surface[REACH_PX:-REACH_PX, REACH_PX:-REACH_PX]

    def _noise(self, first_i: int, first_j: int) -> NDArray[np.float32]:
        """Give white noise over the blocks of a tile and those around it, shape (side, side)."""
        n = self._tile_px // REACH_PX + 2
        noise = np.empty((n * REACH_PX, n * REACH_PX), np.float32)

        def fill(i: int, j: int) -> None:
            block = self._generator(first_i + i, first_j + j).standard_normal(
                (REACH_PX, REACH_PX), dtype=np.float32
            )
            noise[i * REACH_PX :, j * REACH_PX :][:REACH_PX, :REACH_PX] = block

        with ThreadPoolExecutor(n_cores()) as pool:
            for made in [pool.submit(fill, i, j) for i in range(n) for j in range(n)]:
                made.result()
        return noise

    def _make_long_waves(self) -> NDArray[np.float32]:
        """Make the B-spline coefficients of the long waves, from 1 before the map's first sample.

        Dividing by the spectrum of the B-spline makes the spline, not its coefficients, follow the
        law (Unser, Splines: a perfect fit for signal and image processing, 1999, eq. 4).
        """
        needed = [(n - 1) // COARSENING + 2 + _COARSE_BORDER for n in self._shape]
        # As much again as the longest wave keeps opposite borders from being alike.
        margin = int(np.ceil(self._law.longest_wave_px / COARSENING))
        padded = [int(fft.next_fast_len(n + margin, real=True)) for n in needed]  # pyright: ignore
        noise = self._generator().standard_normal(padded, dtype=np.float32)
        spectrum: Any = fft.rfft2(noise, workers=n_cores(), overwrite_x=True)
        k_x = fft.fftfreq(padded[0]) / COARSENING
        k_y = fft.rfftfreq(padded[1]) / COARSENING
        over_y = np.sinc(COARSENING * k_y) ** -4
        for i, k in enumerate(k_x):  # row by row: the spectrum is the largest array there is
            k_row = np.hypot(k, k_y)
            gain = self._law.amplitude(k_row) * np.cos(_split_angle(k_row)) / COARSENING
            spectrum[i] *= (gain * over_y * np.sinc(COARSENING * k) ** -4).astype(np.float32)
        spectrum[0, 0] = 0.0
        surface: Any = fft.irfft2(spectrum, s=padded, workers=n_cores(), overwrite_x=True)
        return np.ascontiguousarray(surface[: needed[0], : needed[1]])

    def _generator(self, *block: int) -> np.random.Generator:
        """Give the source of chance of a block of noise; without one, of the long waves."""
        # Blocks before the map's first are number -1; keys must not be negative.
        key = [0, *(n + 1 for n in block)]
        seed = np.random.SeedSequence(self._seed, spawn_key=key)
        return np.random.Generator(np.random.SFC64(seed))


class _Law:
    """The amplitude of each wave; lengths in samples, k in waves a sample."""

    def __init__(self, scale: float, hurst_exponent: float, longest_wave_px: float) -> None:
        self._scale = scale
        self._hurst_exponent = hurst_exponent
        self.longest_wave_px = longest_wave_px

    @classmethod
    def of_slope(cls, slope: float, spacing_m: float, hurst_exponent: float) -> "_Law":
        """Find the law with this root mean square slope over 10 mm."""
        law = cls(1.0, hurst_exponent, LONGEST_WAVE_M / spacing_m)
        run = max(1, round(SLOPE_BASE_M / spacing_m))
        return cls(slope * run * spacing_m / law.rms_rise(run), hurst_exponent, law.longest_wave_px)

    def amplitude(self, k: FloatArray) -> FloatArray:
        """Give by how much white noise of variance 1 is multiplied."""
        return self._scale * np.maximum(k, 1 / self.longest_wave_px) ** -(self._hurst_exponent + 1)

    def rms_rise(self, run: int) -> float:
        """Give the root mean square to be expected of the rise over a run of samples.

        The square is the integral of 2 (1 - cos 2 pi k_y run) times the power spectrum; taken here
        on a grid of equal steps of log k, for one quarter of the plane.
        """
        log_k = np.linspace(np.log(1e-3 / self.longest_wave_px), np.log(0.5), _N_QUADRATURE)
        k = np.exp(log_k)
        width = k * np.gradient(log_k)
        width[[0, -1]] /= 2
        weight_y = 2 * (1 - np.cos(2 * np.pi * k * run)) * width
        rows = [np.sum(self.amplitude(np.hypot(k_x, k)) ** 2 * weight_y) for k_x in k]
        return float(np.sqrt(4 * np.dot(width, rows)))

    def kernel_spectrum(self, side: int) -> NDArray[np.float32]:
        """Give the spectrum of the kernel of short waves on a square grid, shape (side, half).

        What the kernel has beyond its reach, a thousandth, is faded out, so that tiles join.
        """
        k = np.hypot(fft.fftfreq(side)[:, None], fft.rfftfreq(side))
        kernel: Any = fft.irfft2(self.amplitude(k) * np.sin(_split_angle(k)), s=(side, side))
        distance = np.abs(fft.fftfreq(side, 1 / side)) / REACH_PX
        fade = np.cos(np.pi / 2 * np.clip(2 * distance - 1, 0, 1)) ** 2
        spectrum: Any = fft.rfft2(kernel * fade[:, None] * fade)
        return spectrum.real.astype(np.float32)


def _split_angle(k: FloatArray) -> FloatArray:
    """Give the angle whose sine squared is the share of the short waves in the power.

    Between the two wave lengths it goes up as the smooth step 6 x^5 - 15 x^4 + 10 x^3 in log k.
    """
    lowest, highest = 1 / _LONGEST_FINE_WAVE_PX, 1 / _SHORTEST_COARSE_WAVE_PX
    x = np.clip(np.log(np.maximum(k, 1e-12) / lowest) / np.log(highest / lowest), 0.0, 1.0)
    return np.pi / 2 * x**3 * (10 - 15 * x + 6 * x**2)


def _spline_weights() -> NDArray[np.float32]:
    """Give the cubic B-spline's four weights at each place between coarse samples, (places, 4)."""
    t = np.arange(COARSENING) / COARSENING
    weights = [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]
    return (np.stack(weights, axis=1) / 6).astype(np.float32)


@compiled
def _add_spline(tile, coefficients, weights, part, n_parts):
    """Add the spline to every n_parts-th row of a tile; node (0, 0) has coefficient (1, 1)."""
    step = weights.shape[0]
    n_columns = tile.shape[1]
    n_coarse = (n_columns - 1) // step + 4
    across = np.empty(n_coarse, np.float32)
    for i in range(part, tile.shape[0], n_parts):
        first, w = i // step, weights[i % step]
        for j in range(n_coarse):
            across[j] = (
                w[0] * coefficients[first, j]
                + w[1] * coefficients[first + 1, j]
                + w[2] * coefficients[first + 2, j]
                + w[3] * coefficients[first + 3, j]
            )
        for j in range(n_columns):
            k, v = j // step, weights[j % step]
            tile[i, j] += (
                v[0] * across[k]
                + v[1] * across[k + 1]
                + v[2] * across[k + 2]
                + v[3] * across[k + 3]
            )
