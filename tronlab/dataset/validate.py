"""Checking a dataset: does it hold together, is it undamaged, can its images be used?"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeAlias

from tronlab.dataset.checks import columns, course, frames, images
from tronlab.dataset.reader import Dataset
from tronlab.errors import IntegrityError

_Check: TypeAlias = Callable[[Dataset], Iterable[str]]

_FOR_FINDINGS: tuple[_Check, ...] = (
    columns.shot_ids,
    course.counts,
    course.sessions,
    course.supersession,
    course.segments,
    columns.columns,
    columns.values,
    course.quality,
    frames.camera,
    frames.truth,
    frames.robot,
    course.drift,
)
_FOR_NOTES: tuple[_Check, ...] = (
    course.ending,
    course.skipped,
    course.doubtful,
    course.flagged,
    course.set_aside,
    course.strangers,
)


@dataclass(frozen=True, slots=True)
class Examination:
    """What is to be said of a dataset, one sentence each."""

    findings: tuple[str, ...]
    """What is damaged or contradicts itself."""
    notes: tuple[str, ...]
    """What a sound dataset may be all the same: incomplete, flagged, not vouched for."""


def validate(path: Path) -> list[str]:
    """Give what is damaged in a dataset or contradicts itself; empty if nothing is.

    Raises:
        DatasetError: The file cannot be opened; see ``Dataset``.
    """
    return list(examine(path).findings)


def examine(path: Path, *, on_shot: images.OnShot | None = None) -> Examination:
    """Check a dataset from its counter to the last pixel; one image is in memory at a time.

    Truth is recomputed from the raw tracker readings if the calibration record of the session
    holds frame and hand-eye transform, and compared with robot and rail if it holds those; the
    camera model is compared with the record's.

    Args:
        path: The dataset.
        on_shot: Told how many images are checked, of how many.

    Raises:
        DatasetError: The file cannot be opened; see ``Dataset``.
    """
    check_images = partial(images.images, on_shot=on_shot or _say_nothing)
    with Dataset(path) as dataset:
        found, unreadable = _said(dataset, (*_FOR_FINDINGS, check_images, images.references))
        notes, unreadable_too = _said(dataset, _FOR_NOTES)
    # What cannot be read hinders several checks and is said once.
    findings = dict.fromkeys((*found, *unreadable, *unreadable_too))
    return Examination(tuple(findings), tuple(notes))


def _said(dataset: Dataset, checks: Iterable[_Check]) -> tuple[list[str], list[str]]:
    """Give what the checks say, and what kept them from reading what they need."""
    said: list[str] = []
    unreadable: list[str] = []
    for check in checks:
        try:
            said += check(dataset)
        except IntegrityError as error:
            unreadable.append(images.sentence(dataset, error))
    return said, unreadable


def _say_nothing(n_done: int, n_all: int) -> None:
    del n_done, n_all
