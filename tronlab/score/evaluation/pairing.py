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
_POSE = "truth_crc"


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
    cores = tuple(dict.fromkeys(cores))
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


def left_out(
    results: Sequence[ScoreResults], pairs: Sequence[RunPair], cores: Sequence[str] = ()
) -> list[str]:
    """Name what was to be looked at and is in no pair, as a core that only one folder has."""
    paired = {(run.folder, run.core) for pair in pairs for run in (pair.base, pair.other)}
    return [
        f"{core} of {r.directory}"
        for r in results
        for core in _runs(r, cores)
        if (str(r.directory), core) not in paired
    ]


def check_same_truth(base: ScoreResults, other: ScoreResults) -> None:
    """Refuse scores of different shots.

    Raises:
        ScoreError: The shots are not the same, or one has another truth: pose, sigma, range, or
            what is seen of the terrain.
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
    difference = _difference(ours, theirs.loc[ours.index])
    if difference:
        raise ScoreError(
            f"{base.directory} and {other.directory}: the truth differs: {difference}; the datasets"
            " are different ones, or truth was recomputed: score both anew with tronlab score"
        )


def _truth(scores: pd.DataFrame) -> pd.DataFrame:
    return scores.drop_duplicates("shot_id").set_index("shot_id")[[*_TRUTH, _POSE]].sort_index()


def _difference(ours: pd.DataFrame, theirs: pd.DataFrame) -> str:
    """Say in what the truth of the same shots differs; empty if in nothing.

    A table of an earlier version knows neither sigma (NaN) nor checksum (0): no difference.
    """
    for name in _TRUTH:
        a, b = ours[name].to_numpy(np.float64), theirs[name].to_numpy(np.float64)
        differs = np.abs(a - b) > _SAME * np.abs(a)
        if differs.any():
            i = int(differs.argmax())
            return f"{name} of shot {ours.index[i]} is {a[i]:.9g} and {b[i]:.9g}"
    a, b = ours[_POSE].to_numpy(np.int64), theirs[_POSE].to_numpy(np.int64)
    differs = (a != b) & (a != 0) & (b != 0)
    return f"shot {ours.index[differs.argmax()]} has another pose" if differs.any() else ""


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
