"""Where the lanes of a tile keep what: rows in two flat arrays, of floats and of integers.

All rows are ``LANES`` long: constant distances between them spare LLVM the question whether they
overlap. Rows that the rays need on their way are taken by others when all have met the surface.
"""

from tronlab.render.lanes.tiles import LANES


def _rows(first: int, n: int) -> tuple[int, ...]:
    return tuple(range(first * LANES, (first + n) * LANES, LANES))


# Floats, of a ray on its way; row 0 to 6 stay.
START_R, START_C, START_Z = _rows(0, 3)
TOWARDS_R, TOWARDS_C, TOWARDS_Z = _rows(3, 3)
(DEPTH,) = _rows(6, 1)
"""Ray parameter from the tile's start depth."""
(END,) = _rows(7, 1)
"""Its largest value."""
INVERSE_R, INVERSE_C, INVERSE_Z = _rows(8, 3)
FAR_SIDE_R, FAR_SIDE_C = _rows(11, 2)
"""1 where the ray leaves squares on the far side of this axis, 0 where on the near one."""
(NUDGE,) = _rows(13, 1)
"""What carries the ray safely into the next cell."""
(SIZE,) = _rows(14, 1)
"""Cells along the square that the ray looks at."""
(HIGHEST,) = _rows(15, 1)
NODE_00, NODE_01, NODE_10, NODE_11 = _rows(16, 4)

# Floats, of a point that a ray has met.
R, C, Z = START_R, START_C, START_Z
"""Place in the tile's frame."""
EYE_X, EYE_Y, EYE_Z = TOWARDS_R, TOWARDS_C, TOWARDS_Z
"""Unit vector to the camera, along x, y and z of trs."""
LAMP_X, LAMP_Y, LAMP_Z, PER_DISTANCE = _rows(7, 4)
"""Unit vector to the lamp, and 1 / its distance."""
LIGHT_X, LIGHT_Y, LIGHT_Z, LIGHT_SHARE = _rows(11, 4)
"""Share of the lamp seen * albedo * normal, and share * albedo, at the point or in the mean."""
COS_OFF_AXIS, RADIANCE = _rows(15, 2)
(MEAN_PART,) = _rows(17, 1)
"""Part of the coarser one of two levels."""
PART_R, PART_C = _rows(18, 2)
"""Place between nodes, or between middles of squares, 0 to 1."""
COS_INCIDENCE, COS_EMISSION, COS_PHASE = _rows(20, 3)
(
    NODE_UP_0,
    NODE_UP_1,
    NODE_0_LEFT,
    NODE_0_0,
    NODE_0_1,
    NODE_0_RIGHT,
    NODE_1_LEFT,
    NODE_1_0,
    NODE_1_1,
    NODE_1_RIGHT,
    NODE_DOWN_0,
    NODE_DOWN_1,
) = _rows(20, 12)
"""Heights of the cell's four nodes and of the eight around them."""
N_FLOAT_ROWS = 32

# Integers, of a ray on its way
STATE, LEVEL, ROW, COLUMN = _rows(0, 4)
# Integers, of a point
IS_LIT = LEVEL
SHARE_00, SHARE_01, SHARE_10, SHARE_11 = _rows(4, 4)
"""How much of the lamp the cell's nodes see, 255 for the whole."""
XY_00, XY_01, XY_10, XY_11, ZW_00, ZW_01, ZW_10, ZW_11 = _rows(4, 8)
"""Mean light on four squares, two values of 16 bits in one."""
N_INT_ROWS = 12
