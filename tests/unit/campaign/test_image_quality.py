import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from tronlab.campaign.image_quality import (
    FULL_SCALE,
    Exposure,
    measure_exposure,
    measure_sharpness,
)

SHAPE = (240, 320)
EVERYWHERE = np.ones(SHAPE, dtype=np.bool_)
MONO8 = FULL_SCALE["Mono8"]


def texture(seed: int = 0, *, blur_px: float = 0.8) -> np.ndarray:
    """Grey values about 1000 of 4095, with structure of all sizes."""
    noise = np.random.default_rng(seed).standard_normal(SHAPE)
    fine, coarse = gaussian_filter(noise, blur_px), gaussian_filter(noise, 8.0)
    return 1000 + 150 * fine / fine.std() + 100 * coarse / coarse.std()


def mono12(image: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(image), 0, 4095).astype(np.uint16)


def test_exposure_is_that_of_the_pixels_within_the_mask() -> None:
    image = np.zeros(SHAPE, dtype=np.uint8)
    mask = np.zeros(SHAPE, dtype=np.bool_)
    mask[:, :4] = True
    image[:, 0], image[:, 1], image[:, 2:4] = 255, 45, 100
    found = measure_exposure(image, mask, full_scale=MONO8)
    assert found.mean_grey == pytest.approx(125.0)
    assert found.contrast == pytest.approx(np.std([255, 45, 100, 100]) / 125.0)
    assert found.saturated_fraction == 0.25


def test_without_a_mask_all_pixels_count_and_black_has_no_contrast() -> None:
    black, nowhere = np.zeros(SHAPE, dtype=np.uint8), np.zeros(SHAPE, dtype=np.bool_)
    assert measure_exposure(black, nowhere, full_scale=MONO8) == Exposure(0.0, 0.0, 0.0)
    white = np.full(SHAPE, 4095, dtype=np.uint16)
    assert measure_exposure(white, nowhere, full_scale=4095) == Exposure(4095.0, 0.0, 1.0)
    # of another format this grey value is not the highest one
    assert measure_exposure(white // 2, nowhere, full_scale=4095).saturated_fraction == 0.0


@given(period_px=st.floats(4.0, 40.0), is_along_rows=st.booleans(), phase=st.floats(0, 6.28))
def test_sharpness_of_a_wave_is_as_in_theory(
    period_px: float, is_along_rows: bool, phase: float
) -> None:
    # A second difference multiplies a wave of wave number k by -(2 - 2 cos k). Its variance is seen
    # whole by neighbours along its crests, and by the factor cos k by those across.
    k = 2 * np.pi / period_px
    wave = np.sin(k * np.arange(160) + phase)
    image = mono12(2000 + 1800 * np.tile(wave, (160, 1)))
    if not is_along_rows:
        image = np.ascontiguousarray(image.T)
    found = measure_sharpness(image, np.ones(image.shape, dtype=np.bool_))
    expected = (2 - 2 * np.cos(k)) ** 2 / ((1 + np.cos(k)) / 2)
    assert found == pytest.approx(expected, rel=0.06, abs=1e-5)


def test_noise_is_not_taken_for_sharpness() -> None:
    clean = texture(blur_px=2.0)
    rng = np.random.default_rng(1)
    noisy = clean + 40 * rng.standard_normal(SHAPE)
    found = measure_sharpness(mono12(noisy), EVERYWHERE)
    assert found == pytest.approx(measure_sharpness(mono12(clean), EVERYWHERE), rel=0.25)
    # what a plain Laplacian would say: the noise alone has many times that energy
    assert 72 * 40**2 / np.var(clean) > 30 * found


def test_nothing_but_noise_has_no_structure() -> None:
    noise = 1000 + 30 * np.random.default_rng(2).standard_normal(SHAPE)
    assert measure_sharpness(mono12(noise), EVERYWHERE) == 0.0
    assert measure_sharpness(np.full(SHAPE, 7, dtype=np.uint8), EVERYWHERE) == 0.0


@pytest.mark.parametrize("factor", [0.3, 2.0])
def test_sharpness_does_not_depend_on_exposure_or_orientation(factor: float) -> None:
    image = texture(4)
    found = measure_sharpness(mono12(image), EVERYWHERE)
    assert measure_sharpness(mono12(factor * image), EVERYWHERE) == pytest.approx(found, rel=0.01)
    turned = np.ascontiguousarray(mono12(image).T)
    assert measure_sharpness(turned, EVERYWHERE.T) == pytest.approx(found, rel=1e-6)


def test_outline_of_the_model_is_not_taken_for_structure() -> None:
    smooth, mask = texture(blur_px=4.0), np.zeros(SHAPE, dtype=np.bool_)
    mask[60:180, 80:240] = True
    on_black = np.where(mask, smooth, 0.0)
    expected = measure_sharpness(mono12(smooth), mask)
    assert measure_sharpness(mono12(on_black), mask) == pytest.approx(expected)
    # the outline itself is far sharper than what it surrounds
    assert measure_sharpness(mono12(on_black), EVERYWHERE) > 3 * expected


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (5, 40), (40, 5), (7, 7)])
def test_tiny_images_are_measured_as_well(shape: tuple[int, int]) -> None:
    image = np.arange(np.prod(shape), dtype=np.uint8).reshape(shape)
    assert measure_sharpness(image, np.ones(shape, dtype=np.bool_)) >= 0.0
