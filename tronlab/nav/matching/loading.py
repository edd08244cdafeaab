"""Kernels are compiled, or loaded from disk, before they are needed in a hurry."""

from functools import cache

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.nav.database import Database
from tronlab.nav.features import Features
from tronlab.nav.matching.guided import guided_matches
from tronlab.nav.matching.matcher import open_matcher
from tronlab.nav.settings import MatchingSettings
from tronlab.nav.stages import NOTHING_KEPT

_N_BYTES = 64


def load_kernels(settings: MatchingSettings) -> None:
    """Compile what matching by these settings needs; some seconds at its first use ever."""
    _load("hashing" if settings.method == "hashing" else "exact", guided=settings.guided)


@cache
def _load(method: str, *, guided: bool) -> None:
    """Match one feature to one landmark, which is where it should be."""
    bits = np.zeros((1, _N_BYTES), np.uint8)
    database = Database(np.array([[0.0, 0.0, 1.0]]), np.ones(1), bits, np.zeros(1, np.int64))
    features = Features(np.zeros((1, 2)), np.ones(1), bits)
    settings = MatchingSettings.model_validate({"method": method})
    open_matcher(settings, database, NOTHING_KEPT).match(features)
    if guided:
        camera = CameraModel(1, 1, 1.0, 1.0, 0.0, 0.0)
        guided_matches(database, features, camera, RigidTransform.identity())
