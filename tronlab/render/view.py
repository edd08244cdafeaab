# pyright: basic
"""A camera as the kernels see it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.kernels import inlined


class View(NamedTuple):
    """A camera in grid coordinates: two in cells, the third in metres."""

    origin_trs_m: NDArray[np.float64]
    """Where the grid's origin lies."""
    eye: NDArray[np.float64]
    grid_from_cam: NDArray[np.float64]
    """Rotation, shape (3, 3), its first two rows in cells a metre."""
    vignetting_power: float


@inlined
def direction_of(view, ray):
    """Give the direction of the ray (x, y, 1) in cam in grid coordinates."""
    m = view.grid_from_cam
    return (
        m[0, 0] * ray[0] + m[0, 1] * ray[1] + m[0, 2],
        m[1, 0] * ray[0] + m[1, 1] * ray[1] + m[1, 2],
        m[2, 0] * ray[0] + m[2, 1] * ray[1] + m[2, 2],
    )
