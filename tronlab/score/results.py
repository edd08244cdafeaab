"""The files of a scoring: written whole, read back for the report."""

import hashlib
import json
import os
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import numpy as np
import pandas as pd

from tronlab.errors import ScoreError
from tronlab.geometry.poses import FloatArray, xyz_quat_from_pose
from tronlab.score.shot import CoreScore
from tronlab.score.statistics import Summary, summarise
from tronlab.score.table import COLUMNS, score_table

SCORES = "scores.csv"
SUMMARY = "summary.json"
MATCHES = "matches.h5"
INFO = "score.json"
PARTIAL_SCORES = "scores.partial.csv"
"""Rows of a scoring that was cut short; the next one that ends removes it."""


@dataclass(frozen=True, slots=True)
class ScoreResults:
    """A scoring as ``tronlab score`` left it in a folder."""

    directory: Path
    scores: pd.DataFrame
    """One row a shot and core; see ``tronlab.score.table.COLUMNS``."""
    summary: Summary
    """Core name to its statistics."""
    dataset_path: Path
    """The dataset that was scored; it may have moved since."""
    cores: tuple[str, ...]
    software: Mapping[str, str]
    """Versions of what shaped the numbers."""
    scored_utc: str
    """When, ISO 8601."""
    reasons: Mapping[tuple[str, int], str]
    """Why a core gave no pose, by core and shot id."""

    def uv_inliers(self, core: str, shot_id: int) -> FloatArray:
        """Read the image positions a pose rests on, shape (n, 2), pixels; empty without a pose."""
        with _matches(self.directory) as file:
            group = file.get(f"{core}/{shot_id}")
            return np.empty((0, 2)) if group is None else group["uv_inliers"][:].astype(np.float64)


def save_results(
    directory: Path, scores: Sequence[CoreScore], info: Mapping[str, Any]
) -> pd.DataFrame:
    """Write the files of a scoring beside the old ones, then put them in place.

    Args:
        directory: Where to; it exists.
        scores: In the order of the table.
        info: What ``score.json`` shall say.

    Returns:
        The table of scores.

    Raises:
        ScoreError: They cannot be written; the old files are as they were.
    """
    table = score_table(score.row for score in scores)
    try:
        with TemporaryDirectory(prefix=".score-", dir=directory) as staging:
            folder = Path(staging)
            table.to_csv(folder / SCORES, index=False)
            _write_json(folder / SUMMARY, summarise(table))
            _write_matches(folder / MATCHES, scores)
            names = (SCORES, SUMMARY, MATCHES)
            _write_json(folder / INFO, {**info, "sha256": {n: _sha256(folder / n) for n in names}})
            for name in (*names, INFO):
                os.replace(folder / name, directory / name)
        (directory / PARTIAL_SCORES).unlink(missing_ok=True)
    except OSError as error:
        raise ScoreError(f"{directory}: the scores cannot be written: {error}") from error
    return table


def save_partial(directory: Path, scores: Sequence[CoreScore]) -> Path:
    """Write the rows of a scoring that was cut short to a file of their own."""
    path = directory / PARTIAL_SCORES
    with TemporaryDirectory(prefix=".score-", dir=directory) as staging:
        written = Path(staging) / PARTIAL_SCORES
        score_table(score.row for score in scores).to_csv(written, index=False)
        os.replace(written, path)
    return path


def load_results(directory: Path) -> ScoreResults:
    """Read the files of a scoring.

    Raises:
        ScoreError: There are none, they are damaged, or they are not of one scoring.
    """
    if not (directory / SCORES).is_file():
        raise ScoreError(
            f"{directory}: no {SCORES} there; make it with: tronlab score DATASET.h5 --out"
            f" {directory}"
        )
    info = _read_json(directory / INFO)
    for name, digest in info.get("sha256", {}).items():
        if not (directory / name).is_file() or _sha256(directory / name) != digest:
            raise ScoreError(
                f"{directory / name}: missing, changed or of another scoring than {INFO};"
                " run tronlab score again"
            )
    try:
        return ScoreResults(
            directory=directory,
            scores=_read_scores(directory / SCORES),
            summary=_read_json(directory / SUMMARY),
            dataset_path=(directory / info["dataset"]).resolve(),
            cores=tuple(info["cores"]),
            software=info["software"],
            scored_utc=info["scored_utc"],
            reasons=_reasons(directory),
        )
    except KeyError as error:
        raise ScoreError(
            f"{directory / INFO}: {error} is missing; run tronlab score again"
        ) from error


def _read_scores(path: Path) -> pd.DataFrame:
    try:
        table = pd.read_csv(path, keep_default_na=False, na_values=[""])
        missing = [name for name in COLUMNS if name not in table.columns]
        if missing:
            raise ScoreError(f"{path}: columns are missing: {', '.join(missing)}")
        return table.reindex(columns=list(COLUMNS)).astype(COLUMNS)
    except (ValueError, TypeError, OSError) as error:
        raise ScoreError(f"{path}: is not a table of scores: {error}") from error


def _reasons(directory: Path) -> dict[tuple[str, int], str]:
    with _matches(directory) as file:
        return {
            (core, int(shot_id)): str(group.attrs["reason"])
            for core, shots in file.items()
            for shot_id, group in shots.items()
            if group.attrs["reason"]
        }


@contextmanager
def _matches(directory: Path) -> Generator[Any]:
    path = directory / MATCHES
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise ScoreError(f"{path}: cannot be read: {error}; run tronlab score again") from error
    with file:
        yield file


def _write_matches(path: Path, scores: Sequence[CoreScore]) -> None:
    with h5py.File(path, "w") as file:
        for score in scores:
            group = file.create_group(f"{score.core}/{score.shot_id}")
            group.attrs["status"] = score.result.status
            group.attrs["reason"] = score.result.reason
            uv = np.asarray(score.result.uv_inliers, np.float32)
            group.create_dataset("uv_inliers", data=uv).attrs["units"] = "px"
            if score.result.trs_from_cam is not None:
                pose = xyz_quat_from_pose(score.result.trs_from_cam)
                stored = group.create_dataset("trs_from_cam", data=pose)
                stored.attrs.update(parent="trs", child="cam", quaternion_order="xyzw")
            if score.result.covariance is not None:
                group.create_dataset("covariance", data=score.result.covariance)


def _write_json(path: Path, value: Mapping[str, Any]) -> None:
    text = json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")


def _read_json(path: Path) -> Any:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ScoreError(f"{path}: cannot be read: {error}; run tronlab score again") from error
    if not isinstance(value, dict):
        raise ScoreError(f"{path}: is not a JSON object; run tronlab score again")
    return value


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
