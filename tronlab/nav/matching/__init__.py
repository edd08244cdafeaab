"""Matching the features of an image to the landmarks of the database, by descriptor."""

from tronlab.nav.matching.guided import guided_matches
from tronlab.nav.matching.loading import load_kernels
from tronlab.nav.matching.matcher import Matcher, open_matcher
from tronlab.nav.matching.matches import Matches

__all__ = ["Matcher", "Matches", "guided_matches", "load_kernels", "open_matcher"]
