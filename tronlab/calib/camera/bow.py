"""The bow of a calibration board: how far its corners lie from the plane they were designed on.

Three terms of second order: sag along x, sag along y, twist; the first two are 0 at the edges of
the field of corners (as in mrcal's ``calobject_warp``, which has no twist).
"""

import numpy as np

from tronlab.devices.laboratory import PatternSpec
from tronlab.geometry.poses import FloatArray

N_BOW = 3
BOW_TERMS = ("sag_x_m", "sag_y_m", "twist_m")


def bow_basis(p_board_m: FloatArray, pattern: PatternSpec) -> FloatArray:
    """Give d(z of board) by the bow's terms for points on the board, shape (n, 3).

    Args:
        p_board_m: Points on the flat board, shape (n, 3), frame board.
        pattern: What is printed; its inner corners span -1 to 1 along each axis.
    """
    half = np.array([pattern.columns, pattern.rows]) / 2 * pattern.square_m
    x, y = ((p_board_m[:, :2] - half) / (half - pattern.square_m)).T
    return np.stack([1.0 - x**2, 1.0 - y**2, x * y], axis=1)


def bowed(p_board_m: FloatArray, pattern: PatternSpec, bow_m: FloatArray) -> FloatArray:
    """Give the points where they are on a board with that bow, shape (n, 3), frame board."""
    points = p_board_m.copy()
    points[:, 2] += bow_basis(p_board_m, pattern) @ bow_m
    return points
