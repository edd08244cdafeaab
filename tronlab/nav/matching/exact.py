"""Exact search: every feature is compared with every landmark."""

import numpy as np
from numpy.typing import NDArray

from tronlab.nav.database import Database
from tronlab.nav.features import Features
from tronlab.nav.matching.exact_kernel import search_all
from tronlab.nav.matching.matches import Matches, Nearest
from tronlab.nav.matching.words import check_fit, places_of, words_of

_AT_ONCE = 16
"""Features searched at a time: each needs two bytes a landmark."""


class ExactMatcher:
    """Finds the nearest of all landmarks."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def match(self, features: Features) -> Matches:
        """Find the nearest landmark of every feature."""
        nearest = Nearest.nothing(len(features))
        search_exactly(self._database, features, np.arange(len(features)), nearest)
        return nearest.matches()


def search_exactly(
    database: Database, features: Features, chosen: NDArray[np.intp], nearest: Nearest
) -> None:
    """Fill in what the chosen features find among all landmarks.

    Raises:
        ScoreError: Features and landmarks have descriptors of different lengths.
    """
    check_fit(database, features)
    if not len(chosen) or not len(database):
        return
    search_all(
        words_of(database.descriptors),
        places_of(database),
        words_of(features.descriptors),
        chosen,
        np.empty((min(_AT_ONCE, len(chosen)), len(database)), np.uint16),
        nearest,
    )
