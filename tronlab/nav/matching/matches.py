"""Which landmark each feature was matched to, and how sure that is."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray

SAME_POINT_SIZES = 1.0
"""Two landmarks nearer to each other than this many of their sizes are one physical point."""


@dataclass(frozen=True, slots=True)
class Matches:
    """Features with their nearest landmark, least ambiguous first; each landmark at most once."""

    feature: NDArray[np.intp]
    """Index of the feature, shape (n,)."""
    landmark: NDArray[np.intp]
    """Index of the landmark, shape (n,)."""
    distance: FloatArray
    """Number of bits that differ, shape (n,)."""
    ratio: FloatArray
    """``distance`` over the distance to the nearest landmark elsewhere on the terrain, shape (n,);
    near 1 the match is ambiguous, near 0 it stands alone."""

    def __len__(self) -> int:
        return len(self.feature)

    def first(self, n_max: int) -> "Matches":
        """Give the best, at most ``n_max``."""
        return self.take(np.arange(min(n_max, len(self))))

    def take(self, chosen: NDArray[np.intp]) -> "Matches":
        """Give the chosen matches, in that order."""
        return Matches(
            self.feature[chosen], self.landmark[chosen], self.distance[chosen], self.ratio[chosen]
        )


class Nearest(NamedTuple):
    """What a search finds for every feature; kernels fill it in."""

    landmark: NDArray[np.intp]
    """Index of the nearest landmark, shape (n,); -1: none."""
    distance: FloatArray
    """Number of bits that differ, shape (n,)."""
    rival: FloatArray
    """Distance of the nearest landmark elsewhere on the terrain, shape (n,); infinite: none."""

    @classmethod
    def nothing(cls, n: int) -> "Nearest":
        """Give the result of a search that has not begun, for ``n`` features."""
        return cls(np.full(n, -1, np.intp), np.full(n, np.inf), np.full(n, np.inf))

    def ratio(self, *, stand_in: float | None = None) -> FloatArray:
        """Give each distance over that of the rival, shape (n,).

        Args:
            stand_in: Distance of the rival where none was found; without it that of a typical
                feature.
        """
        is_found = np.isfinite(self.rival)
        if stand_in is None:
            stand_in = float(np.median(self.rival[is_found])) if is_found.any() else 1.0
        return self.distance / np.maximum(np.where(is_found, self.rival, stand_in), 1.0)

    def matches(self, *, stand_in: float | None = None) -> Matches:
        """Give the matches, the least ambiguous first, each landmark with its best feature alone.

        Args:
            stand_in: As in ``ratio``.
        """
        feature = np.flatnonzero(self.landmark >= 0)
        landmark, distance = self.landmark[feature], self.distance[feature]
        ratio = self.ratio(stand_in=stand_in)[feature]
        order = np.lexsort((feature, distance, ratio))
        _, first = np.unique(landmark[order], return_index=True)
        return Matches(feature, landmark, distance, ratio).take(order[np.sort(first)])
