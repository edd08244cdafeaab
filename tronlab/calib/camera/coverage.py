"""In words and characters: what of the board is seen, and what of the image is covered."""

from collections.abc import Sequence

import numpy as np

from tronlab.calib.camera.board import BoardView
from tronlab.calib.camera.view_checks import coverage
from tronlab.devices.laboratory import PatternSpec
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

_ACROSS = ("left", "middle", "right")
_DOWN = ("upper", "middle", "lower")


def describe_view(view: BoardView, pattern: PatternSpec, camera: CameraModel) -> str:
    """Say how many corners were found, and where in the image."""
    n_all = (pattern.columns - 1) * (pattern.rows - 1)
    if not len(view):
        return f"no corner of {n_all} found"
    size = np.array([camera.width_px, camera.height_px])
    third = np.clip((view.uv_px.mean(axis=0) + 0.5) / size * 3, 0, 2).astype(int)
    return f"{len(view)} of {n_all} corners found, {_place(third)} of the image"


def coverage_picture(views: Sequence[BoardView], camera: CameraModel) -> str:
    """Draw the fields of the image: ``x`` where corners were found, a dot where none was yet."""
    rows = coverage(views, camera)
    if rows.all():
        return "  corners everywhere in the image"
    return "\n".join("  " + " ".join("x" if is_seen else "." for is_seen in row) for row in rows)


def _place(third: FloatArray) -> str:
    across, down = _ACROSS[int(third[0])], _DOWN[int(third[1])]
    return f"in the {across}" if across == down else f"in the {down} {across}"
