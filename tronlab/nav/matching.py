"""Matching the features of an image to the landmarks of the database, by descriptor."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.nav.database import Database
from tronlab.nav.features import Features

N_NEIGHBOURS = 6
"""Nearest landmarks asked for; several are usually the same point in other reference views."""
SAME_POINT_SIZES = 0.5
"""Two landmarks nearer to each other than this many of their sizes are one physical point."""

_FLANN_LSH = 6
_FLANN_TABLES = 8
_FLANN_KEY_BITS = 18
_FLANN_PROBES = 1
_FLANN_SEED = 20_160_417


@dataclass(frozen=True, slots=True)
class Matches:
    """Features with their nearest landmark, the most similar first; each landmark at most once."""

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

    def take(self, chosen: NDArray[np.intp]) -> "Matches":
        """Give the chosen matches, in that order."""
        return Matches(
            self.feature[chosen], self.landmark[chosen], self.distance[chosen], self.ratio[chosen]
        )


class LandmarkIndex:
    """A FLANN index (locality-sensitive hashing) over the descriptors of a database.

    The hash functions come from a fixed seed: the same database and image give the same matches.
    """

    def __init__(self, database: Database) -> None:
        self._database = database
        cv2.setRNGSeed(_FLANN_SEED)
        self._flann = cv2.FlannBasedMatcher(
            {
                "algorithm": _FLANN_LSH,
                "table_number": _FLANN_TABLES,
                "key_size": _FLANN_KEY_BITS,
                "multi_probe_level": _FLANN_PROBES,
            },
            {},
        )
        self._flann.add([database.descriptors])
        self._flann.train()

    def match(self, features: Features) -> Matches:
        """Find the nearest landmark of every feature."""
        if not len(features):
            return Matches(
                np.empty(0, np.intp), np.empty(0, np.intp), np.empty(0), np.empty(0)
            )
        landmark, distance = self._neighbours(features)
        feature = np.flatnonzero(landmark[:, 0] >= 0)
        landmark, distance = landmark[feature], distance[feature]
        ratio = distance[:, 0] / np.maximum(self._rival_distance(landmark, distance), 1.0)
        matches = Matches(feature, landmark[:, 0], distance[:, 0], ratio)
        return _once_per_landmark(matches)

    def _neighbours(self, features: Features) -> tuple[NDArray[np.intp], FloatArray]:
        landmark = np.full((len(features), N_NEIGHBOURS), -1, np.intp)
        distance = np.full((len(features), N_NEIGHBOURS), np.inf)
        for row in self._flann.knnMatch(features.descriptors, N_NEIGHBOURS):
            for k, neighbour in enumerate(row):
                landmark[neighbour.queryIdx, k] = neighbour.trainIdx
                distance[neighbour.queryIdx, k] = neighbour.distance
        return landmark, distance

    def _rival_distance(self, landmark: NDArray[np.intp], distance: FloatArray) -> FloatArray:
        """Give the distance to the nearest landmark that is another physical point.

        Where none was found, that of unrelated descriptors: half of their bits differ.
        """
        places, sizes = self._database.p_trs_m, self._database.size_m
        apart = np.linalg.norm(places[landmark] - places[landmark[:, :1]], axis=2)
        is_elsewhere = apart > SAME_POINT_SIZES * sizes[landmark[:, :1]]
        unrelated = 4.0 * self._database.descriptors.shape[1]
        return np.where(is_elsewhere & (landmark >= 0), distance, unrelated).min(axis=1)


def _once_per_landmark(matches: Matches) -> Matches:
    """Keep the most similar feature of each landmark, and sort by similarity."""
    order = np.lexsort((matches.feature, matches.ratio, matches.distance))
    _, first = np.unique(matches.landmark[order], return_index=True)
    return matches.take(order[np.sort(first)])
