"""The dataset behind the scores. It may have moved or be damaged: the scores still stand."""

import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tronlab.dataset.drift import doubts
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Provenance
from tronlab.dataset.schema import TRUTH
from tronlab.errors import DatasetError
from tronlab.score.results import ScoreResults

USUAL_NAME = "dataset.h5"
_RANGE_TOLERANCE_M = 1e-6
"""Ranges that differ by more are of another recording; text keeps far more digits."""


@dataclass(frozen=True, slots=True)
class ShotImage:
    """The photograph of one shot."""

    image: NDArray[np.uint8] | NDArray[np.uint16]
    """Grey values, shape (rows, columns)."""
    mask: NDArray[np.bool_]
    """True where the model is seen, same shape."""


@dataclass(frozen=True, slots=True)
class Recording:
    """What the report takes from the dataset."""

    facts: tuple[tuple[str, str], ...] = ()
    """How the dataset came about, as pairs of name and value."""
    documents: Mapping[str, str] = field(default_factory=dict[str, str])
    """Whole texts by name: campaign, rig and calibration."""
    images: Mapping[int, ShotImage] = field(default_factory=dict[int, ShotImage])
    """The photographs asked for, by shot id."""
    missing: str = ""
    """Why there is nothing; empty if there is."""


def read_recording(results: ScoreResults, shot_ids: Collection[int]) -> Recording:
    """Read what the report shows of the dataset that was scored.

    Args:
        results: The scoring.
        shot_ids: The shots to read photographs of.

    Returns:
        The recording; without a readable dataset, only why.
    """
    try:
        with Dataset(dataset_behind(results)) as dataset:
            rows = _checked_rows(dataset, results)
            return Recording(
                facts=_facts(dataset),
                documents=_documents(dataset.provenance),
                images={
                    shot_id: ShotImage(dataset.image(rows[shot_id]), dataset.mask(rows[shot_id]))
                    for shot_id in shot_ids
                },
            )
    except DatasetError as error:
        return Recording(missing=str(error))


def dataset_behind(results: ScoreResults) -> Path:
    """Give the dataset where it was scored, else beside the scores: folders are moved whole."""
    beside = results.directory / USUAL_NAME
    return (
        beside
        if not results.dataset_path.is_file() and beside.is_file()
        else (results.dataset_path)
    )


def _checked_rows(dataset: Dataset, results: ScoreResults) -> dict[int, int]:
    """Give the row of each shot id, once it is sure that this dataset was scored.

    Raises:
        DatasetError: Another dataset lies in its place.
    """
    rows = {int(shot_id): row for row, shot_id in enumerate(dataset.shot_ids)}
    ranges_m = dataset.rows(f"{TRUTH}/range_los_m")
    shot_ids = results.scores["shot_id"].tolist()
    scored_m = results.scores["range_los_m"].tolist()
    for shot_id, range_m in zip(shot_ids, scored_m, strict=True):
        is_there = shot_id in rows
        if not is_there or abs(ranges_m[rows[shot_id]] - range_m) > _RANGE_TOLERANCE_M:
            raise DatasetError(
                f"{dataset.path}: is not the dataset that was scored: shot {shot_id}"
                f" {'has another range' if is_there else 'is not in it'}; run tronlab score again"
            )
    return rows


def _facts(dataset: Dataset) -> tuple[tuple[str, str], ...]:
    provenance = dataset.provenance
    status = f"{dataset.status}: {dataset.reason}" if dataset.reason else dataset.status
    return (
        ("campaign", provenance.campaign_name),
        ("rig", provenance.rig_name),
        ("seed", str(provenance.seed)),
        ("recorded", f"{dataset.start_time} to {dataset.end_time or 'no known end'}"),
        ("status of the recording", status),
        ("shots recorded", f"{dataset.n_shots} of {provenance.n_shots_planned} planned"),
        ("reference views", str(dataset.n_references)),
        *_trust(dataset),
        ("plan, SHA-256", provenance.plan_sha256),
        *((f"device {name}", text) for name, text in sorted(provenance.devices.items())),
        *((f"recorded with {name}", text) for name, text in sorted(provenance.software.items())),
    )


def _trust(dataset: Dataset) -> Iterator[tuple[str, str]]:
    """Give what is known about whether truth can be trusted."""
    checks = dataset.drift_checks
    if checks:
        largest = max(checks, key=lambda check: check.max_shift_m)
        yield (
            "drift checks",
            f"{len(checks)}; the model seemed to move by {largest.max_shift_m * 1e3:.3f} mm at"
            f" most, allowed are {largest.limit_m * 1e3:g} mm",
        )
        doubted = doubts(dataset.shot_ids.tolist(), dataset.truth_states)
        yield "truth", "; ".join(doubted) or "no shot is in doubt"
    else:
        yield "drift checks", "none: the truth of no shot is vouched for"
    provenance = dataset.provenance
    for text in provenance.accepted:
        yield "accepted", text
    if provenance.recomputation is not None:
        yield (
            "truth recomputed",
            f"{provenance.recomputation.time_utc} from {provenance.recomputation.dataset_name}"
            f" (SHA-256 {provenance.recomputation.dataset_sha256})",
        )


def _documents(provenance: Provenance) -> dict[str, str]:
    return {
        "Campaign": provenance.campaign_yaml,
        "Rig": provenance.rig_yaml,
        "Calibration record, without the measurements it was solved from": _without_inputs(
            provenance.calibration_json
        ),
    }


def _without_inputs(calibration_json: str) -> str:
    """Leave out the measurements: megabytes that the dataset keeps."""
    try:
        record = json.loads(calibration_json)
    except json.JSONDecodeError:
        return calibration_json
    if isinstance(record, dict):
        record.pop("inputs", None)
    return json.dumps(record, indent=1, ensure_ascii=False)
