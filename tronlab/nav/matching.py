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
SAME_POINT_SIZES = 1.0
"""Two landmarks nearer to each other than this many of their sizes are one physical point."""
PROMISING_RATIO = 0.65
N_PROMISING = 1500
"""The most promising matches of the approximate search, at most so many and with a ratio up to
this, are searched again exactly: a rival that hashing missed would pass a wrong match for a good
one, and one of those in a thousand spoils a pose without outlier rejection."""

_FLANN_LSH = 6
_FLANN_TABLES = 8
_FLANN_KEY_BITS = 18
_FLANN_PROBES = 1
_FLANN_SEED = 20_160_417
_EXACT_CHUNK = 1 << 17
"""OpenCV's exact search takes fewer than 2^18 descriptors in one piece."""


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
        self._exact = cv2.BFMatcher(cv2.NORM_HAMMING)
        starts = range(_EXACT_CHUNK, len(database), _EXACT_CHUNK)
        self._exact.add(np.split(database.descriptors, starts))

    def match(self, features: Features) -> Matches:
        """Find the nearest landmark of every feature."""
        if not len(features):
            nothing = np.empty(0, np.intp)
            return Matches(nothing, nothing, np.empty(0), np.empty(0))
        landmark, distance = _neighbours(self._flann, features.descriptors)
        ratio = self._ratio(landmark, distance)
        promising = np.argsort(ratio, kind="stable")[:N_PROMISING]
        promising = promising[ratio[promising] <= PROMISING_RATIO]
        if len(promising):
            searched = _neighbours(self._exact, features.descriptors[promising])
            landmark[promising], distance[promising] = searched
            ratio = self._ratio(landmark, distance)
        feature = np.flatnonzero(landmark[:, 0] >= 0)
        return _once_per_landmark(
            Matches(feature, landmark[feature, 0], distance[feature, 0], ratio[feature])
        )

    def _ratio(self, landmark: NDArray[np.intp], distance: FloatArray) -> FloatArray:
        """Give the nearest landmark's distance over that of the nearest other physical point.

        Where no other point was found, that of a typical feature stands for it.
        """
        places, sizes = self._database.p_trs_m, self._database.size_m
        apart = np.linalg.norm(places[landmark] - places[landmark[:, :1]], axis=2)
        is_rival = (apart > SAME_POINT_SIZES * sizes[landmark[:, :1]]) & (landmark >= 0)
        rival = np.where(is_rival, distance, np.inf).min(axis=1)
        found = np.isfinite(rival)
        typical = float(np.median(rival[found])) if found.any() else 1.0
        return distance[:, 0] / np.maximum(np.where(found, rival, typical), 1.0)


def _neighbours(
    matcher: cv2.DescriptorMatcher, descriptors: NDArray[np.uint8]
) -> tuple[NDArray[np.intp], FloatArray]:
    """Give index (-1: none) and distance of the nearest landmarks, each (n, N_NEIGHBOURS)."""
    landmark = np.full((len(descriptors), N_NEIGHBOURS), -1, np.intp)
    distance = np.full((len(descriptors), N_NEIGHBOURS), np.inf)
    for row in matcher.knnMatch(descriptors, N_NEIGHBOURS):
        for k, neighbour in enumerate(row):
            index = neighbour.imgIdx * _EXACT_CHUNK + neighbour.trainIdx
            landmark[neighbour.queryIdx, k] = index
            distance[neighbour.queryIdx, k] = neighbour.distance
    return landmark, distance


def _once_per_landmark(matches: Matches) -> Matches:
    """Keep the best feature of each landmark, and sort: the least ambiguous first."""
    order = np.lexsort((matches.feature, matches.distance, matches.ratio))
    _, first = np.unique(matches.landmark[order], return_index=True)
    return matches.take(order[np.sort(first)])
