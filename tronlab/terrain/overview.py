"""A height map of any size made small enough to draw."""

from collections.abc import Callable

import numpy as np

from tronlab.geometry.poses import FloatArray
from tronlab.terrain.formats.model import Heights

_SAMPLES_AT_ONCE = 8_000_000


def overview(
    height_m: Heights,
    *,
    most_samples: int,
    on_progress: Callable[[int, int], None] | None = None,
) -> tuple[FloatArray, int]:
    """Average blocks of samples, band by band.

    Args:
        height_m: Heights, shape (rows, columns); a sample that is not finite is a hole.
        most_samples: How many samples the result may have.
        on_progress: Is told how many rows of the result are done, and of how many.

    Returns:
        Heights, shape (rows // n, columns // n), NaN where a block has nothing but holes; and n,
        the samples along one side of a block. What is left at the ends, less than a block, is not
        shown.
    """
    rows, columns = height_m.shape
    n = max(1, int(np.ceil(np.sqrt(rows * columns / most_samples))))
    n = min(n, rows, columns)
    shown = np.empty((rows // n, columns // n))
    band = max(1, _SAMPLES_AT_ONCE // (n * columns))
    for first in range(0, len(shown), band):
        last = min(first + band, len(shown))
        part = height_m[first * n : last * n, : shown.shape[1] * n]
        shown[first:last] = _block_means(np.asarray(part, dtype=np.float64), n)
        if on_progress is not None:
            on_progress(last, len(shown))
    return shown, n


def _block_means(band: FloatArray, n: int) -> FloatArray:
    blocks = band.reshape(band.shape[0] // n, n, band.shape[1] // n, n)
    is_known = np.isfinite(blocks)
    if is_known.all():
        return blocks.mean(axis=(1, 3))
    n_known = is_known.sum(axis=(1, 3))
    total = np.where(is_known, blocks, 0.0).sum(axis=(1, 3))
    return np.where(n_known > 0, total / np.maximum(n_known, 1), np.nan)
