"""Landmarks and features as kernels see them, where they lie: a mapped database is not copied.

All arrays are read-only here, so that each kernel is compiled but once.
"""

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from tronlab.errors import ScoreError
from tronlab.nav.database import Database
from tronlab.nav.features import Features

Scalar = TypeVar("Scalar", bound=np.generic)
BYTES_A_WORD = 8


class Words(NamedTuple):
    """Descriptors of ``b`` bytes, which kernels read eight bytes at a time."""

    rows: NDArray[np.uint8]
    """Shape (n, b), row by row."""
    address: int
    """Where they begin in memory."""
    overlap_bits: np.uint64
    """The last eight bytes of a row overlap the words before them by so many bits."""


class Places(NamedTuple):
    """Where landmarks are on the terrain."""

    p_trs_m: NDArray[np.float64]
    """Shape (n, 3)."""
    size_m: NDArray[np.float64]
    """Shape (n,)."""
    seen_from: NDArray[np.int64]
    """Index of the view each came from, shape (n,)."""


def read_only(array: NDArray[Scalar]) -> NDArray[Scalar]:
    """View an array, possibly mapped from a file, as one that cannot be written to."""
    view = np.ascontiguousarray(array).view(np.ndarray)[...]
    view.flags.writeable = False
    return view


def places_of(database: Database) -> Places:
    """View the places of the landmarks of a database."""
    return Places(read_only(database.p_trs_m), read_only(database.size_m), read_only(database.view))


def words_of(descriptors: NDArray[np.uint8]) -> Words:
    """View descriptors, shape (n, b), as words; they are copied only if not stored row by row."""
    n_missing = max(BYTES_A_WORD - descriptors.shape[1], 0)
    rows = np.pad(descriptors, ((0, 0), (0, n_missing))) if n_missing else descriptors
    rows = read_only(rows)
    overlap_bytes = -rows.shape[1] % BYTES_A_WORD
    return Words(rows, rows.ctypes.data, np.uint64(8 * overlap_bytes))


def check_fit(database: Database, features: Features) -> None:
    """Check that features and landmarks have descriptors of one kind; no features fit any.

    Raises:
        ScoreError: They are of different lengths.
    """
    n_bytes, n_expected = features.descriptors.shape[1], database.descriptors.shape[1]
    if len(features) and n_bytes != n_expected:
        raise ScoreError(
            f"features: descriptors of {n_bytes} bytes, those of the database have {n_expected};"
            " both must come from the same detector"
        )
