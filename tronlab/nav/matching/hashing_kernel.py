# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""Compiled: hash tables over the descriptors of a database, and looking features up in them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.nav.matching.hamming_kernel import are_apart, n_different
from tronlab.terrain.kernels import inlined, kernel

SETTLED = 0.7
"""A feature is settled when its nearest landmark differs by this part of what its rival does."""
TABLES_A_STAGE = 8
MAX_BUCKET = 512
"""Most landmarks taken from a bucket; of a fuller one every second, third, ..."""


class Tables(NamedTuple):
    """Hash tables: landmarks sorted by their keys."""

    bits: NDArray[np.int64]
    """Numbers of the bits that make up the keys, shape (tables, bits)."""
    starts: NDArray[np.int32]
    """Where each bucket begins, shape (tables, buckets + 1)."""
    landmarks: NDArray[np.int32]
    """Bucket by bucket, shape (tables, n)."""


class Scratch(NamedTuple):
    """What one feature's look-up needs for a while."""

    candidates: NDArray[np.int32]
    differences: NDArray[np.uint16]
    keys: NDArray[np.int64]
    """Of the feature, shape (tables,)."""


@kernel
def fill_table(bits, descriptors, keys, starts, landmarks):
    """Sort landmarks into the buckets of one table.

    Args:
        bits: Of this table.
        descriptors: Shape (n, b).
        keys: Overwritten, shape (n,).
        starts: Zeros; filled.
        landmarks: Filled.
    """
    for i in range(len(keys)):
        keys[i] = _key(bits, descriptors, i)
        starts[keys[i] + 1] += 1
    for key in range(1, len(starts)):
        starts[key] += starts[key - 1]
    # Filled from behind, each bucket's beginning runs down to where it belongs.
    for i in range(len(keys) - 1, -1, -1):
        starts[keys[i] + 1] -= 1
        landmarks[starts[keys[i] + 1]] = i
    for key in range(len(starts) - 1):
        starts[key] = starts[key + 1]
    starts[-1] = len(keys)


@kernel
def look_up(tables, landmarks, places, features, scratch, found):
    """Find the nearest landmark of each feature among those that share a key with it.

    Tables are looked up in stages, and then with one bit flipped, until the feature is settled.

    Args:
        tables: ``Tables``.
        landmarks: ``Words``.
        places: Their ``Places``.
        features: ``Words``.
        scratch: ``Scratch``.
        found: ``Nearest``, filled in.
    """
    n_tables = len(tables.bits)
    for j in range(len(features.rows)):
        n = 0
        for n_flips in range(2):
            for first in range(0, n_tables, TABLES_A_STAGE):
                if _is_settled(found, j):
                    continue
                n_before = n
                for t in range(first, min(first + TABLES_A_STAGE, n_tables)):
                    n = _collect_table(tables, t, features.rows, j, n_flips, scratch, n)
                for c in range(n_before, n):
                    i = scratch.candidates[c]
                    scratch.differences[c] = n_different(landmarks, i, features, j)
                _judge(scratch, n, places, j, found)


@inlined
def _is_settled(found, j):
    return found.rival[j] < np.inf and found.distance[j] <= SETTLED * found.rival[j]


@inlined
def _key(bits, descriptors, i):
    key = 0
    for k in range(len(bits)):
        key |= ((descriptors[i, bits[k] >> 3] >> (bits[k] & 7)) & 1) << k
    return key


@inlined
def _collect_table(tables, t, descriptors, j, n_flips, scratch, n):
    """Append what shares its key with feature j in a table; give how many candidates there are."""
    if n_flips == 0:
        scratch.keys[t] = _key(tables.bits[t], descriptors, j)
        return _collect(tables, t, scratch.keys[t], scratch, n)
    for bit in range(tables.bits.shape[1]):
        n = _collect(tables, t, scratch.keys[t] ^ (1 << bit), scratch, n)
    return n


@inlined
def _collect(tables, t, key, scratch, n):
    begin, end = tables.starts[t, key], tables.starts[t, key + 1]
    step = 1 + (end - begin) // MAX_BUCKET
    for at in range(begin, end, step):
        scratch.candidates[n] = tables.landmarks[t, at]
        n += 1
    return n


@inlined
def _judge(scratch, n, places, j, found):
    """Say which candidate is nearest to feature j, the first of several, and which is its rival."""
    nearest, least = -1, np.inf
    for c in range(n):
        i, d = scratch.candidates[c], float(scratch.differences[c])
        if d < least or (d == least and i < nearest):
            nearest, least = i, d
    rival = np.inf
    for c in range(n):
        d = float(scratch.differences[c])
        if d < rival and are_apart(places, nearest, scratch.candidates[c]):
            rival = d
    found.landmark[j], found.distance[j], found.rival[j] = nearest, least, rival
