"""Features: bounded, spread, within the mask, the same for any exposure."""

from dataclasses import replace

import numpy as np
import pytest

from tronlab.nav.features import (
    AKAZE,
    BRISK,
    Detector,
    ImageError,
    detect_features,
    grey_8_bit,
    spread_over_image,
)

pytestmark = pytest.mark.opencv
DETECTORS = pytest.mark.parametrize("detector", [AKAZE, BRISK], ids=lambda d: d.name)


@pytest.fixture(scope="module")
def image(scene, pose) -> np.ndarray:
    return np.rint(scene.see(pose(1.6))[0]).astype(np.uint8)


@DETECTORS
def test_number_is_bounded_and_bytes_repeat(detector: Detector, image: np.ndarray) -> None:
    mask = np.ones(image.shape, np.bool_)
    every = detect_features(image, mask, detector)
    few = detect_features(image, mask, replace(detector, n_max=50))
    assert len(every) > 100
    assert len(few) == 50
    assert len(few.descriptors) == len(few.size_px) == 50
    again = detect_features(image, mask, replace(detector, n_max=50))
    np.testing.assert_array_equal(few.descriptors, again.descriptors)
    np.testing.assert_array_equal(few.uv, again.uv)


@DETECTORS
def test_descriptor_windows_stay_within_the_mask(detector: Detector, image: np.ndarray) -> None:
    mask = np.zeros(image.shape, np.bool_)
    mask[60:250, 70:300] = True
    features = detect_features(image, mask, detector)
    assert len(features) > 10
    radius = detector.window_per_size * features.size_px
    assert (features.uv[:, 0] - radius > 68).all()
    assert (features.uv[:, 0] + radius < 301).all()
    assert (features.uv[:, 1] - radius > 58).all()
    assert (features.uv[:, 1] + radius < 251).all()


@DETECTORS
def test_positions_do_not_depend_on_the_window(detector: Detector, image: np.ndarray) -> None:
    """Only the usable part is searched; its features are those of the whole image."""
    detector = replace(detector, n_max=100_000)
    everywhere = detect_features(image, np.ones(image.shape, np.bool_), detector)
    mask = np.zeros(image.shape, np.bool_)
    mask[100:, 110:] = True
    part = detect_features(image, mask, detector)
    nearest = np.linalg.norm(part.uv[:, None] - everywhere.uv[None], axis=2).min(axis=1)
    assert len(part) > 10
    assert np.median(nearest) < 0.3


@DETECTORS
def test_12_bit_and_dark_images_give_the_same_features(
    detector: Detector, image: np.ndarray
) -> None:
    mask = np.ones(image.shape, np.bool_)
    bright = detect_features(image, mask, detector)
    for other in (image.astype(np.uint16) * 16, image.astype(np.uint16) * 4 + 30):
        found = detect_features(other, mask, detector)
        assert len(found) == pytest.approx(len(bright), rel=0.02)
        nearest = np.linalg.norm(found.uv[:, None] - bright.uv[None], axis=2).min(axis=1)
        assert np.mean(nearest < 0.1) > 0.97


def test_grey_values_are_stretched_over_the_usable_area_only() -> None:
    image = np.full((20, 20), 4095, np.uint16)
    image[:, :10] = np.linspace(100, 300, 200).reshape(20, 10)
    mask = np.zeros((20, 20), np.bool_)
    mask[:, :10] = True
    grey = grey_8_bit(image, mask)
    assert grey[mask].min() == 0
    assert grey[mask].max() == 255
    assert np.median(grey[mask]) == pytest.approx(127.5, abs=2)


@DETECTORS
def test_nothing_to_see_gives_no_features(detector: Detector, image: np.ndarray) -> None:
    nowhere = np.zeros(image.shape, np.bool_)
    assert len(detect_features(image, nowhere, detector)) == 0
    flat = np.full(image.shape, 80, np.uint8)
    assert len(detect_features(flat, ~nowhere, detector)) == 0
    speck = nowhere.copy()
    speck[10, 10] = True
    assert len(detect_features(image, speck, detector)) == 0


def test_spread_takes_turns_between_cells() -> None:
    crowd = np.column_stack([np.linspace(1, 40, 90), np.full(90, 10.0)])
    uv = np.vstack([crowd, [[200.0, 200.0], [200.0, 10.0]]])
    strength = np.r_[np.full(90, 9.0), 1.0, 2.0]
    chosen = spread_over_image(uv, strength, n_max=4, cell_px=48.0)
    assert {90, 91} <= set(chosen.tolist()[:3])
    assert len(chosen) == 4
    assert len(spread_over_image(np.empty((0, 2)), np.empty(0), n_max=4, cell_px=48.0)) == 0


def test_wrong_images_are_refused(image: np.ndarray) -> None:
    mask = np.ones(image.shape, np.bool_)
    with pytest.raises(ImageError, match=r"float64 of shape .* expected uint8 or uint16"):
        detect_features(image.astype(np.float64), mask, AKAZE)
    with pytest.raises(ImageError, match=r"mask: bool of shape \(5, 5\), expected bool of shape"):
        detect_features(image, np.ones((5, 5), np.bool_), AKAZE)
    with pytest.raises(ImageError, match="mask: uint8"):
        detect_features(image, mask.astype(np.uint8), AKAZE)
