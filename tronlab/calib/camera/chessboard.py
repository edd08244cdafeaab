"""Corners of a plain chessboard, always counted from the same corner of the board."""

from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray

_WINDOW = 0.3
"""Half the side of the window a corner is refined in, part of the distance to the next one: beyond
about 0.4 the neighbours' edges come into it and pull the corner."""
_WINDOW_PX = 2, 11
_REFINE = cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-4


def find_chessboard(grey: NDArray[np.uint8], *, columns: int, rows: int) -> FloatArray:
    """Find the inner corners of a chessboard, row by row from the board's top left.

    A chessboard does not say where its top left is. The square there is taken as black, and the
    corners run as on the front of the board; with an odd ``columns + rows`` this leaves one way to
    count. With an even sum the board looks the same turned by half a turn (a square board perhaps
    by a quarter): then the row that points most to the right in the image is the first, which holds
    from image to image while the camera rolls by less than 90 deg (45 deg). A mirrored chessboard
    is a chessboard: it cannot be told from one image.

    Args:
        grey: The image, shape (rows, columns).
        columns: Number of squares along x of board.
        rows: Number of squares along y of board.

    Returns:
        Corners, shape ((rows - 1) * (columns - 1), 2), pixels; shape (0, 2) if not all are seen.
    """
    size = columns - 1, rows - 1
    found, corners = cv2.findChessboardCorners(
        grey, size, flags=cv2.CALIB_CB_ADAPTIVE_THRESH + cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    if not found:
        found, corners = cv2.findChessboardCornersSB(
            grey, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE + cv2.CALIB_CB_EXHAUSTIVE
        )
    if not found:
        return np.zeros((0, 2))
    grid = np.asarray(corners, dtype=np.float64).reshape(rows - 1, columns - 1, 2)
    return _from_top_left(_refined(grey, grid), grey).reshape(-1, 2)


def _refined(grey: NDArray[np.uint8], grid: FloatArray) -> FloatArray:
    half = int(np.clip(_WINDOW * _spacing(grid), *_WINDOW_PX))
    corners = grid.reshape(-1, 1, 2).astype(np.float32)
    refined = cv2.cornerSubPix(grey, corners, (half, half), (-1, -1), _REFINE)
    return np.asarray(refined, dtype=np.float64).reshape(grid.shape)


def _spacing(grid: FloatArray) -> float:
    along = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)]
    return float(min(along))


def _from_top_left(grid: FloatArray, grey: NDArray[np.uint8]) -> FloatArray:
    """Choose among the ways to count the corners."""
    on_front = [counted for counted in _countings(grid) if _runs_as_on_front(counted)]
    black = [counted for counted in on_front if _starts_at_black(counted, grey)]
    return max(black or on_front, key=_to_the_right)


def _countings(grid: FloatArray) -> list[FloatArray]:
    grids = [grid[::along_y, ::along_x] for along_y, along_x in product((1, -1), repeat=2)]
    if grid.shape[0] == grid.shape[1]:
        grids += [np.swapaxes(counted, 0, 1) for counted in grids]
    return grids


def _runs_as_on_front(grid: FloatArray) -> bool:
    x, y = np.diff(grid, axis=1).mean(axis=(0, 1)), np.diff(grid, axis=0).mean(axis=(0, 1))
    return bool(x[0] * y[1] > x[1] * y[0])


def _starts_at_black(grid: FloatArray, grey: NDArray[np.uint8]) -> bool:
    """Tell whether the square outside the first corner is black, by all squares between corners."""
    centres = (grid[1:, 1:] + grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:]) / 4
    u, v = np.round(centres).astype(int).transpose(2, 0, 1)
    row, column = np.indices(u.shape)
    is_as_first = (row + column) % 2 == 0
    values = grey[v, u].astype(float)
    return bool(values[is_as_first].mean() < values[~is_as_first].mean())


def _to_the_right(grid: FloatArray) -> float:
    x = np.diff(grid, axis=1).mean(axis=(0, 1))
    return float(x[0] / np.linalg.norm(x))
