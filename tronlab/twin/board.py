"""The calibration board: its print, and the light it throws back."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.devices.laboratory import PatternSpec
from tronlab.geometry.poses import FloatArray
from tronlab.render.bow import Bow
from tronlab.render.renderer import Lamp

_TEXELS_PER_SQUARE = 100
_WHITE = 255


def print_board(spec: PatternSpec) -> tuple[NDArray[np.uint8], float]:
    """Draw the board with a white margin one square wide.

    Returns:
        Grey values, shape ((rows + 2) n, (columns + 2) n), 0 black and 255 white, and the length
        of a texel in metres.
    """
    squares = _squares(spec) if spec.marker_m is None else _marked_squares(spec, spec.marker_m)
    texture = np.pad(squares, _TEXELS_PER_SQUARE, constant_values=_WHITE)
    return texture, spec.square_m / _TEXELS_PER_SQUARE


def board_from_print(spec: PatternSpec) -> RigidTransform:
    """Give the place of the print's top-left corner: outside the board by the margin."""
    return RigidTransform.from_translation([-spec.square_m, -spec.square_m, 0.0])


def bow_of_print(spec: PatternSpec, bow_m: FloatArray) -> Bow:
    """Give the shape of the print for the bow of its board.

    Args:
        spec: The board.
        bow_m: Terms of z of board, shape (3,): sag_x (1 - a^2) + sag_y (1 - b^2) + twist a b, where
            a and b go from -1 to 1 over the inner corners; the same as in ``calib.bow``.
    """
    sag_x, sag_y, twist = (float(term) for term in bow_m)
    squares = spec.columns, spec.rows
    centre_x, centre_y = ((n / 2 + 1) * spec.square_m for n in squares)
    half_x, half_y = ((n / 2 - 1) * spec.square_m for n in squares)
    return Bow((centre_x, centre_y), (half_x, half_y), (sag_x, sag_y, twist))


def _squares(spec: PatternSpec) -> NDArray[np.uint8]:
    """Draw a chessboard; the square at the origin is black."""
    row, column = np.indices((spec.rows, spec.columns))
    squares = np.where((row + column) % 2 == 0, 0, _WHITE).astype(np.uint8)
    return np.kron(squares, np.ones((_TEXELS_PER_SQUARE, _TEXELS_PER_SQUARE), np.uint8))


def _marked_squares(spec: PatternSpec, marker_m: float) -> NDArray[np.uint8]:
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, spec.dictionary))
    size = spec.columns, spec.rows
    board = cv2.aruco.CharucoBoard(size, spec.square_m, marker_m, dictionary)
    board.setLegacyPattern(spec.kind == "charuco_legacy")
    size_px = spec.columns * _TEXELS_PER_SQUARE, spec.rows * _TEXELS_PER_SQUARE
    return np.asarray(board.generateImage(size_px), np.uint8)


def light_on_board(
    rays: FloatArray,
    trs_from_board: RigidTransform,
    trs_from_cam: RigidTransform,
    lamp: Lamp,
) -> FloatArray:
    """Give the radiance a white board would have along each ray; it faces against its z-axis.

    The board is taken as flat: a bow turns its normal by a few mrad, which changes the light less
    than anything that is measured in an image of a board.

    Args:
        rays: Normalised image coordinates (x, y), shape (..., 2).
        trs_from_board: Where the board is.
        trs_from_cam: Where the camera is.
        lamp: The lamp; nothing stands between it and the board.

    Returns:
        Shape (...); 0 where the lamp is behind the board.
    """
    directions_cam = np.concatenate([rays, np.ones((*rays.shape[:-1], 1))], axis=-1)
    directions = directions_cam @ trs_from_cam.rotation.as_matrix().T
    normal = -trs_from_board.rotation.as_matrix()[:, 2]
    offset = trs_from_board.translation - trs_from_cam.translation
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (offset @ normal) / (directions @ normal)
        to_lamp = lamp.p_trs_m - (trs_from_cam.translation + depth[..., None] * directions)
        distance = np.linalg.norm(to_lamp, axis=-1)
        shade = lamp.intensity * (to_lamp @ normal) / distance**3
    return np.where(np.isfinite(shade), np.maximum(shade, 0.0), 0.0)
