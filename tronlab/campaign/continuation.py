"""Going on with a dataset: what is in it, what is missing, and what shall be taken again."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tronlab.campaign.job import Files
from tronlab.dataset.location import DATASET_NAME
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Session, ShotQuality
from tronlab.dataset.schema import CAMERA, QUALITY_FLAGS, SESSION, Status
from tronlab.errors import ConfigError, PlanError
from tronlab.geometry.camera import CameraModel
from tronlab.planning.shots import Plan, Shot

_MAX_SHOT_ID = 1_000_000
"""Ten times as many as the longest campaign has: a slip of the finger must not fill the memory."""
_N_STANDARD = 200
"""So many shots are enough to know how sharp and how bright they are."""


@dataclass(frozen=True)
class Recorded:
    """What a dataset says of itself before it goes on."""

    path: Path
    status: Status
    sessions: tuple[Session, ...]
    shot_ids: frozenset[int]
    """Of the shots that are there."""
    flagged_ids: frozenset[int]
    """Of those, the ones a quality gate flagged."""
    last_session: Session
    """The last one that took a shot, so that a start that came to nothing does not count."""
    last_time_s: float
    """When the last image was taken, seconds since 1970 UTC; 0 if there is none."""
    camera: CameraModel
    image_dtype: np.dtype[Any] | None
    """None before the first image."""
    standard: tuple[tuple[ShotQuality, float], ...]
    """Of the last shots: what the quality gate goes on comparing with, and their range, metres."""


def dataset_in(folder: Path) -> Path:
    """Give the dataset of a folder, or of its file.

    Raises:
        ConfigError: There is none.
    """
    path = folder / DATASET_NAME if folder.is_dir() else folder
    if not folder.exists():
        raise ConfigError("no such folder", path=folder)
    if not path.exists():
        raise ConfigError(
            "has no dataset: no shot was recorded in it; begin anew: tronlab run CAMPAIGN.yaml"
            f" --out {folder}",
            path=folder,
        )
    return path


def read_recorded(path: Path) -> Recorded:
    """Look what is in a dataset.

    Raises:
        ConfigError: It is none that can go on.
        DatasetError: It cannot be read.
    """
    with Dataset(path) as dataset:
        if not dataset.can_go_on:
            raise ConfigError(
                f"{path}: has no segments (it was packed, imported or computed anew, or is of an"
                " older layout), so nothing can be added to it; record a new one:"
                " tronlab run CAMPAIGN.yaml --out DIR"
            )
        times_s, sessions = dataset.rows(f"{CAMERA}/time_s"), dataset.rows(SESSION)
        return Recorded(
            path=path,
            status=dataset.status,
            sessions=dataset.sessions,
            shot_ids=frozenset(map(int, dataset.shot_ids)),
            flagged_ids=frozenset(map(int, dataset.shot_ids[dataset.rows(QUALITY_FLAGS) != 0])),
            last_session=dataset.sessions[int(sessions.max()) - 1 if sessions.size else -1],
            last_time_s=float(times_s.max()) if times_s.size else 0.0,
            camera=dataset.camera,
            image_dtype=dataset.image_dtype,
            standard=tuple(_standard(dataset)),
        )


@dataclass(frozen=True)
class GivenFiles:
    """Files to go on with instead of those of a dataset's last session; None: the same."""

    campaign: Path | None = None
    rig: Path | None = None
    calibration: Path | None = None


def files_of(session: Session, given: GivenFiles) -> Files:
    """Give which files a dataset goes on with: those named now, else those of its last session.

    Raises:
        ConfigError: A file of the last session is not there any more.
    """
    return Files(
        campaign=_file(given.campaign, session.campaign_path, "campaign"),
        rig=_file(given.rig, session.rig_path, "rig"),
        calibration=_file(given.calibration, session.calibration_path, "calibration"),
    )


def _file(given: Path | None, recorded: str, name: str) -> Path:
    path = given or Path(recorded)
    if given is None and not path.is_file():
        raise ConfigError(
            f"the {name} file of the recording is not there any more; name it:"
            f" {_HOW_TO_NAME[name]}",
            path=path,
        )
    return path


_HOW_TO_NAME = {
    "campaign": "tronlab run CAMPAIGN.yaml --resume DIR",
    "rig": "--rig RIG.yaml",
    "calibration": "--calibration RECORD.json",
}


def missing_shots(plan: Plan, recorded: Recorded) -> tuple[Shot, ...]:
    """Give the shots of a plan that are not in the dataset."""
    return tuple(shot for shot in plan.shots if shot.shot_id not in recorded.shot_ids)


def failed_shots(plan: Plan, recorded: Recorded) -> tuple[Shot, ...]:
    """Give the shots that are missing, and those a quality gate flagged."""
    good = recorded.shot_ids - recorded.flagged_ids
    return tuple(shot for shot in plan.shots if shot.shot_id not in good)


def chosen_shots(plan: Plan, shot_ids: Sequence[int]) -> tuple[Shot, ...]:
    """Give the shots of these ids, in the order of the plan.

    Raises:
        PlanError: The plan has no such shots.
    """
    planned = {shot.shot_id for shot in plan.shots}
    if unknown := sorted(set(shot_ids) - planned):
        raise PlanError(
            f"no shots {', '.join(map(str, unknown))}; the plan has {min(planned)} to"
            f" {max(planned)}"
        )
    return tuple(shot for shot in plan.shots if shot.shot_id in set(shot_ids))


def parse_shot_ids(text: str) -> tuple[int, ...]:
    """Read a list of shot ids as people write it: ``3,7-9``.

    Raises:
        ConfigError: It is none.
    """
    ids: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise ConfigError(f"--shots {text}: '{part.strip()}' is no shot; write 3,7-9")
        begin, end = int(first), int(last if dash else first)
        if not begin <= end <= _MAX_SHOT_ID:
            raise ConfigError(
                f"--shots {text}: '{part.strip()}' goes from {begin} to {end}; expected numbers"
                f" that go up, at most {_MAX_SHOT_ID}"
            )
        ids += range(begin, end + 1)
    return tuple(dict.fromkeys(ids))


def _standard(dataset: Dataset) -> Iterator[tuple[ShotQuality, float]]:
    for i in range(max(0, dataset.n_shots - _N_STANDARD), dataset.n_shots):
        quality = dataset.quality(i)
        if quality is not None:
            yield quality, dataset.truth(i).range_los_m
