"""Features of an image: found, described, bounded in number and spread over the image."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from tronlab.errors import TronlabError
from tronlab.geometry.poses import FloatArray
from tronlab.nav.core import GreyImage, Mask
from tronlab.nav.settings import DetectorSettings

STRETCH_PERCENTILES = (0.5, 99.5)
"""Grey values of the usable area that become black and white: detection thresholds then mean the
same for a bright and a dark exposure, and 12-bit images keep what they hold of contrast."""
WINDOW_BORDER_PX = 32
WINDOW_STEP_PX = 48
"""The window around the usable area begins at a multiple of this, so that a detector samples its
octaves (factors 2) and the layers between (BRISK: 1.5) at the same pixels whatever the mask."""


class ImageError(TronlabError):
    """An image or a mask is not what a navigation core can work on."""


@dataclass(frozen=True, slots=True)
class Features:
    """Features of one image, the strongest first within each turn of the cells."""

    uv: FloatArray
    """Image positions, shape (n, 2), pixels."""
    size_px: FloatArray
    """Diameter of the neighbourhood each was found in, shape (n,)."""
    descriptors: NDArray[np.uint8]
    """Binary descriptors packed into bytes, shape (n, b)."""

    def __len__(self) -> int:
        return len(self.uv)

    def take(self, chosen: slice) -> "Features":
        """Give the chosen ones."""
        return Features(self.uv[chosen], self.size_px[chosen], self.descriptors[chosen])


class KeypointFinder(Protocol):
    """What OpenCV's feature classes have in common."""

    def detect(self, image: Any, mask: Any) -> Sequence[cv2.KeyPoint]:
        """Find keypoints where the mask is not zero."""
        ...

    def compute(self, image: Any, keypoints: Any) -> tuple[Sequence[cv2.KeyPoint], Any]:
        """Describe keypoints; those too near the border are left out."""
        ...

    def detectAndCompute(  # noqa: N802  # OpenCV's name
        self, image: Any, mask: Any
    ) -> tuple[Sequence[cv2.KeyPoint], Any]:
        """Find and describe keypoints in one go."""
        ...


@dataclass(frozen=True, slots=True)
class Detector:
    """A feature detector, and how it is used here."""

    name: str
    make: Callable[[], KeypointFinder]
    n_max: int
    """Most features kept of an image."""
    window_per_size: float
    """Radius of the descriptor's window over the size of the keypoint."""
    is_cheap_to_describe: bool
    """True if describing after detecting repeats no work, so that only the features kept are
    described."""
    cell_px: float | None = 48.0
    """Side of the square cells over which features are spread; None: they are not."""


def _opencv_factory(name: str) -> Callable[..., KeypointFinder]:
    """Look a feature class up: OpenCV 5 moved AKAZE and BRISK into ``xfeatures2d``."""
    home: Any = cv2 if hasattr(cv2, name) else cv2.xfeatures2d
    return getattr(home, name)


def _akaze(threshold: float) -> KeypointFinder:
    return _opencv_factory("AKAZE_create")(threshold=threshold)


def _brisk(threshold: float) -> KeypointFinder:
    return _opencv_factory("BRISK_create")(thresh=round(threshold))


AKAZE = Detector(
    name="akaze",
    make=partial(_akaze, 0.001),
    n_max=2000,
    window_per_size=5.0,
    is_cheap_to_describe=False,
)
BRISK = Detector(
    name="brisk",
    make=partial(_brisk, 30.0),
    n_max=3000,
    window_per_size=0.85,
    is_cheap_to_describe=True,
)


def make_detector(settings: DetectorSettings) -> Detector:
    """Give the detector that settings ask for."""
    base, factory = {"akaze": (AKAZE, _akaze), "brisk": (BRISK, _brisk)}[settings.features]
    threshold = settings.threshold
    return replace(
        base,
        make=base.make if threshold is None else partial(factory, threshold),
        n_max=settings.n_max or base.n_max,
        cell_px=settings.cell_px,
    )


def detect_features(image: GreyImage, mask: Mask, detector: Detector) -> Features:
    """Find at most ``detector.n_max`` features whose descriptor window lies within the mask.

    Args:
        image: Grey values, shape (rows, columns); uint16 holds 12 bit.
        mask: True where the image shows what may be used, same shape.
        detector: Which features, and how many.

    Raises:
        ImageError: Image and mask do not fit, or are of a type no camera here delivers.
    """
    _check(image, mask)
    if not mask.any():
        return _no_features()
    window, corner = _usable_window(mask)
    found = _detect(grey_8_bit(image[window], mask[window]), mask[window], detector)
    return Features(found.uv + corner, found.size_px, found.descriptors)


def grey_8_bit(image: GreyImage, mask: Mask) -> NDArray[np.uint8]:
    """Stretch the contrast of the usable area, which must not be empty, to 8 bit."""
    black, white = np.percentile(image[mask], STRETCH_PERCENTILES)
    scale = 255.0 / max(white - black, 1.0)
    levels = np.arange(np.iinfo(image.dtype).max + 1)
    table = np.clip(np.rint((levels - black) * scale), 0, 255).astype(np.uint8)
    return table[image]


def spread_over_image(
    uv: FloatArray, strength: FloatArray, *, n_max: int, cell_px: float | None
) -> NDArray[np.intp]:
    """Choose features in turns: every cell of the image gives its strongest, then its second.

    Args:
        uv: Image positions, shape (n, 2).
        strength: What to prefer, shape (n,).
        n_max: Most features chosen.
        cell_px: Side of a square cell; None: the whole image is one.

    Returns:
        Indices of the chosen, at most ``n_max``, in the order chosen.
    """
    turn = np.zeros(len(uv)) if cell_px is None else turns_of_cells(uv, strength, side=cell_px)
    return np.lexsort((uv[:, 0], uv[:, 1], -strength, turn))[:n_max]


def turns_of_cells(places: FloatArray, strength: FloatArray, *, side: float) -> NDArray[np.int64]:
    """Give for each of some places how many stronger ones its cell of the plane has, shape (n,).

    Args:
        places: In the image or on the ground, shape (n, 2).
        strength: Shape (n,); of equals the one with the least second coordinate comes first.
        side: Of the square cells, in the unit of the places.
    """
    cells = np.floor(places / side).astype(np.int64)
    cell = cells[:, 1] * 100_000 + cells[:, 0]
    by_cell = np.lexsort((places[:, 0], places[:, 1], -strength, cell))
    number = np.arange(len(places))
    starts = np.r_[True, np.diff(cell[by_cell]) != 0] if len(places) else np.zeros(0, bool)
    turn = np.empty(len(places), np.int64)
    turn[by_cell] = number - np.maximum.accumulate(np.where(starts, number, 0))
    return turn


def _check(image: GreyImage, mask: Mask) -> None:
    if image.ndim != 2 or image.dtype.name not in {"uint8", "uint16"}:
        raise ImageError(
            f"image: {image.dtype} of shape {image.shape}, expected uint8 or uint16 (rows, columns)"
        )
    if mask.shape != image.shape or mask.dtype != np.bool_:
        raise ImageError(
            f"mask: {mask.dtype} of shape {mask.shape}, expected bool of shape {image.shape}"
        )


def _usable_window(mask: Mask) -> tuple[tuple[slice, slice], FloatArray]:
    """Give the part of the image around the usable area, and (u, v) of its first pixel.

    What lies outside costs time and counts in AKAZE's measure of contrast.
    """
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    top, left = (max(int(used[0]) - WINDOW_BORDER_PX, 0) for used in (rows, columns))
    top, left = (first // WINDOW_STEP_PX * WINDOW_STEP_PX for first in (top, left))
    bottom, right = (int(used[-1]) + 1 + WINDOW_BORDER_PX for used in (rows, columns))
    return (slice(top, bottom), slice(left, right)), np.array([left, top], np.float64)


def _detect(grey: NDArray[np.uint8], mask: Mask, detector: Detector) -> Features:
    finder = detector.make()
    clearance_px = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    inside = (clearance_px > 1.0).astype(np.uint8)
    if detector.is_cheap_to_describe:
        chosen = _choose(finder.detect(grey, inside), clearance_px, detector)[0]
        keypoints, descriptors = finder.compute(grey, chosen)
    else:
        found, described = finder.detectAndCompute(grey, inside)
        keypoints, indices = _choose(found, clearance_px, detector)
        descriptors = described[indices] if len(keypoints) else None
    if descriptors is None or not len(keypoints):
        return _no_features()
    return Features(_positions(keypoints), _sizes(keypoints), np.ascontiguousarray(descriptors))


def _choose(
    keypoints: Sequence[cv2.KeyPoint], clearance_px: NDArray[Any], detector: Detector
) -> tuple[list[cv2.KeyPoint], NDArray[np.intp]]:
    if not keypoints:
        return [], np.zeros(0, np.intp)
    uv, size = _positions(keypoints), _sizes(keypoints)
    strength = np.array([keypoint.response for keypoint in keypoints])
    column, row = np.rint(uv).astype(np.intp).T
    rows, columns = clearance_px.shape
    clearance = clearance_px[row.clip(0, rows - 1), column.clip(0, columns - 1)]
    inside = np.flatnonzero(clearance > detector.window_per_size * size)
    spread = spread_over_image(
        uv[inside], strength[inside], n_max=detector.n_max, cell_px=detector.cell_px
    )
    chosen = inside[spread]
    return [keypoints[i] for i in chosen], chosen


def _positions(keypoints: Sequence[cv2.KeyPoint]) -> FloatArray:
    return np.array([keypoint.pt for keypoint in keypoints], np.float64).reshape(-1, 2)


def _sizes(keypoints: Sequence[cv2.KeyPoint]) -> FloatArray:
    return np.array([keypoint.size for keypoint in keypoints], np.float64)


def _no_features() -> Features:
    return Features(np.empty((0, 2)), np.empty(0), np.empty((0, 0), np.uint8))
