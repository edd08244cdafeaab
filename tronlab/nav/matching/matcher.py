"""The ways of matching, by name."""

from typing import Protocol

from tronlab.nav.database import Database
from tronlab.nav.features import Features
from tronlab.nav.matching.matches import Matches
from tronlab.nav.settings import MatchingSettings
from tronlab.nav.stages import StageStore


class Matcher(Protocol):
    """Matches the features of images to the landmarks of one database."""

    def match(self, features: Features) -> Matches:
        """Find the nearest landmark of every feature.

        Raises:
            ScoreError: Features and landmarks have descriptors of different lengths.
        """
        ...


def open_matcher(settings: MatchingSettings, database: Database, stages: StageStore) -> Matcher:
    """Make the matcher that the settings name.

    Args:
        settings: Say which.
        database: What to match to; its arrays are not copied.
        stages: Where an index is kept from one process to the next.
    """
    # The kernels' compiler takes half a second to import: not for whoever names matches.
    match settings.method:
        case "exact":
            from tronlab.nav.matching.exact import ExactMatcher

            return ExactMatcher(database)
        case "flann":
            from tronlab.nav.matching.flann import FlannMatcher

            return FlannMatcher(database)
        case "hashing":
            from tronlab.nav.matching.hashing import HashingMatcher

            return HashingMatcher(database, stages)
