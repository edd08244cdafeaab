# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""The edges of shadows, which the map of the lamp knows at the nodes alone.

Interpolated between nodes they would lie up to half a cell beside their place.
"""

import numpy as np

from tronlab.render.lanes.rows import (
    IS_LIT,
    LAMP_X,
    LAMP_Y,
    LAMP_Z,
    LIGHT_SHARE,
    LIGHT_X,
    LIGHT_Y,
    LIGHT_Z,
    SHARE_00,
    SHARE_01,
    SHARE_10,
    SHARE_11,
    C,
    R,
)
from tronlab.render.lighting import visible_share
from tronlab.render.surface import height_at
from tronlab.terrain.kernels import kernel

_ALL_SEE_IT = 4 * 255


@kernel
def settle_edges(grid, light, frame, n, floats, ints):
    """Ask a ray to a lamp that is a point where the nodes around do not agree that it is seen.

    Args:
        grid: The surface.
        light: A ``Light``.
        frame: Where the lanes count from.
        n: The number of lanes.
        floats: Rows of floats; LIGHT of the lanes is mended.
        ints: Rows of integers; the nodes' shares are read and IS_LIT is mended.
    """
    for k in range(n):
        share = floats[LIGHT_SHARE + k]
        if not share > np.float32(0):
            continue
        seen = ints[SHARE_00 + k] + ints[SHARE_01 + k] + ints[SHARE_10 + k] + ints[SHARE_11 + k]
        if seen == _ALL_SEE_IT:
            continue
        r, c = float(floats[R + k]) + frame.row, float(floats[C + k]) + frame.column
        to_lamp = float(floats[LAMP_X + k]), float(floats[LAMP_Y + k]), float(floats[LAMP_Z + k])
        # 32 bits hold the height to a micrometre: not enough for a ray that starts there.
        true_share = np.float32(visible_share(grid, light, r, c, height_at(grid, r, c), to_lamp))
        change = true_share / share
        floats[LIGHT_X + k] *= change
        floats[LIGHT_Y + k] *= change
        floats[LIGHT_Z + k] *= change
        floats[LIGHT_SHARE + k] = true_share
        ints[IS_LIT + k] = np.int32(true_share > np.float32(0))
