# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""The compiled kernel of the exact search."""

import numpy as np

from tronlab.nav.matching.hamming_kernel import are_apart, n_different
from tronlab.terrain.kernels import inlined, kernel

_BLOCK = 256
"""So many landmarks stay in the nearest cache while several features are compared with them."""


@kernel
def search_all(landmarks, places, features, chosen, differences, found):
    """Find the nearest landmark of the chosen features, and the nearest elsewhere.

    Args:
        landmarks: ``Words``.
        places: Their ``Places``.
        features: ``Words``.
        chosen: Indices of features.
        differences: For each of some features and all landmarks; overwritten.
        found: ``Nearest``, filled in.
    """
    n_landmarks = len(landmarks.rows)
    n_rows = differences.shape[0]
    for first in range(0, len(chosen), n_rows):
        last = min(first + n_rows, len(chosen))
        for begin in range(0, n_landmarks, _BLOCK):
            end = min(begin + _BLOCK, n_landmarks)
            for at in range(first, last):
                for i in range(begin, end):
                    differences[at - first, i] = n_different(landmarks, i, features, chosen[at])
        for at in range(first, last):
            _judge(differences, at - first, places, chosen[at], found)


@inlined
def _judge(differences, row, places, j, found):
    """Say which landmark is nearest to feature j, the first of several, and which is its rival."""
    nearest = 0
    for i in range(differences.shape[1]):
        if differences[row, i] < differences[row, nearest]:
            nearest = i
    rival = np.inf
    for i in range(differences.shape[1]):
        if differences[row, i] < rival and are_apart(places, nearest, i):
            rival = float(differences[row, i])
    found.landmark[j] = nearest
    found.distance[j] = float(differences[row, nearest])
    found.rival[j] = rival
