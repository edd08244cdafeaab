"""Which bits of the descriptors become keys of the hash tables."""

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray

N_SAMPLES = 20_000
"""Landmarks that the choice is made from."""
_MIN_SHARE = 0.05
"""A bit that is as rarely 0, or 1, says too little."""


def choose_bits(
    descriptors: NDArray[np.uint8], *, n_tables: int, n_bits: int, seed: int
) -> NDArray[np.int64]:
    """Choose bits that are 0 as often as 1 and depend little on each other.

    Each table begins with another bit; the next is the one of the greatest variance that depends
    least on those chosen, and bits of earlier tables come last. Random ones leave buckets of very
    unequal size: the bits of a descriptor are correlated.

    Args:
        descriptors: Of the landmarks, shape (n, b), at least one.
        n_tables: Number of tables.
        n_bits: Bits of a table; fewer if the descriptors have not that many that vary.
        seed: Of the first bits.

    Returns:
        Numbers of bits, counted from the lowest of the first byte, shape (n_tables, bits).
    """
    sample = descriptors[:: -(-len(descriptors) // N_SAMPLES)]
    bits = np.unpackbits(sample, axis=1, bitorder="little").astype(np.float32)
    share = bits.mean(axis=0)
    varying = np.flatnonzero(np.minimum(share, 1 - share) >= _MIN_SHARE)
    if not len(varying):
        return np.zeros((n_tables, 1), np.int64)
    correlation = np.abs(np.corrcoef(bits[:, varying], rowvar=False)).reshape(len(varying), -1)
    variance = share[varying] * (1 - share[varying])
    rng = np.random.default_rng(seed)
    used = np.zeros(len(varying), np.intp)
    tables = [
        _bits_of_table(rng, correlation, variance / (1.0 + used), used, n_bits=n_bits)
        for _ in range(n_tables)
    ]
    return varying[np.stack(tables)]


def _bits_of_table(
    rng: np.random.Generator,
    correlation: FloatArray,
    worth: FloatArray,
    used: NDArray[np.intp],
    *,
    n_bits: int,
) -> NDArray[np.intp]:
    chosen = [int(rng.choice(len(worth), p=worth / worth.sum()))]
    explained = correlation[chosen[0]]
    while len(chosen) < min(n_bits, len(worth)):
        left = worth * (1.0 - explained)
        left[chosen] = -1.0
        chosen.append(int(left.argmax()))
        explained = np.maximum(explained, correlation[chosen[-1]])
    used[chosen] += 1
    return np.array(chosen)
