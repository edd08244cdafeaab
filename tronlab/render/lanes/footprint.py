# pyright: basic
"""What of the terrain a pixel covers, for lookups that are to take its mean light."""

from typing import NamedTuple

import numpy as np

from tronlab.terrain.kernels import inlined

_MOST_PROBES = 4
_LEAST_FALL = 0.05
"""Rays flatter than this are taken to be as flat as this."""


class Footprint(NamedTuple):
    """A pixel's ground at depth 1, in cells: an ellipse's axes, or rather a parallelogram's."""

    width: float
    """Its short axis, over which one lookup takes the mean."""
    long_r: float
    """Its long axis, along which the lookups lie."""
    long_c: float
    n_probes: int


@inlined
def footprint_of(view, direction, pitch):
    """Give what a pixel sees of level ground.

    Args:
        view: The camera.
        direction: Direction of its ray in grid coordinates, of depth 1.
        pitch: Difference between rays of neighbouring pixels, along x and y.
    """
    m = view.grid_from_cam
    fall = min(direction[2], -_LEAST_FALL)
    per_x, per_y = m[2, 0] / fall, m[2, 1] / fall
    # How the point that a ray meets on level ground moves with the pixel.
    r_x = (m[0, 0] - direction[0] * per_x) * pitch[0]
    c_x = (m[1, 0] - direction[1] * per_x) * pitch[0]
    r_y = (m[0, 1] - direction[0] * per_y) * pitch[1]
    c_y = (m[1, 1] - direction[1] * per_y) * pitch[1]
    # Its singular values by the eigenvalues of J J^T.
    rr, cc, rc = r_x * r_x + r_y * r_y, c_x * c_x + c_y * c_y, r_x * c_x + r_y * c_y
    middle, spread = 0.5 * (rr + cc), np.sqrt(0.25 * (rr - cc) ** 2 + rc * rc)
    long, short = np.sqrt(middle + spread), np.sqrt(max(middle - spread, 0.0))
    angle = 0.5 * np.arctan2(2.0 * rc, rr - cc)
    n_probes = min(max(int(np.ceil(long / max(short, 1e-12) - 0.5)), 1), _MOST_PROBES)
    width = max(short, long / n_probes)
    reach = max(long - width, 0.0)
    return Footprint(width, reach * np.cos(angle), reach * np.sin(angle), n_probes)
