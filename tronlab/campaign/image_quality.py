"""Numbers of one image that tell a good exposure from a poor one; none needs a second image."""

from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

FULL_SCALE = {"Mono8": 255, "Mono12": 4095}
"""Highest grey value by pixel format."""

_ROW_STEP = 4
"""Every fourth pair of rows is looked at: a quarter of a million pixels are plenty."""
_MARGIN_PX = 3
"""So far from the model's outline along a row: the outline is sharp, whatever the terrain is."""

_MIN_SHARED_PART = 0.05
"""If neighbours share less of the variance, it is noise and no structure."""

GreyImage: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
Mask: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Exposure:
    """How the grey values of an image are spread."""

    mean_grey: float
    contrast: float
    """Standard deviation over mean; 0 if all is black."""
    saturated_fraction: float
    """Part of the pixels at full scale."""


def measure_exposure(image: GreyImage, mask: Mask, *, full_scale: int) -> Exposure:
    """Measure how the grey values within a mask are spread.

    Args:
        image: Grey values, shape (rows, columns).
        mask: Where to look, same shape; nowhere means everywhere.
        full_scale: Highest grey value of the pixel format.
    """
    counts = _histogram(image, mask, full_scale=full_scale)
    n = counts.sum()
    greys = np.arange(len(counts))
    mean = float(counts @ greys / n)
    variance = float(counts @ (greys - mean) ** 2 / n)
    return Exposure(
        mean_grey=mean,
        contrast=np.sqrt(variance) / mean if mean > 0 else 0.0,
        saturated_fraction=float(counts[full_scale] / n),
    )


def measure_sharpness(image: GreyImage, mask: Mask) -> float:
    """Measure how fine the structure of an image is, without the part that noise makes.

    Second differences along rows and columns, squared and summed, over the variance of the grey
    values: an image and its multiple are equally sharp. Instead of squares, products of
    neighbouring rows (columns) are taken: structure is nearly the same in both, noise is
    independent, so that on average it adds nothing. A bare Laplacian would call a dim, noisy image
    sharp.

    Args:
        image: Grey values, shape (rows, columns).
        mask: Where to look, same shape; nowhere means everywhere.

    Returns:
        0 for an image without structure; what is sharp depends on terrain and distance.
    """
    within = mask if mask.any() else np.ones_like(mask)
    variance = (_shared_variance(image, within) + _shared_variance(image.T, within.T)) / 2
    if variance <= 0:
        return 0.0
    energy = _shared_curvature(image, within) + _shared_curvature(image.T, within.T)
    return max(0.0, energy / variance)


def _histogram(image: GreyImage, mask: Mask, *, full_scale: int) -> NDArray[np.float64]:
    within = mask.view(np.uint8) if mask.any() else None
    n_greys = full_scale + 1
    counts = cv2.calcHist([np.ascontiguousarray(image)], [0], within, [n_greys], [0, n_greys])
    return counts.ravel().astype(np.float64)


def _shared_curvature(image: GreyImage, within: Mask) -> float:
    """Give the mean product of the second differences along neighbouring rows."""
    upper, lower, weight = _row_pairs(image, within)
    inner = weight[:, 2 * _MARGIN_PX :] * weight[:, : -2 * _MARGIN_PX]
    n = float(inner.sum())
    return float(np.vdot(_second_difference(upper) * inner, _second_difference(lower))) / max(n, 1)


def _second_difference(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    last = rows.shape[1]
    left, middle, right = (
        rows[:, _MARGIN_PX + shift : last - _MARGIN_PX + shift] for shift in (-1, 0, 1)
    )
    return left - 2 * middle + right


def _shared_variance(image: GreyImage, within: Mask) -> float:
    """Give the covariance of neighbouring rows; 0 if there is next to nothing but noise."""
    upper, lower, weight = _row_pairs(image, within)
    n = max(float(weight.sum()), 1)
    about_upper = (upper - np.vdot(upper, weight) / n) * weight
    about_lower = (lower - np.vdot(lower, weight) / n) * weight
    shared = float(np.vdot(about_upper, about_lower)) / n
    variance = float(np.vdot(about_upper, about_upper)) / n
    return shared if shared > _MIN_SHARED_PART * variance else 0.0


def _row_pairs(
    image: GreyImage, within: Mask
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Give upper and lower rows of pairs of neighbours, and 1 where both are looked at, else 0."""
    upper, lower = image[:-1:_ROW_STEP], image[1::_ROW_STEP]
    both = within[:-1:_ROW_STEP] & within[1::_ROW_STEP]
    return upper.astype(np.float32), lower.astype(np.float32), both.astype(np.float32)
