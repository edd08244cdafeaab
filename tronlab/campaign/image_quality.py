"""Numbers of one image that tell a good exposure from a poor one; none needs a second image."""

from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

FULL_SCALE = {"Mono8": 255, "Mono12": 4095}
"""Highest grey value by pixel format."""

_N_PAIRS = 160
"""So many pairs of neighbouring rows are looked at: a hundred thousand pixels are plenty."""
_GOLDEN = (5**0.5 - 1) / 2
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
    along_rows = _shared_structure(_row_pairs(image, within))
    along_columns = _shared_structure(_row_pairs(image.T, within.T))
    variance = (along_rows.variance + along_columns.variance) / 2
    if variance <= 0:
        return 0.0
    return max(0.0, (along_rows.curvature + along_columns.curvature) / variance)


def _histogram(image: GreyImage, mask: Mask, *, full_scale: int) -> NDArray[np.float64]:
    within = mask.view(np.uint8) if mask.any() else None
    n_greys = full_scale + 1
    counts = cv2.calcHist([np.ascontiguousarray(image)], [0], within, [n_greys], [0, n_greys])
    return counts.ravel().astype(np.float64)


@dataclass(frozen=True, slots=True)
class _RowPairs:
    """Some rows, and below each the next one."""

    upper: NDArray[np.float32]
    lower: NDArray[np.float32]
    weight: NDArray[np.float32]
    """1 where both are looked at, else 0."""


@dataclass(frozen=True, slots=True)
class _Structure:
    """What neighbouring rows have in common, and noise has not."""

    variance: float
    """0 if there is next to nothing but noise."""
    curvature: float
    """Mean product of the second differences along the rows."""


def _row_pairs(image: GreyImage, within: Mask) -> _RowPairs:
    upper = _spread_rows(len(image) - 1)
    both = within[upper] & within[upper + 1]
    return _RowPairs(
        image[upper].astype(np.float32, order="C"),
        image[upper + 1].astype(np.float32, order="C"),
        both.astype(np.float32, order="C"),
    )


def _spread_rows(n_rows: int) -> NDArray[np.intp]:
    """Choose rows spread over so many, at steps that no regular structure is in step with."""
    n = min(_N_PAIRS, n_rows)
    i = np.arange(n)
    return ((i + i * _GOLDEN % 1.0) * (n_rows / max(n, 1))).astype(np.intp)


def _shared_structure(pairs: _RowPairs) -> _Structure:
    n = max(float(pairs.weight.sum()), 1.0)
    about_upper = (pairs.upper - np.vdot(pairs.upper, pairs.weight) / n) * pairs.weight
    about_lower = (pairs.lower - np.vdot(pairs.lower, pairs.weight) / n) * pairs.weight
    shared = float(np.vdot(about_upper, about_lower)) / n
    variance = float(np.vdot(about_upper, about_upper)) / n
    inner = pairs.weight[:, 2 * _MARGIN_PX :] * pairs.weight[:, : -2 * _MARGIN_PX]
    curved = np.vdot(_second_difference(pairs.upper) * inner, _second_difference(pairs.lower))
    return _Structure(
        variance=shared if shared > _MIN_SHARED_PART * variance else 0.0,
        curvature=float(curved) / max(float(inner.sum()), 1.0),
    )


def _second_difference(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    last = rows.shape[1]
    left, middle, right = (
        rows[:, _MARGIN_PX + shift : last - _MARGIN_PX + shift] for shift in (-1, 0, 1)
    )
    return left - 2 * middle + right
