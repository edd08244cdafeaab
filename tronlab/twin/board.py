"""The calibration board: its print, and the light it throws back."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.devices.laboratory import BoardSpec
from tronlab.geometry.poses import FloatArray
from tronlab.render.renderer import Lamp

_TEXELS_PER_SQUARE = 100


def print_board(spec: BoardSpec) -> tuple[NDArray[np.uint8], float]:
    """Draw the board with a white margin one square wide.

    Returns:
        Grey values, shape ((rows + 2) n, (columns + 2) n), 0 black and 255 white, and the length
        of a texel in metres.
    """
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, spec.dictionary))
    board = cv2.aruco.CharucoBoard(
        (spec.columns, spec.rows), spec.square_m, spec.marker_m, dictionary
    )
    n = _TEXELS_PER_SQUARE
    size = ((spec.columns + 2) * n, (spec.rows + 2) * n)
    return np.asarray(board.generateImage(size, marginSize=n), np.uint8), spec.square_m / n


def board_from_print(spec: BoardSpec) -> RigidTransform:
    """Give the place of the print's top-left corner: outside the board by the margin."""
    return RigidTransform.from_translation([-spec.square_m, -spec.square_m, 0.0])


def light_on_board(
    rays: FloatArray,
    trs_from_board: RigidTransform,
    trs_from_cam: RigidTransform,
    lamp: Lamp,
) -> FloatArray:
    """Give the radiance a white board would have along each ray; it faces against its z-axis.

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
