"""Whether views of a board can determine a camera at all; what they miss is said by name."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.camera.board import BoardView, corner_points
from tronlab.devices.laboratory import PatternSpec
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

MIN_VIEWS = 6
MIN_CORNERS = 12
"""Of a view that counts."""
GRID = 5
"""The image is looked at in GRID x GRID fields."""
MIN_COVERAGE = 0.8
"""Part of the fields that must have corners."""
MIN_TILT_RAD = np.radians(10.0)
MIN_TILTED_VIEWS = 3
"""Square-on views leave focal length and distance apart by their product only."""
BOARD_DISTANCES_M = (0.01, 100.0)
"""A board nearer or farther is one whose size is given in another unit."""
_ONE_DISTANCE = 0.05
"""Views whose distances differ by less than this part are at one distance."""


def coverage(views: Sequence[BoardView], camera: CameraModel) -> NDArray[np.bool_]:
    """Tell which fields of the image have corners, shape (GRID, GRID), rows from the top."""
    is_covered = np.zeros((GRID, GRID), dtype=bool)
    for view in views:
        fields = ((view.uv_px + 0.5) / [camera.width_px, camera.height_px] * GRID).astype(int)
        column, row = np.clip(fields, 0, GRID - 1).T
        is_covered[row, column] = True
    return is_covered


def check_coverage(views: Sequence[BoardView], camera: CameraModel) -> None:
    """Raise DegenerateGeometryError if the views are too few or leave too much of the image."""
    if len(views) < MIN_VIEWS:
        raise DegenerateGeometryError(
            f"intrinsics: {len(views)} views of the board, at least {MIN_VIEWS} needed"
        )
    for i, view in enumerate(views):
        if len(view) < MIN_CORNERS:
            raise DegenerateGeometryError(
                f"intrinsics: view {i} has {len(view)} corners, at least {MIN_CORNERS} needed"
            )
    is_covered = coverage(views, camera)
    if is_covered.mean() < MIN_COVERAGE:
        picture = "\n".join("  " + "".join("x" if c else "." for c in row) for row in is_covered)
        raise DegenerateGeometryError(
            f"intrinsics: corners lie in {is_covered.mean():.0%} of the image, at least"
            f" {MIN_COVERAGE:.0%} needed; show the board where there is a dot:\n{picture}"
        )


def check_corners(views: Sequence[BoardView], pattern: PatternSpec, camera: CameraModel) -> None:
    """Raise CalibrationError if corners are not of this board, not of this image, or mirrored."""
    points = corner_points(pattern)
    for i, view in enumerate(views):
        if len(view) and not 0 <= view.ids.min() <= view.ids.max() < len(points):
            raise CalibrationError(
                f"intrinsics: view {i} has corner {_outside(view.ids, len(points))}; a board of"
                f" {pattern.columns} x {pattern.rows} squares has 0 to {len(points) - 1}: check"
                " columns and rows"
            )
        if len(np.unique(view.ids)) < len(view):
            raise CalibrationError(f"intrinsics: view {i} has a corner twice")
        size = np.array([camera.width_px, camera.height_px])
        is_inside = (view.uv_px >= -0.5) & (view.uv_px <= size - 0.5)
        if not is_inside.all():
            corner = int(np.flatnonzero(~is_inside.all(axis=1))[0])
            raise CalibrationError(
                f"intrinsics: view {i} has a corner at {np.round(view.uv_px[corner], 1).tolist()},"
                f" outside an image of {camera.width_px} x {camera.height_px} pixels"
            )
        _check_side(i, view)


def _outside(ids: NDArray[np.int64], n: int) -> int:
    return int(ids[(ids < 0) | (ids >= n)][0])


def _check_side(i: int, view: BoardView) -> None:
    """The print on the front of a board runs the same way round in the image."""
    if len(view) < MIN_CORNERS:
        return
    flat = np.column_stack([view.p_board_m[:, :2], np.ones(len(view))])
    affine, _, rank, _ = np.linalg.lstsq(flat, view.uv_px)
    if rank < flat.shape[1]:
        raise DegenerateGeometryError(f"intrinsics: all corners of view {i} lie on one line")
    if np.linalg.det(affine[:2]) < 0:
        raise DegenerateGeometryError(
            f"intrinsics: view {i} shows the board mirrored; check that neither image nor print is"
            " flipped, and that corners are counted along the rows from the top left"
        )


def start_poses(views: Sequence[BoardView], nominal: CameraModel) -> list[RigidTransform]:
    """Give cam_from_board of each view, with the nominal camera.

    Raises:
        CalibrationError: A view has no pose, or the board's size is in another unit.
    """
    poses = [_start_pose(i, view, nominal) for i, view in enumerate(views)]
    low, high = BOARD_DISTANCES_M
    distance = float(np.median([pose.translation[2] for pose in poses]))
    if not low <= distance <= high:
        raise CalibrationError(
            f"intrinsics: the board would be {distance:.3g} m from the camera, {low} to {high:.0f}"
            " m are possible; check that square_m is in metres and the nominal focal length in"
            " pixels"
        )
    return poses


def _start_pose(i: int, view: BoardView, nominal: CameraModel) -> RigidTransform:
    distortion = np.array(nominal.distortion)
    found, rvec, tvec = cv2.solvePnP(view.p_board_m, view.uv_px, nominal.matrix, distortion)
    pose = RigidTransform.from_components(np.ravel(tvec), Rotation.from_rotvec(np.ravel(rvec)))
    if not found or not (pose.apply(view.p_board_m)[:, 2] > 0).all():
        raise CalibrationError(f"intrinsics: no pose of the board fits the corners of view {i}")
    return pose


def check_tilts(cam_from_board: Sequence[RigidTransform]) -> None:
    """Raise DegenerateGeometryError if nearly all views are square-on."""
    tilts = tilts_rad(cam_from_board)
    n_tilted = int((tilts >= MIN_TILT_RAD).sum())
    if n_tilted >= MIN_TILTED_VIEWS:
        return
    distances = np.array([pose.translation[2] for pose in cam_from_board])
    same = np.ptp(distances) < _ONE_DISTANCE * distances.mean()
    where = f", all at one distance of {distances.mean():.2f} m" if same else ""
    raise DegenerateGeometryError(
        f"intrinsics: {n_tilted} views see the board tilted by {np.degrees(MIN_TILT_RAD):.0f} deg"
        f" or more{where}, at least {MIN_TILTED_VIEWS} needed; square-on views do not separate"
        " focal length from distance"
    )


def tilts_rad(cam_from_board: Sequence[RigidTransform]) -> FloatArray:
    """Give the angle between optical axis and the board's normal in each view, shape (n,)."""
    cosines = np.array([pose.rotation.as_matrix()[2, 2] for pose in cam_from_board])
    return np.arccos(np.clip(np.abs(cosines), 0.0, 1.0))
