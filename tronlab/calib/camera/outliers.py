"""Views and corners that do not belong: found by their residuals, never by hand.

A camera general enough for any lens is fitted with Huber's weights, which bound the pull of a wrong
corner (Huber, Robust Statistics, 1981, section 7.3). A corner is an outlier beyond ``CORNER_LIMIT``
sigma. A view is one if it fits far worse than the others, by a scatter that outliers do not
enlarge, or if more than ``MAX_BAD_PART`` of its corners are outliers.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tronlab.calib.camera.board import BoardView
from tronlab.calib.camera.fit import fit_camera, residuals_px
from tronlab.calib.camera.projection import DistortionModel
from tronlab.calib.camera.state import CameraFit, CameraKind, Corners
from tronlab.errors import CalibrationError
from tronlab.geometry.poses import FloatArray

CORNER_LIMIT = 5.0
"""In sigma of a coordinate; one in 300 000 good corners is as far off."""
MAX_BAD_PART = 0.1
"""Of a view's corners; with more of them wrong, the cause is not theirs alone."""
VIEW_LIMIT = 5.0
"""In robust sigma of the logarithms of the views' rms."""
VIEW_FACTOR = 2.0
"""A view with less than this times the usual rms does no harm."""
_GENERAL_MODELS: tuple[DistortionModel, ...] = ("brown", "rational")
_HUBER = 1.5
_ROUNDS = 3
_BEST_PART = 0.9
"""Of a view's corners; the others do not count when views are compared."""
_MEDIAN_LENGTH = np.sqrt(2 * np.log(2))
"""Median length of a residual in sigma of a coordinate (Rayleigh's distribution)."""
_MAD_PER_SIGMA = 0.6745
_EXACT_PX = 1e-4
"""No corner is known better: below it, residuals are rounding."""


@dataclass(frozen=True, slots=True)
class Sorted:
    """Which corners and views belong."""

    is_good: NDArray[np.bool_]
    """Of each corner in ``Corners``, shape (n_views, n); none of an outlier view."""
    outlier_views: tuple[int, ...]
    fit: CameraFit
    """The robust one, of all views."""
    sigma_px: float
    """One robust sigma of a corner's coordinate."""

    def outlier_corners(self, views: Sequence[BoardView]) -> tuple[tuple[int, int], ...]:
        """Give (view, number of the corner) of single corners in good views."""
        return tuple(
            (i, int(number))
            for i, view in enumerate(views)
            if i not in self.outlier_views
            for number in view.ids[~self.is_good[i, : len(view)]]
        )


def sort_out(corners: Corners, start: CameraFit, model: DistortionModel | None) -> Sorted:
    """Find the views and corners that do not belong.

    Args:
        corners: All that were found.
        start: Where the robust solution starts.
        model: The distortion model if it is given; else the most general that converges.

    Raises:
        CalibrationError: No model converges.
    """
    fit, lengths, sigma_px = _robust(corners, start, model)
    is_seen = corners.weights > 0
    outlier_views = _outlier_views(np.where(is_seen, lengths, np.nan))
    is_good = is_seen & (lengths <= CORNER_LIMIT * sigma_px)
    bad_part = 1.0 - is_good.sum(axis=1) / is_seen.sum(axis=1)
    spoilt = np.flatnonzero(bad_part > MAX_BAD_PART)
    outlier_views = tuple(sorted({*outlier_views, *spoilt.tolist()}))
    is_good[list(outlier_views)] = False
    return Sorted(is_good, outlier_views, fit, sigma_px)


def _robust(
    corners: Corners, start: CameraFit, model: DistortionModel | None
) -> tuple[CameraFit, FloatArray, float]:
    """Weigh, solve, and weigh again; a model too general to converge is left alone."""
    first, *more = _GENERAL_MODELS if model is None else (model,)
    fit = _huber_fit(
        corners, fit_camera(corners, start, CameraKind(first, True), sigma_px=1.0), first
    )
    for name in more:
        with suppress(CalibrationError):
            fit = _huber_fit(corners, fit, name)
    lengths = _lengths(corners, fit)
    return fit, lengths, _robust_sigma(corners, lengths)


def _huber_fit(corners: Corners, fit: CameraFit, model: DistortionModel) -> CameraFit:
    for _ in range(_ROUNDS):
        lengths = _lengths(corners, fit)
        bound = _HUBER * _robust_sigma(corners, lengths)
        weights = corners.weights * np.minimum(1.0, bound / np.maximum(lengths, bound))
        fit = fit_camera(corners.weighted(weights), fit, CameraKind(model, True), sigma_px=1.0)
    return fit


def _lengths(corners: Corners, fit: CameraFit) -> FloatArray:
    return np.linalg.norm(residuals_px(corners, fit), axis=2)


def _robust_sigma(corners: Corners, lengths: FloatArray) -> float:
    return max(float(np.median(lengths[corners.weights > 0])) / _MEDIAN_LENGTH, _EXACT_PX)


def _outlier_views(lengths: FloatArray) -> tuple[int, ...]:
    """Compare the views by the rms of their better corners; ``lengths`` is NaN where is none."""
    n_best = np.ceil(_BEST_PART * np.isfinite(lengths).sum(axis=1)).astype(int)
    ordered = np.sort(lengths, axis=1)
    rms = np.array([np.sqrt((row[:n] ** 2).mean()) for row, n in zip(ordered, n_best, strict=True)])
    logs = np.log(np.maximum(rms, _EXACT_PX))
    above = logs - np.median(logs)
    scatter = np.median(np.abs(above)) / _MAD_PER_SIGMA
    return tuple(np.flatnonzero(above > max(VIEW_LIMIT * scatter, np.log(VIEW_FACTOR))).tolist())
