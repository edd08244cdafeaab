import numpy as np
import pytest

from tronlab.twin.config import SensorConfig
from tronlab.twin.sensor import blur, digitise, expose

SENSOR = SensorConfig()


def flat(electrons: float, *, exposure_s: float = 0.02, side: int = 400):
    radiance = electrons / (SENSOR.electrons_per_radiance * exposure_s)
    return np.full((side, side), radiance, np.float32)


@pytest.mark.parametrize("electrons", [0.0, 50.0, 1000.0, 8000.0])
def test_photon_transfer_variance_is_mean_plus_read_noise(electrons: float):
    rng = np.random.default_rng(1)
    image = expose(flat(electrons), SENSOR, exposure_s=0.02, rng=rng)
    variance = electrons + SENSOR.read_noise_e**2
    n = image.size
    assert image.mean() == pytest.approx(electrons, abs=5 * np.sqrt(variance / n))
    # The variance of a sample variance is 2 s^4 / n for normal noise, a little more for Poisson.
    assert image.var() == pytest.approx(variance, rel=6 * np.sqrt(2 / n))


def test_full_well_keeps_no_more():
    rng = np.random.default_rng(2)
    image = expose(flat(50_000.0), SENSOR, exposure_s=0.02, rng=rng)
    assert image.mean() == pytest.approx(SENSOR.full_well_e, abs=1.0)
    assert image.std() == pytest.approx(SENSOR.read_noise_e, rel=0.02)


def test_brightness_is_linear_in_exposure_until_it_saturates():
    radiance = flat(2000.0)
    means = []
    for exposure_s in (0.01, 0.02, 0.04, 0.08, 0.2, 0.4):
        rng = np.random.default_rng(3)
        electrons = expose(radiance, SENSOR, exposure_s=exposure_s, rng=rng)
        means.append(digitise(electrons, SENSOR, gain_db=0.0, pixel_format="Mono12").mean())
    expected = np.array([1000.0, 2000.0, 4000.0, 8000.0]) * 4095 / SENSOR.full_well_e
    np.testing.assert_allclose(means[:4], expected, rtol=1e-3)
    assert means[4] == pytest.approx(4095, abs=2)
    assert means[5] == pytest.approx(4095, abs=2)


def test_mono12_fills_its_range_and_mono8_is_its_upper_eight_bits():
    electrons = np.linspace(-100.0, 20_000.0, 10_001)[None]
    codes12 = digitise(electrons, SENSOR, gain_db=0.0, pixel_format="Mono12")
    codes8 = digitise(electrons, SENSOR, gain_db=0.0, pixel_format="Mono8")
    assert codes12.dtype == np.uint16
    assert codes8.dtype == np.uint8
    assert (codes12.min(), codes12.max()) == (0, 4095)
    assert (codes8.min(), codes8.max()) == (0, 255)
    np.testing.assert_array_equal(codes8, codes12 >> 4)


def test_gain_of_six_db_doubles_codes_and_not_electrons():
    electrons = np.full((1, 1), 1000.0)
    once, twice = (
        int(digitise(electrons, SENSOR, gain_db=gain_db, pixel_format="Mono12")[0, 0])
        for gain_db in (0.0, 20 * np.log10(2.0))
    )
    assert (once, twice) == (256, 512)


def test_blur_keeps_light_and_has_the_stated_width():
    point = np.zeros((41, 41), np.float32)
    point[20, 20] = 1.0
    image = blur(point, sigma_px=2.0).astype(float)
    u = np.arange(41) - 20.0
    assert image.sum() == pytest.approx(1.0, abs=1e-5)
    assert (image.sum(axis=0) @ u**2) == pytest.approx(4.0, rel=0.01)
    assert (image.sum(axis=1) @ u**2) == pytest.approx(4.0, rel=0.01)


def test_no_blur_leaves_the_image():
    image = np.arange(12, dtype=np.float32).reshape(3, 4)
    np.testing.assert_array_equal(blur(image, sigma_px=0.0), image)
