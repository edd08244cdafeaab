"""What a study left in its folder, read back for its page; parts that are missing are named."""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from tronlab.errors import ScoreError
from tronlab.report.paper import DATASETS
from tronlab.score.results import SCORES
from tronlab.score.table import COLUMNS, with_all_columns

STUDY_INFO = "study.json"
DATASETS_FOLDER, LARGER_FOLDER = "datasets", "larger"
_ALL = tuple(DATASETS)
_TABLES: Mapping[str, str] = {
    "ablation": "ablation/ablation.csv",
    "shares": "ablation/shares.csv",
    "limits": "limits/limits.csv",
    "selection": "selection/selection.csv",
    "load": "load/load.csv",
    "perturbation": "perturbation/perturbation.csv",
    "rank": "perturbation/rank.csv",
    "worst": "worst/worst.csv",
}
"""Tables of a study by the name of their part."""


@dataclass(frozen=True, slots=True)
class StudyResults:
    """The tables of a study."""

    folder: Path
    info: Mapping[str, Any]
    """What ``study.json`` says; empty if it is not there."""
    datasets: Mapping[str, pd.DataFrame]
    """Scores by dataset, in the paper's order; only those that there are."""
    larger: Mapping[str, pd.DataFrame]
    """The same with the larger terrain."""
    tables: Mapping[str, pd.DataFrame]
    """By part: ``ablation``, ``shares``, ``limits``, ``selection``, ``load``, ``perturbation``,
    ``rank``, ``worst``; only those that there are."""

    @property
    def is_quick(self) -> bool:
        """Get whether parts were left out on purpose."""
        return bool(self.info.get("quick", False))

    @property
    def missing(self) -> tuple[str, ...]:
        """Get what is not there, as people read it."""
        sets = [
            f"scores of {DATASETS[name].title}" for name in DATASETS if name not in self.datasets
        ]
        larger = [] if self.larger else ["the larger terrain"]
        tables = [f"the table {_TABLES[name]}" for name in _TABLES if name not in self.tables]
        return (*sets, *larger, *tables)

    @property
    def scores(self) -> pd.DataFrame:
        """Get the scores of all datasets, with the column ``dataset``.

        Raises:
            ScoreError: There are none.
        """
        if not self.datasets:
            raise ScoreError(f"{self.folder}: holds no scores of any dataset of the paper")
        return pd.concat(
            [scores.assign(dataset=name) for name, scores in self.datasets.items()],
            ignore_index=True,
        )

    @property
    def cores(self) -> tuple[str, ...]:
        """Get the cores in the order of the scores."""
        return tuple(dict.fromkeys(map(str, self.scores["core"])))


def read_study(
    folder: Path, *, datasets: Collection[str] = _ALL, larger: Collection[str] = _ALL
) -> StudyResults:
    """Read the tables of a study.

    Args:
        folder: Its folder.
        datasets: Those it has; scores of others, left from an earlier study, are not looked at.
        larger: Likewise with the larger terrain.

    Raises:
        ScoreError: A file cannot be read as what it should be.
    """
    info = folder / STUDY_INFO
    return StudyResults(
        folder=folder,
        info=_read_json(info) if info.is_file() else {},
        datasets=_read_all_scores(folder / DATASETS_FOLDER, datasets),
        larger=_read_all_scores(folder / LARGER_FOLDER, larger),
        tables={
            name: _read_csv(folder / path)
            for name, path in _TABLES.items()
            if (folder / path).is_file()
        },
    )


def select(frame: pd.DataFrame, **wanted: object) -> pd.DataFrame:
    """Give the rows of a table whose columns have these values."""
    for column, value in wanted.items():
        frame = frame[frame[column] == value]
    return frame


def check_columns(frame: pd.DataFrame, columns: Sequence[str], *, what: str) -> None:
    """Refuse a table that lacks columns.

    Raises:
        ScoreError: It names them.
    """
    missing = [name for name in columns if name not in frame.columns]
    if missing:
        raise ScoreError(f"{what}: columns are missing: {', '.join(missing)}")


def _read_all_scores(folder: Path, names: Collection[str]) -> dict[str, pd.DataFrame]:
    paths = {name: folder / name / SCORES for name in DATASETS if name in names}
    return {name: _read_scores(path) for name, path in paths.items() if path.is_file()}


def _read_scores(path: Path) -> pd.DataFrame:
    scores = with_all_columns(_read_csv(path))
    check_columns(scores, list(COLUMNS), what=str(path))
    if scores.empty:
        raise ScoreError(f"{path}: holds no scores; run the study again")
    return scores


def _read_csv(path: Path) -> pd.DataFrame:
    try:
        return pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise ScoreError(f"{path}: is not a table: {error}; run the study again") from error


def _read_json(path: Path) -> Mapping[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ScoreError(f"{path}: cannot be read: {error}; run the study again") from error
    if not isinstance(value, dict):
        raise ScoreError(f"{path}: is not a JSON object; run the study again")
    return value
