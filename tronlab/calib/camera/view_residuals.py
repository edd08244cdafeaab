"""How well the camera of a record fits each of its views: corners projected less corners found."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.board import BoardView
from tronlab.calib.camera.fit import CameraFit, Corners, resect, residuals_px
from tronlab.calib.camera.view_checks import start_poses
from tronlab.calib.inputs import Inputs, StationsInput, views_of
from tronlab.calib.results import CameraResult
from tronlab.devices.laboratory import PatternSpec
from tronlab.geometry.poses import FloatArray


@dataclass(frozen=True, slots=True)
class ViewResiduals:
    """One view of the board."""

    name: str
    """``station 3`` or ``view 3``, counted from 0."""
    uv_px: FloatArray
    """Corners found, shape (n, 2)."""
    residuals_px: FloatArray
    """Projected minus found, shape (n, 2)."""
    cam_from_board: RigidTransform
    """The pose of the board that fits best."""
    is_outlier: NDArray[np.bool_]
    """Corners that were left out of the solution, alone or with the whole view, shape (n,)."""


def view_residuals(inputs: Inputs, result: CameraResult) -> tuple[ViewResiduals, ...]:
    """Give the residuals of every view that a camera follows from.

    The pose of the board in each view is the one that fits best: what is left is the camera's.

    Args:
        inputs: What the camera was solved from.
        result: The camera.

    Returns:
        Stations first, then views without the tracker; empty if ``inputs`` has neither.

    Raises:
        CalibrationError: No pose of the board fits the corners of a view.
    """
    pattern, named = _views(inputs)
    if pattern is None or not named:
        return ()
    views = [view for _, view in named]
    corners = Corners.of(views, pattern)
    start = CameraFit.at(result.camera, start_poses(views, result.camera))
    fit = resect(corners, replace(start, bow_m=result.bow_m))
    residuals = residuals_px(corners, fit)
    outlier_views = set(result.statistics.get("outlier_views", ()))
    outlier_corners = {tuple(corner) for corner in result.statistics.get("outlier_corners", ())}
    return tuple(
        ViewResiduals(
            name=name,
            uv_px=view.uv_px,
            residuals_px=residuals[i, : len(view)],
            cam_from_board=fit.cam_from_board[i],
            is_outlier=np.array(
                [i in outlier_views or (i, int(corner)) in outlier_corners for corner in view.ids]
            ),
        )
        for i, (name, view) in enumerate(named)
    )


def _views(inputs: Inputs) -> tuple[PatternSpec | None, list[tuple[str, BoardView]]]:
    """Give the views that a camera is solved from, by name, in the order of the solution."""
    named: list[tuple[str, BoardView]] = []
    pattern = None
    if isinstance(inputs.hand_eye, StationsInput):
        pattern = inputs.hand_eye.pattern
        views = views_of([station.view for station in inputs.hand_eye.stations], pattern)
        named += [(f"station {i}", view) for i, view in enumerate(views)]
    if inputs.intrinsics is not None and pattern in (None, inputs.intrinsics.pattern):
        pattern = inputs.intrinsics.pattern
        views = views_of(inputs.intrinsics.views, pattern)
        named += [(f"view {i}", view) for i, view in enumerate(views)]
    return pattern, named
