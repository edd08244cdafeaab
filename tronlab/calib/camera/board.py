"""The calibration board: finding its corners in an image."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tronlab.calib.camera.chessboard import find_chessboard
from tronlab.devices.laboratory import PatternKind, PatternSpec
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.poses import FloatArray

_WHITE_12_BIT = 4095
_MIN_MARKERS = 4
"""So many markers are no accident."""
_OTHER_LAYOUT: dict[PatternKind, PatternKind] = {
    "charuco": "charuco_legacy",
    "charuco_legacy": "charuco",
}


@dataclass(frozen=True, slots=True)
class BoardView:
    """The corners of the board found in one image."""

    ids: NDArray[np.int64]
    """Number of each corner, counted along the rows of the board, shape (n,)."""
    p_board_m: FloatArray
    """Where they are on the board, shape (n, 3), frame board."""
    uv_px: FloatArray
    """Where they are in the image, shape (n, 2)."""

    @classmethod
    def of(
        cls, ids: Sequence[int] | NDArray[np.integer], uv_px: ArrayLike, spec: PatternSpec
    ) -> "BoardView":
        """Give the view of corners by their numbers.

        Raises:
            CalibrationError: The board has no corner of that number.
        """
        numbers = np.asarray(ids, dtype=np.int64).ravel()
        points = corner_points(spec)
        if is_unknown := sorted({*numbers.tolist()} - {*range(len(points))}):
            raise CalibrationError(
                f"board: corner {is_unknown[0]} does not exist, a board of {spec.columns} x"
                f" {spec.rows} squares has corners 0 to {len(points) - 1}; check columns and rows"
            )
        uv = np.asarray(uv_px, dtype=np.float64).reshape(-1, 2)
        return cls(numbers, points[numbers], uv)

    def __len__(self) -> int:
        return len(self.ids)


def corner_points(spec: PatternSpec) -> FloatArray:
    """Give the inner corners of the board by their number, shape (n, 3), metres, frame board."""
    columns, rows = np.meshgrid(np.arange(1, spec.columns), np.arange(1, spec.rows))
    flat = np.zeros((columns.size, 3))
    flat[:, 0], flat[:, 1] = columns.ravel() * spec.square_m, rows.ravel() * spec.square_m
    return flat


def charuco_board(spec: PatternSpec) -> cv2.aruco.CharucoBoard:
    """Make OpenCV's description of the board.

    Raises:
        CalibrationError: It has no markers.
    """
    if spec.marker_m is None:
        raise CalibrationError("board: a chessboard has no markers")
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, spec.dictionary))
    board = cv2.aruco.CharucoBoard(
        (spec.columns, spec.rows), spec.square_m, spec.marker_m, dictionary
    )
    board.setLegacyPattern(spec.kind == "charuco_legacy")
    return board


def detect_board(image: NDArray[np.uint8] | NDArray[np.uint16], spec: PatternSpec) -> BoardView:
    """Find the corners of the board, to a small part of a pixel.

    Args:
        image: Mono8 as uint8 or Mono12 as uint16, shape (rows, columns).
        spec: The board.

    Returns:
        The corners found; none is a view without corners, not an error. A chessboard is found
        whole or not at all (see ``find_chessboard`` for how its corners are counted).

    Raises:
        DegenerateGeometryError: The image shows the markers mirrored.
        CalibrationError: The markers are those of the other ChArUco layout.
    """
    grey = _to_8_bit(image) if image.dtype == np.uint16 else image.astype(np.uint8, copy=False)
    if spec.kind == "chessboard":
        uv_px = find_chessboard(grey, columns=spec.columns, rows=spec.rows)
        return BoardView.of(range(len(uv_px)), uv_px, spec)
    view, n_markers = _find_charuco(grey, spec)
    if not len(view):
        _explain_nothing(grey, spec, n_markers)
    return view


def _find_charuco(grey: NDArray[np.uint8], spec: PatternSpec) -> tuple[BoardView, int]:
    """Give the corners, and how many markers were seen."""
    detector = cv2.aruco.CharucoDetector(charuco_board(spec))
    uv, ids, _, marker_ids = detector.detectBoard(grey)
    # OpenCV gives None where it found nothing; its stubs do not say so.
    n_markers = 0 if marker_ids is None else len(marker_ids)  # pyright: ignore[reportUnnecessaryComparison]
    if ids is None:  # pyright: ignore[reportUnnecessaryComparison]
        return BoardView.of((), (), spec), n_markers
    return BoardView.of(np.asarray(ids, dtype=np.int64), uv, spec), n_markers


def _explain_nothing(grey: NDArray[np.uint8], spec: PatternSpec, n_markers: int) -> None:
    """Raise an error if the reason for no corners can be named."""
    if n_markers < _MIN_MARKERS:
        if _find_charuco(_mirrored(grey), spec)[1] >= _MIN_MARKERS:
            raise DegenerateGeometryError(
                "board: the image shows it mirrored; switch off the flip of the camera or the file"
            )
        return
    for change in (
        {"kind": _OTHER_LAYOUT[spec.kind]},
        {"columns": spec.rows, "rows": spec.columns},
    ):
        if len(_find_charuco(grey, spec.model_copy(update=change))[0]):
            keys = ", ".join(f"{key}: {value}" for key, value in change.items())
            raise CalibrationError(
                f"board: the markers are not where a board of kind {spec.kind} with {spec.columns}"
                f" columns and {spec.rows} rows has them; they would be with {keys}"
            )


def _mirrored(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.ascontiguousarray(grey[:, ::-1])


def _to_8_bit(image: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.uint8]:
    return np.round(image * (255.0 / _WHITE_12_BIT)).astype(np.uint8)
