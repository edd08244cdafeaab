"""The text file of camera poses for Blender (paper, section 3.2).

One pose a line, ``x y z qw qx qy qz``: the camera's coordinates in F_TRS, metres, and the
quaternion of the camera's frame as Blender has it: scalar first, and of the frame whose y- and
z-axis are those of ``cam`` reversed, so that the camera looks along -z with y up (paper, section
3.3 and Fig. 4). What follows a ``#`` is a remark; empty lines count for nothing.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.errors import FrameError
from tronlab.geometry.poses import CAM_FROM_BLENDER_CAM, pose_from_xyz_quat, xyz_quat_from_pose
from tronlab.render.renderer import RenderError

HEADER = (
    "# x y z qw qx qy qz: camera in F_TRS, metres; quaternion of Blender's camera frame"
    " (looks along -z, y up), scalar first"
)
NORM_TOLERANCE = 1e-3
"""Largest departure of a quaternion's norm from 1 accepted: files may have few digits."""


def write_poses(path: Path, trs_from_cams: Sequence[RigidTransform]) -> None:
    """Write camera poses as Blender takes them, with all digits."""
    lines = [HEADER, *(_line(trs_from_cam) for trs_from_cam in trs_from_cams)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_poses(path: Path) -> list[RigidTransform]:
    """Read camera poses ``trs_from_cam``.

    Raises:
        RenderError: The file cannot be read, or a line is no pose.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RenderError(f"poses: {path} cannot be read: {error}") from error
    numbered = ((number, line.split("#")[0].split()) for number, line in enumerate(lines, start=1))
    return [_pose(values, where=f"{path}:{number}") for number, values in numbered if values]


def _line(trs_from_cam: RigidTransform) -> str:
    *xyz, qx, qy, qz, qw = xyz_quat_from_pose(trs_from_cam * CAM_FROM_BLENDER_CAM).tolist()
    return " ".join(repr(value) for value in (*xyz, qw, qx, qy, qz))


def _pose(values: list[str], *, where: str) -> RigidTransform:
    if len(values) != 7:
        raise RenderError(f"{where}: {len(values)} values, expected 7: x y z qw qx qy qz")
    try:
        x, y, z, qw, qx, qy, qz = (float(value) for value in values)
        trs_from_blender_cam = pose_from_xyz_quat(
            np.array([x, y, z, qx, qy, qz, qw]), tolerance=NORM_TOLERANCE
        )
    except (ValueError, FrameError) as error:
        raise RenderError(f"{where}: {error}") from error
    return trs_from_blender_cam * CAM_FROM_BLENDER_CAM.inv()
