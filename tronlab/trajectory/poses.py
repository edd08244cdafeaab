"""From the ``trajectory`` section to camera poses."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.errors import ConfigError, FrameError
from tronlab.geometry.poses import pose_along_boresight, pose_from_xyz_quat
from tronlab.trajectory.config import PoseFile, PoweredDescent, StraightLine
from tronlab.trajectory.descent import NOMINAL, fly
from tronlab.yaml_models import join_errors, read_text

HEADER = ("x", "y", "z", "qx", "qy", "qz", "qw")
FILE_QUATERNION_TOLERANCE = 1e-4
"""Departure of a quaternion's norm from 1 that rounding to five digits can cause."""


def camera_poses(
    config: StraightLine | PoseFile | PoweredDescent,
) -> tuple[RigidTransform, ...]:
    """Give ``trs_from_cam`` of every pose, in the order they are flown.

    Several trajectories follow one another: ``trajectory_numbers`` tells which a pose is of.

    Raises:
        ConfigError: The pose file cannot be read, is empty, or has a line that is no pose; or there
            is no descent, or no pose on it.
    """
    if isinstance(config, StraightLine):
        return straight_line(config)
    if isinstance(config, PoseFile):
        return read_poses(config.path)
    return tuple(pose for descent in fly(config).trajectories for pose in descent.trs_from_cam)


def trajectory_numbers(
    config: StraightLine | PoseFile | PoweredDescent,
) -> tuple[int, ...]:
    """Give the number of the trajectory that each pose is of, in the order of ``camera_poses``.

    0 is the nominal trajectory of a powered descent, and every pose of another kind; perturbed
    ones count from 1.

    Raises:
        ConfigError: As ``camera_poses``.
    """
    if isinstance(config, PoweredDescent):
        flown = fly(config).trajectories
        return tuple(descent.number for descent in flown for _ in descent.trs_from_cam)
    return (NOMINAL,) * len(camera_poses(config))


def straight_line(config: StraightLine) -> tuple[RigidTransform, ...]:
    """Give ``trs_from_cam`` of equally spaced poses on a line."""
    positions_m = np.linspace(config.start_trs_m, config.end_trs_m, config.n_points)
    return tuple(
        pose_along_boresight(p_m, boresight=config.boresight_trs, right=config.right_trs)
        for p_m in positions_m
    )


def read_poses(path: Path) -> tuple[RigidTransform, ...]:
    """Read poses ``trs_from_cam`` from CSV; empty lines and lines that begin with # are skipped.

    Raises:
        ConfigError: One line for every line of the file that is no pose; or there is no pose.
    """
    rows = [
        (number, [field.strip() for field in fields])
        for number, fields in enumerate(csv.reader(read_text(path).splitlines()), start=1)
        if fields and not fields[0].lstrip().startswith("#")
    ]
    header = rows[0] if rows else (1, [])
    if tuple(header[1]) != HEADER:
        raise ConfigError(
            f"the first line must be {','.join(HEADER)}, got {','.join(header[1]) or 'nothing'}",
            path=path,
            line=header[0],
        )
    poses = [_pose_or_error(fields, path=path, line=line) for line, fields in rows[1:]]
    errors = [pose for pose in poses if isinstance(pose, ConfigError)]
    if errors:
        raise join_errors(errors)
    if not poses:
        raise ConfigError("trajectory is empty: no pose follows the header", path=path)
    return tuple(pose for pose in poses if isinstance(pose, RigidTransform))


def _pose_or_error(fields: Sequence[str], *, path: Path, line: int) -> RigidTransform | ConfigError:
    if len(fields) != len(HEADER):
        return ConfigError(
            f"expected {len(HEADER)} values ({','.join(HEADER)}), got {len(fields)}",
            path=path,
            line=line,
        )
    values: list[float] = []
    for name, field in zip(HEADER, fields, strict=True):
        try:
            values.append(float(field))
        except ValueError:
            return ConfigError(f"not a number: '{field}'", path=path, line=line, key=name)
        if not math.isfinite(values[-1]):
            return ConfigError(f"must be finite, got {field}", path=path, line=line, key=name)
    try:
        return pose_from_xyz_quat(values, tolerance=FILE_QUATERNION_TOLERANCE)
    except FrameError as error:
        return ConfigError(str(error), path=path, line=line)
