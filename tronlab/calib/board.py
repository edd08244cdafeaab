"""The ChArUco board: finding its corners in an image."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tronlab.devices.laboratory import PatternSpec
from tronlab.geometry.poses import FloatArray

_WHITE_12_BIT = 4095


@dataclass(frozen=True, slots=True)
class BoardView:
    """The corners of the board found in one image."""

    ids: NDArray[np.int64]
    """Number of each corner, counted along the rows of the board, shape (n,)."""
    p_board_m: FloatArray
    """Where they are on the board, shape (n, 3), frame board."""
    uv_px: FloatArray
    """Where they are in the image, shape (n, 2)."""

    def __len__(self) -> int:
        return len(self.ids)


def corner_points(spec: PatternSpec) -> FloatArray:
    """Give the inner corners of the board by their number, shape (n, 3), metres, frame board."""
    columns, rows = np.meshgrid(np.arange(1, spec.columns), np.arange(1, spec.rows))
    flat = np.zeros((columns.size, 3))
    flat[:, 0], flat[:, 1] = columns.ravel() * spec.square_m, rows.ravel() * spec.square_m
    return flat


def charuco_board(spec: PatternSpec) -> cv2.aruco.CharucoBoard:
    """Make OpenCV's description of the board."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, spec.dictionary))
    return cv2.aruco.CharucoBoard(
        (spec.columns, spec.rows), spec.square_m, spec.marker_m, dictionary
    )


def detect_board(image: NDArray[np.uint8] | NDArray[np.uint16], spec: PatternSpec) -> BoardView:
    """Find the corners of the board, to a small part of a pixel.

    Args:
        image: Mono8 as uint8 or Mono12 as uint16, shape (rows, columns).
        spec: The board.

    Returns:
        The corners found; none is a view without corners, not an error.
    """
    grey = _to_8_bit(image) if image.dtype == np.uint16 else image
    detector = cv2.aruco.CharucoDetector(charuco_board(spec))
    uv, ids, _, _ = detector.detectBoard(grey)
    if ids is None:  # pyright: ignore[reportUnnecessaryComparison]  # OpenCV's stub is wrong
        return BoardView(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 2)))
    numbers = np.asarray(ids, dtype=np.int64).ravel()
    return BoardView(
        ids=numbers,
        p_board_m=corner_points(spec)[numbers],
        uv_px=np.asarray(uv, dtype=np.float64).reshape(-1, 2),
    )


def _to_8_bit(image: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.uint8]:
    return np.round(image * (255.0 / _WHITE_12_BIT)).astype(np.uint8)
