"""Which scorings are compared with which: of the same shots with the same truth only."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from tronlab.errors import ScoreError
from tronlab.score.results import ScoreResults

_SAME = 1e-9
"""Relative difference up to which two numbers of the truth are the same number."""
_TRUTH = ("range_los_m", "usable_fraction", "sigma_truth_m")


@dataclass(frozen=True, slots=True)
class Run:
    """What one core made of all shots in one scoring."""

    folder: str
    core: str
    rows: pd.DataFrame
    """Its rows of ``scores.csv``."""


@dataclass(frozen=True, slots=True)
class RunPair:
    """Two runs over the same shots."""

    base: Run
    other: Run

    @property
    def name(self) -> str:
        """Get what tells it from the other pairs of a comparison."""
        if self.base.core == self.other.core:
            return f"{self.other.core}: {self.base.folder} to {self.other.folder}"
        return f"{self.base.core} to {self.other.core}"


def pair_runs(results: Sequence[ScoreResults], cores: Sequence[str] = ()) -> list[RunPair]:
    """Choose what to compare.

    One folder: the first core named, else the first of its table, is the base of all others.
    Several folders: the first is the base, and each core is compared with itself in the others. If
    no core is in two folders, the cores named are compared, the first one being the base.

    Args:
        results: Of each folder.
        cores: The cores to look at; by default all.

    Raises:
        ScoreError: A core is in none of the folders, there is nothing to compare, or two folders
            hold scores of different shots, or of another truth.
    """
    folders = [str(r.directory) for r in results]
    for other in results[1:]:
        check_same_truth(results[0], other)
    runs = [_runs(r, cores) for r in results]
    there = {core for of_folder in runs for core in of_folder}
    missing = [core for core in cores if core not in there]
    if missing:
        raise ScoreError(
            f"{', '.join(folders)}: no scores of {', '.join(missing)};"
            f" there are: {', '.join(sorted({c for r in results for c in _cores_of(r)}))}"
        )
    pairs = [
        RunPair(base, of_folder[core])
        for of_folder in runs[1:]
        for core, base in runs[0].items()
        if core in of_folder
    ] or _pairs_of_cores(runs, cores)
    if not pairs:
        raise ScoreError(
            f"{', '.join(folders)}: nothing to compare: name folders with a core in common, or a"
            " folder with two cores, or two cores with --core"
        )
    return pairs


def check_same_truth(base: ScoreResults, other: ScoreResults) -> None:
    """Refuse scores of different shots.

    Raises:
        ScoreError: The shots are not the same, or one has another truth.
    """
    ours, theirs = _truth(base.scores), _truth(other.scores)
    odd = ours.index.symmetric_difference(theirs.index)
    if len(odd):
        where = base.directory if odd[0] in ours.index else other.directory
        raise ScoreError(
            f"{base.directory} and {other.directory}: hold scores of different datasets: shot"
            f" {odd[0]} is in {where} only ({len(ours)} and {len(theirs)} shots);"
            " compare scorings of the same dataset"
        )
    a, b = ours.to_numpy(np.float64), theirs.loc[ours.index].to_numpy(np.float64)
    # A table of an earlier version does not know the sigma: NaN is no difference.
    differs = np.abs(a - b) > _SAME * np.abs(a)
    if differs.any():
        row, column = np.argwhere(differs)[0]
        raise ScoreError(
            f"{base.directory} and {other.directory}: the truth differs: {_TRUTH[column]} of shot"
            f" {ours.index[row]} is {a[row, column]:.9g} and {b[row, column]:.9g}; the datasets are"
            " different ones, or truth was recomputed: score both anew with tronlab score"
        )


def _truth(scores: pd.DataFrame) -> pd.DataFrame:
    return scores.drop_duplicates("shot_id").set_index("shot_id")[list(_TRUTH)].sort_index()


def _runs(results: ScoreResults, cores: Sequence[str]) -> dict[str, Run]:
    scores = results.scores
    return {
        core: Run(str(results.directory), core, scores[scores["core"] == core])
        for core in (cores or _cores_of(results))
        if core in _cores_of(results)
    }


def _cores_of(results: ScoreResults) -> list[str]:
    return [str(core) for core in results.scores["core"].unique()]


def _pairs_of_cores(runs: Sequence[dict[str, Run]], cores: Sequence[str]) -> list[RunPair]:
    if len(runs) > 1 and not cores:
        return []
    first_of: dict[str, Run] = {}
    for of_folder in runs:
        for core, run in of_folder.items():
            first_of.setdefault(core, run)
    ordered = [first_of[core] for core in (cores or first_of)]
    return [RunPair(ordered[0], other) for other in ordered[1:]]
