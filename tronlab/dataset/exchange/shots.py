"""What every exporter is given: the shots of a dataset, one at a time."""

import json
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.dataset import schema
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Truth

OnShot: TypeAlias = Callable[[int, int], None]
"""Told how many shots are done, and of how many."""


@dataclass(frozen=True, slots=True)
class ExportShot:
    """One shot, as far as exporters need it."""

    i: int
    """Its row."""
    shot_id: int
    truth: Truth
    time_s: float
    """Middle of the exposure, seconds since 1970 UTC; NaN if nobody knows."""
    image: NDArray[np.uint8] | NDArray[np.uint16]
    mask: NDArray[np.bool_]

    @property
    def cam_from_trs(self) -> RigidTransform:
        """Get the pose of the terrain model in the camera frame."""
        return self.truth.trs_from_cam.inv()


class Exporter(Protocol):
    """Writes a dataset in one format."""

    @property
    def conventions(self) -> str:
        """Get frames, units and pixel coordinates of the format, for the README of an export."""
        ...

    def write(self, dataset: Dataset, folder: Path, on_shot: OnShot) -> Mapping[int, str]:
        """Fill a folder, and give where in it the image of each shot is, by shot id.

        Raises:
            DatasetError: The dataset lacks what the format needs.
            IntegrityError: A shot is damaged.
            OSError: The disk does not take it.
        """
        ...


def shots_of(dataset: Dataset, on_shot: OnShot) -> Iterator[ExportShot]:
    """Give the shots in row order; each is done when the next one is asked for."""
    times_s = dataset.rows(f"{schema.CAMERA}/time_s")
    for i, shot_id in enumerate(dataset.shot_ids.tolist()):
        yield ExportShot(
            i=i,
            shot_id=shot_id,
            truth=dataset.truth(i),
            time_s=float(times_s[i]),
            image=dataset.image(i),
            mask=dataset.mask(i),
        )
        on_shot(i + 1, dataset.n_shots)


def quat_wxyz(a_from_b: RigidTransform) -> list[float]:
    """Give the quaternion of a pose, scalar first, w >= 0."""
    return a_from_b.rotation.as_quat(canonical=True, scalar_first=True).tolist()


def numbers(values: Any) -> str:
    """Write numbers with blanks between them, each so that it reads back as it was."""
    return " ".join(repr(float(value)) for value in values)


@contextmanager
def json_rows(path: Path) -> Generator[Callable[[int, Any], None]]:
    """Write a JSON object key by key, each in a line of its own: nothing is kept in memory.

    Gives the function that writes a key and its value; at least one must be written.

    Raises:
        OSError: The disk does not take it.
    """
    before = "{"
    with path.open("w", encoding="utf-8") as file:

        def write(key: int, value: Any) -> None:
            nonlocal before
            file.write(f'{before}\n  "{key}": {json.dumps(value)}')
            before = ","

        yield write
        file.write("\n}\n")
