"""Locality-sensitive hashing by OpenCV's FLANN, as in the paper."""

import cv2
import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.nav.database import Database
from tronlab.nav.features import Features
from tronlab.nav.matching.exact import search_exactly
from tronlab.nav.matching.matches import SAME_POINT_SIZES, Matches, Nearest
from tronlab.nav.matching.words import check_fit

N_NEIGHBOURS = 6
"""Nearest landmarks asked for; several are usually the same point in other reference views."""
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


class FlannMatcher:
    """A FLANN index over the descriptors of a database.

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
        """Find the nearest landmark of every feature; the promising ones again, exactly."""
        check_fit(self._database, features)
        if not len(features):
            return Nearest.nothing(0).matches()
        nearest = self._approximately(features)
        ratio = nearest.ratio()
        promising = np.argsort(ratio, kind="stable")[:N_PROMISING]
        promising = np.sort(promising[ratio[promising] <= PROMISING_RATIO])
        search_exactly(self._database, features, promising, nearest)
        return nearest.matches()

    def _approximately(self, features: Features) -> Nearest:
        landmark, distance = self._neighbours(features.descriptors)
        places, sizes = self._database.p_trs_m, self._database.size_m
        apart = np.linalg.norm(places[landmark] - places[landmark[:, :1]], axis=2)
        is_rival = (apart > SAME_POINT_SIZES * sizes[landmark[:, :1]]) & (landmark >= 0)
        rival = np.where(is_rival, distance, np.inf).min(axis=1)
        return Nearest(np.ascontiguousarray(landmark[:, 0]), distance[:, 0].copy(), rival)

    def _neighbours(self, descriptors: NDArray[np.uint8]) -> tuple[NDArray[np.intp], FloatArray]:
        """Give index (-1: none) and distance of the nearest landmarks, each (n, N_NEIGHBOURS)."""
        landmark = np.full((len(descriptors), N_NEIGHBOURS), -1, np.intp)
        distance = np.full((len(descriptors), N_NEIGHBOURS), np.inf)
        for row in self._flann.knnMatch(descriptors, N_NEIGHBOURS):
            for k, neighbour in enumerate(row):
                landmark[neighbour.queryIdx, k] = neighbour.trainIdx
                distance[neighbour.queryIdx, k] = neighbour.distance
        return landmark, distance
