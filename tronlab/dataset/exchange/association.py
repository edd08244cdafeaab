"""Which measurements were taken at the same time: nearest time stamps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tronlab.errors import DatasetError
from tronlab.geometry.poses import FloatArray


@dataclass(frozen=True, slots=True)
class Association:
    """Pairs of rows of two series, in the order of the first one."""

    i_a: NDArray[np.int64]
    """Rows of series a, shape (n,)."""
    i_b: NDArray[np.int64]
    """Row of series b that is nearest in time to each, shape (n,)."""
    difference_s: FloatArray
    """Time of b, offset added, minus time of a, shape (n,)."""


def associate(
    times_a_s: ArrayLike, times_b_s: ArrayLike, *, max_difference_s: float, offset_b_s: float = 0.0
) -> Association:
    """Pair each time of series a with the nearest one of series b.

    Of two that are equally near the earlier one counts. A time without one near enough is left
    out. Nothing is interpolated.

    Args:
        times_a_s: Shape (n,), in any order.
        times_b_s: Shape (m,), in any order.
        max_difference_s: How far apart two of a pair may be.
        offset_b_s: Added to the times of b: its clock was behind by so much.

    Raises:
        DatasetError: A time is not finite, or the limit is not a number from 0.
    """
    a = np.asarray(times_a_s, dtype=np.float64)
    b = np.asarray(times_b_s, dtype=np.float64) + offset_b_s
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise DatasetError("association by time: there are times that are not finite")
    if not max_difference_s >= 0:
        raise DatasetError(
            f"association by time: the largest difference is {max_difference_s} s, must be from 0"
        )
    if not b.size:
        none = np.zeros(0, dtype=np.int64)
        return Association(none, none, np.zeros(0))
    order = np.argsort(b, kind="stable")
    after = np.searchsorted(b[order], a, side="right").clip(max=b.size - 1)
    before = (after - 1).clip(min=0)
    is_later_nearer = np.abs(b[order][after] - a) < np.abs(a - b[order][before])
    nearest = order[np.where(is_later_nearer, after, before)]
    difference_s = b[nearest] - a
    near = np.flatnonzero(np.abs(difference_s) <= max_difference_s)
    return Association(near, nearest[near], difference_s[near])
