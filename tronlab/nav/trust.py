"""Which matches a first pose may rest on: that no geometry has confirmed yet."""

import cv2
import numpy as np
from numpy.typing import NDArray

from tronlab.nav.database import Database
from tronlab.nav.features import Features, turns_of_cells
from tronlab.nav.matching import Matches
from tronlab.nav.settings import MatchingSettings


def trusted_matches(
    matches: Matches, features: Features, database: Database, settings: MatchingSettings
) -> Matches:
    """Choose by descriptor, by size and by place in the image, as the settings say.

    Args:
        matches: The least ambiguous first.
        features: Of the image, all of them: they are rivals in the mutual check.
        database: The landmarks.
        settings: What counts.

    Returns:
        The chosen, the best first.
    """
    is_good = matches.ratio <= settings.max_ratio
    if settings.max_size_px is not None:
        is_good &= features.size_px[matches.feature] <= settings.max_size_px
    chosen = matches.take(np.flatnonzero(is_good))
    if settings.mutual and len(chosen):
        chosen = chosen.take(np.flatnonzero(_are_mutual(chosen, features, database)))
    if settings.best_by == "distance":
        chosen = chosen.take(np.argsort(chosen.distance, kind="stable"))
    if settings.max_per_cell is not None:
        rank = np.arange(len(chosen), dtype=np.float64)
        turn = turns_of_cells(features.uv[chosen.feature], -rank, side=settings.cell_px)
        chosen = chosen.take(np.flatnonzero(turn < settings.max_per_cell))
    return chosen if settings.n_max is None else chosen.first(settings.n_max)


def _are_mutual(matches: Matches, features: Features, database: Database) -> NDArray[np.bool_]:
    """Tell which landmarks have no feature more like them than their own, shape (n,)."""
    landmarks = np.ascontiguousarray(database.descriptors[matches.landmark])
    nearest = cv2.BFMatcher(cv2.NORM_HAMMING).match(landmarks, features.descriptors)
    least = np.full(len(matches), np.inf)
    for found in nearest:
        least[found.queryIdx] = found.distance
    return matches.distance <= least
