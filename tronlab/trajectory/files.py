"""Trajectories as files: poses as CSV, which campaigns read, or everything as HDF5."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.whole_file import whole_file
from tronlab.errors import ConfigError
from tronlab.geometry.poses import xyz_quat_from_pose
from tronlab.trajectory.descent import Descent
from tronlab.trajectory.poses import HEADER

POSES_SUFFIX = ".csv"
STATES_SUFFIX = ".h5"
_FORMAT = "tronlab trajectories 1.0"
_STATES = {
    "time_s": ("s", "since the start of the descent"),
    "position_m": ("m", "full scale, local vertical frame"),
    "velocity_m_per_s": ("m/s", "full scale, local vertical frame"),
    "thrust_n": ("N", "full scale, local vertical frame"),
    "mass_kg": ("kg", "full scale"),
}


def check_out(path: Path) -> None:
    """Refuse a file that exists, has no name of ours, or cannot be made.

    Raises:
        ConfigError: It is so.
    """
    if path.suffix not in {POSES_SUFFIX, STATES_SUFFIX}:
        raise ConfigError(
            f"--out {path}: the name must end in {POSES_SUFFIX} for poses, or in {STATES_SUFFIX}"
            " for poses and states"
        )
    if path.exists():
        raise ConfigError(
            f"--out {path}: exists already, nothing is overwritten; name another file with --out"
        )
    if not path.parent.is_dir():
        raise ConfigError(f"--out {path}: there is no folder {path.parent}; make it first")


def write_poses(path: Path, poses: Mapping[int, Sequence[RigidTransform]]) -> None:
    """Write ``trs_from_cam`` of each trajectory's poses as the CSV that a campaign reads.

    Args:
        path: A new file.
        poses: By number of the trajectory, which is told in a comment line.

    Raises:
        DatasetError: The file cannot be made.
    """
    lines = [",".join(HEADER)]
    for number, of_one in poses.items():
        lines.append(f"# trajectory {number}")
        lines += [",".join(f"{x:.12g}" for x in xyz_quat_from_pose(pose)) for pose in of_one]
    with whole_file(path) as part:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_states(
    path: Path,
    poses: Mapping[int, Sequence[RigidTransform]],
    descents: Sequence[Descent] = (),
) -> None:
    """Write poses, and states where there are any, as HDF5: a group ``trajectory_N`` each.

    Args:
        path: A new file.
        poses: ``trs_from_cam`` by number of the trajectory.
        descents: Descents whose states are written; their numbers are among those of the poses.

    Raises:
        DatasetError: The file cannot be made.
    """
    import h5py

    by_number = {descent.number: descent for descent in descents}
    with whole_file(path) as part, h5py.File(part, "w") as file:
        file.attrs["format"] = _FORMAT
        for number, of_one in poses.items():
            group = file.create_group(f"trajectory_{number}")
            rows = np.array([xyz_quat_from_pose(pose) for pose in of_one]).reshape(-1, 7)
            _add(group, "trs_from_cam", rows, "m; 1", "x y z qx qy qz qw of each pose")
            if number in by_number:
                _add_states(group, by_number[number])


def _add_states(group: Any, descent: Descent) -> None:
    flight = descent.flight
    for name, (unit, meaning) in _STATES.items():
        _add(group, name, getattr(flight, name), unit, meaning)
    _add(group, "pose_time_s", descent.sampled_time_s, "s", "of each pose, full scale")
    group.attrs["fuel_kg"] = descent.fuel_kg
    group.attrs["flight_time_s"] = descent.flight_time_s
    group.attrs["relaxation_gap"] = descent.relaxation_gap


def _add(group: Any, name: str, values: Any, unit: str, meaning: str) -> None:
    dataset = group.create_dataset(name, data=values)
    dataset.attrs["units"] = unit
    dataset.attrs["long_name"] = meaning
