"""``matches.h5``: the answer of every core to every shot, as group ``core/seed/shot_id``.

Before there were seeds it was ``core/shot_id``; that is read as seed 0.
"""

from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tronlab.errors import ScoreError
from tronlab.geometry.poses import FloatArray, xyz_quat_from_pose
from tronlab.nav.core import NavigationResult
from tronlab.score.rescoring.shot import CoreScore


@dataclass(frozen=True, slots=True)
class StoredAnswer:
    """What a core answered to a shot, as far as it is not in the table of scores."""

    core: str
    seed: int
    shot_id: int
    status: str
    reason: str
    uv_inliers: FloatArray
    """Image positions the pose rests on, shape (n, 2), pixels, to float32."""
    landmark_inliers: NDArray[np.intp]
    """Landmark of each in the database; empty if the core has none."""
    database: str
    """Digest of the database."""


def write_matches(path: Path, scores: Iterable[CoreScore]) -> None:
    """Write a new file.

    Raises:
        OSError: It cannot be written.
    """
    with h5py.File(path, "w", libver="v110") as file:
        for score in scores:
            name = f"{score.core}/{score.seed}/{score.shot_id}"
            _write_result(file.create_group(name), score.result)


def copy_matches(source_path: Path, target_path: Path, cores: Iterable[str]) -> None:
    """Copy the answers of some cores into another file.

    Raises:
        OSError: One of them cannot be read or written.
    """
    with h5py.File(source_path, "r") as source, h5py.File(target_path, "a") as target:
        for core in cores:
            shots: Any = source[core]
            if _is_of_one_seed(shots):
                source.copy(shots, target.create_group(core), "0")
            else:
                source.copy(shots, target)


def read_reasons(path: Path) -> dict[tuple[str, int, int], str]:
    """Read why cores gave no pose, by core, seed and shot id.

    Raises:
        ScoreError: The file cannot be read.
    """
    with _opened(path) as file:
        return {
            (core, seed, shot_id): reason
            for core, seed, shot_id, group in _groups(file)
            if (reason := str(group.attrs["reason"]))
        }


def read_uv_inliers(path: Path, core: str, shot_id: int, seed: int) -> FloatArray:
    """Read the image positions a pose rests on, shape (n, 2), pixels; empty without a pose.

    Raises:
        ScoreError: The file cannot be read.
    """
    with _opened(path) as file:
        group = file.get(f"{core}/{seed}/{shot_id}")
        if group is None or "uv_inliers" not in group:
            group = file.get(f"{core}/{shot_id}") if seed == 0 else None
        if group is None or "uv_inliers" not in group:
            return np.empty((0, 2))
        return group["uv_inliers"][:].astype(np.float64)


def read_answers(path: Path) -> Iterator[StoredAnswer]:
    """Read every answer, one after the other.

    Raises:
        ScoreError: The file cannot be read.
    """
    with _opened(path) as file:
        for core, seed, shot_id, group in _groups(file):
            landmarks = group.get("landmark_inliers")
            yield StoredAnswer(
                core,
                seed,
                shot_id,
                str(group.attrs["status"]),
                str(group.attrs["reason"]),
                group["uv_inliers"][:].astype(np.float64),
                np.empty(0, np.intp) if landmarks is None else landmarks[:].astype(np.intp),
                str(group.attrs.get("database", "")),
            )


def _write_result(group: h5py.Group, result: NavigationResult) -> None:
    group.attrs["status"] = result.status
    group.attrs["reason"] = result.reason
    uv = np.asarray(result.uv_inliers, np.float32)
    group.create_dataset("uv_inliers", data=uv).attrs["units"] = "px"
    if len(result.landmark_inliers):
        group.attrs["database"] = result.database
        landmarks = np.asarray(result.landmark_inliers, np.int64)
        group.create_dataset("landmark_inliers", data=landmarks)
    if result.trs_from_cam is not None:
        pose = xyz_quat_from_pose(result.trs_from_cam)
        stored = group.create_dataset("trs_from_cam", data=pose)
        stored.attrs.update(parent="trs", child="cam", quaternion_order="xyzw")
    if result.covariance is not None:
        group.create_dataset("covariance", data=result.covariance)
    if result.bound is not None:
        group.create_dataset("bound", data=result.bound)


def _groups(file: Any) -> Iterator[tuple[str, int, int, Any]]:
    """Give core, seed, shot id and group of every answer."""
    for core, members in file.items():
        seeds: Any = {"0": members} if _is_of_one_seed(members) else members
        for seed, shots in seeds.items():
            for shot_id, group in shots.items():
                yield core, int(seed), int(shot_id), group


def _is_of_one_seed(members: Any) -> bool:
    """Tell whether the members of a core are shots: a file from before there were seeds."""
    return any("status" in member.attrs for member in members.values())


@contextmanager
def _opened(path: Path) -> Generator[Any]:
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise ScoreError(f"{path}: cannot be read: {error}; run tronlab score again") from error
    with file:
        yield file
