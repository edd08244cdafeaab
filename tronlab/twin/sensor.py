"""From the light that reaches the sensor to grey values: blur, photons, electrons, codes."""

from typing import TypeAlias

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tronlab.twin.config import SensorConfig

FloatImage: TypeAlias = NDArray[np.floating]
GreyImage: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

HIGHEST_CODE = {"Mono8": 255, "Mono12": 4095}
"""Highest grey value by pixel format."""

_CODES_PER_MONO8 = 16


def blur(radiance: FloatImage, *, sigma_px: float) -> NDArray[np.float32]:
    """Blur an image (rows, columns) by the lens; beyond the border it goes on as at the border."""
    image = np.asarray(radiance, dtype=np.float32)
    if sigma_px == 0:
        return image
    return np.asarray(gaussian_filter(image, sigma_px, mode="nearest"), dtype=np.float32)


def expose(
    radiance: FloatImage, sensor: SensorConfig, *, exposure_s: float, rng: Generator
) -> FloatImage:
    """Give the electrons read from each pixel, shape (rows, columns).

    Photons arrive at random (Poisson), a full well keeps no more, reading adds normal noise.

    Args:
        radiance: Mean radiance over each pixel, shape (rows, columns), W/(m2 sr).
        sensor: The sensor.
        exposure_s: Time of exposure.
        rng: Source of the noise.
    """
    mean_e = np.asarray(radiance, dtype=np.float64) * (sensor.electrons_per_radiance * exposure_s)
    collected_e = np.minimum(rng.poisson(mean_e), sensor.full_well_e)
    return collected_e + sensor.read_noise_e * rng.standard_normal(mean_e.shape)


def digitise(
    electrons: FloatImage, sensor: SensorConfig, *, gain_db: float, pixel_format: str
) -> GreyImage:
    """Convert electrons (rows, columns) to codes of 12 bits; Mono8 is their upper eight bits.

    The converter ends at 0 and at 4095: what lies beyond is lost, as in the real camera.
    """
    gain = 10.0 ** (gain_db / 20.0)
    codes = np.rint(electrons * (gain * HIGHEST_CODE["Mono12"] / sensor.full_well_e))
    codes = np.clip(codes, 0, HIGHEST_CODE["Mono12"]).astype(np.uint16)
    return codes if pixel_format == "Mono12" else (codes // _CODES_PER_MONO8).astype(np.uint8)
