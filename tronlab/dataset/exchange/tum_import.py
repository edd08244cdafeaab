"""Reading a list of images and a trajectory in TUM's format."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.exchange.association import associate
from tronlab.dataset.exchange.foreign import ForeignSet, ForeignShot
from tronlab.dataset.exchange.text_files import number, poses_of_numbers, read_lines
from tronlab.errors import DatasetError
from tronlab.geometry.poses import FloatArray

TUM_MAX_DIFFERENCE_S = 0.02
"""What the benchmark's own tool takes for the same time."""
_IMAGE_LIST = ("timestamp", "filename")
_TRAJECTORY = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")


def read_tum(
    images_path: Path,
    trajectory_path: Path,
    *,
    max_difference_s: float = TUM_MAX_DIFFERENCE_S,
    offset_s: float = 0.0,
) -> ForeignSet:
    """Read a list of images and a trajectory in TUM's format; an image takes the nearest pose.

    Nothing is interpolated: the pose is that of another moment, up to ``max_difference_s`` away.
    Shots are numbered from 1 in the order of the list.

    Args:
        images_path: Rows of ``timestamp filename``; files are relative to the list.
        trajectory_path: Rows of ``timestamp tx ty tz qx qy qz qw``.
        max_difference_s: Images without a pose so near in time are left out.
        offset_s: Added to the times of the trajectory.

    Raises:
        DatasetError: A file cannot be read, has no rows or one that cannot be, or no image has a
            pose.
    """
    images = [
        (where, number(stamp, where), images_path.parent / name)
        for where, (stamp, name) in read_lines(images_path, columns=_IMAGE_LIST)
    ]
    times_s, poses = read_trajectory(trajectory_path)
    pairs = associate(
        [time_s for _, time_s, _ in images],
        times_s,
        max_difference_s=max_difference_s,
        offset_b_s=offset_s,
    )
    if not pairs.i_a.size:
        raise DatasetError(
            f"{images_path}: none of {len(images)} images has a pose in {trajectory_path} within"
            f" {max_difference_s:g} s; check the time stamps, or name an offset"
        )
    shots = tuple(
        ForeignShot(
            shot_id=i + 1,
            where=images[i][0],
            image_path=images[i][2],
            trs_from_cam=poses[j],
            time_s=images[i][1],
        )
        for i, j in zip(pairs.i_a.tolist(), pairs.i_b.tolist(), strict=True)
    )
    note = (
        f"{len(shots)} of {len(images)} images have a pose within {max_difference_s:g} s; the pose"
        f" is of another moment by {np.abs(pairs.difference_s).max() * 1e3:.3f} ms at most, nothing"
        " was interpolated"
    )
    return ForeignSet(shots, notes=(note,))


def read_trajectory(path: Path) -> tuple[FloatArray, RigidTransform]:
    """Read a trajectory in TUM's format, rows of ``timestamp tx ty tz qx qy qz qw``.

    Returns:
        Times, seconds, and poses, both of shape (n,).

    Raises:
        DatasetError: The file cannot be read, has no rows, or a row is no pose.
    """
    rows = list(read_lines(path, columns=_TRAJECTORY))
    if not rows:
        raise DatasetError(f"{path}: has no poses")
    values = np.array([[number(word, where) for word in words] for where, words in rows])
    return values[:, 0], poses_of_numbers(values[:, 1:], [where for where, _ in rows])
