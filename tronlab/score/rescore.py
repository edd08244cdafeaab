"""Scoring a recorded dataset against navigation cores."""

import os
import platform
import re
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from tronlab.dataset.drift import doubts
from tronlab.dataset.reader import Dataset
from tronlab.dataset.schema import TRUTH
from tronlab.errors import ScoreError, TronlabError
from tronlab.nav.cores import BUILT_IN_CORES, known_cores
from tronlab.score.results import (
    SCORES,
    ScoreResults,
    earlier_results,
    kept_cores,
    save_partial,
    save_results,
)
from tronlab.score.shot import CoreScore
from tronlab.score.workers import score_shots

Announce = Callable[[str], None]
Progress = Callable[[int, int], None]
"""Told how many shots are done, and of how many."""

_SOFTWARE = ("tronlab", "numpy", "scipy", "opencv-contrib-python-headless")

_CORE_NAME = re.compile(r"[A-Za-z0-9_:-][A-Za-z0-9._:-]*")
"""A core's name is the name of a group in matches.h5, where a slash or a first dot is a path."""


@dataclass(frozen=True, slots=True)
class _Job:
    dataset_path: Path
    cores: tuple[str, ...]
    range_los_m: Mapping[int, float]
    """Line of sight of each shot, by shot id, in the dataset's order."""
    out_dir: Path
    n_workers: int


def score_dataset(
    dataset_path: Path,
    *,
    cores: Sequence[str] | None = None,
    out_dir: Path | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    announce: Announce | None = None,
) -> pd.DataFrame:
    """Score every shot with every core; write the table, its summary and the matches.

    Results of the same dataset that are there already stay for cores that are not scored anew.
    Files are replaced when this scoring is complete, never before.

    Args:
        dataset_path: The dataset.
        cores: Names of cores; by default those the dataset's campaign names, else all built-in.
        out_dir: Folder of the results; by default that of the dataset.
        workers: Number of processes; by default as many as there are processors.
        progress: Told how far it is.
        announce: Told what a person should know.

    Returns:
        The table of scores, ordered by core (those already there, then as asked for) and shot id.

    Raises:
        DatasetError: The dataset cannot be read.
        ScoreError: An unknown core, nothing to score, a folder with results of another dataset,
            results that cannot be written, or a scoring that was cut short: its text then says
            where the rows scored so far are.
        KeyboardInterrupt: Its text says where the rows scored so far are.
    """
    say = announce or _keep_quiet
    job = _job(dataset_path, cores=cores, out_dir=out_dir, workers=workers, say=say)
    _earlier(job, say)
    done: dict[int, list[CoreScore]] = {}
    with _rows_kept_if_cut_short(job, done):
        _score(job, done, progress or _no_progress)
        # Read again: another core may have been scored into the same folder meanwhile.
        earlier = _earlier(job, _keep_quiet)
        table = save_results(job.out_dir, _in_order(job, done), _info(job), earlier=earlier)
    _say_what_stays(job, earlier, say)
    return table


def campaign_cores(campaign_yaml: str) -> tuple[str, ...]:
    """Give the cores a campaign names under ``score: cores``, else all built-in ones."""
    try:
        campaign = YAML(typ="safe", pure=True).load(campaign_yaml)
    except YAMLError:
        return BUILT_IN_CORES
    section = campaign.get("score") if isinstance(campaign, dict) else None
    named = section.get("cores") if isinstance(section, dict) else None
    return tuple(str(name) for name in named) if isinstance(named, list) else BUILT_IN_CORES


def _job(
    dataset_path: Path,
    *,
    cores: Sequence[str] | None,
    out_dir: Path | None,
    workers: int | None,
    say: Announce,
) -> _Job:
    n_workers = _n_processors() if workers is None else workers
    if n_workers < 1:
        raise ScoreError(f"workers is {n_workers}, must be 1 or more")
    with Dataset(dataset_path) as dataset:
        if not dataset.n_shots:
            raise ScoreError(f"{dataset_path}: holds no shots: there is nothing to score")
        n_planned = dataset.provenance.n_shots_planned
        if dataset.n_shots < n_planned:
            say(f"{dataset_path}: is incomplete: {dataset.n_shots} of {n_planned} shots")
        if dataset.drift_checks:
            for doubt in doubts(dataset.shot_ids.tolist(), dataset.truth_states):
                say(f"{dataset_path}: {doubt}; scored and flagged like that")
        names = tuple(dict.fromkeys(cores or campaign_cores(dataset.provenance.campaign_yaml)))
        ranges_m = dataset.rows(f"{TRUTH}/range_los_m").tolist()
        range_los_m = dict(zip(dataset.shot_ids.tolist(), ranges_m, strict=True))
    _check_names(names)
    return _Job(dataset_path, names, range_los_m, _folder(out_dir, dataset_path), n_workers)


def _n_processors() -> int:
    """Give how many processors this process may use: a container often has fewer than it sees."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _check_names(names: Sequence[str]) -> None:
    known = known_cores()
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ScoreError(
            f"no navigation core {', '.join(map(repr, unknown))};"
            f" known cores: {', '.join(sorted(known)) or 'none'}"
        )
    odd = [name for name in names if not _CORE_NAME.fullmatch(name)]
    if odd:
        raise ScoreError(
            f"navigation core {', '.join(map(repr, odd))}: its results cannot be filed under this"
            " name: a name has letters, digits and . _ - : only, and does not begin with a dot;"
            " register the core under another"
        )


def _folder(out_dir: Path | None, dataset_path: Path) -> Path:
    folder = dataset_path.parent if out_dir is None else out_dir
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScoreError(f"{folder}: the results cannot go there: {error}") from error
    if not os.access(folder, os.W_OK):
        raise ScoreError(f"{folder}: cannot be written to; name another folder with --out")
    return folder


def _earlier(job: _Job, say: Announce) -> ScoreResults | None:
    return earlier_results(
        job.out_dir,
        dataset_path=job.dataset_path,
        cores=job.cores,
        range_los_m=job.range_los_m,
        say=say,
    )


def _score(job: _Job, done: dict[int, list[CoreScore]], progress: Progress) -> None:
    """Score all shots; put what is done into ``done``, by index, in whatever order."""
    n_shots = len(job.range_los_m)
    progress(0, n_shots)
    working = score_shots(job.dataset_path, job.cores, n_shots=n_shots, n_workers=job.n_workers)
    with closing(working):
        for i, scores in working:
            done[i] = scores
            progress(len(done), n_shots)


def _in_order(job: _Job, done: dict[int, list[CoreScore]]) -> list[CoreScore]:
    by_id = sorted(done, key=list(job.range_los_m).__getitem__)
    return [done[i][k] for k in range(len(job.cores)) for i in by_id]


@contextmanager
def _rows_kept_if_cut_short(job: _Job, done: dict[int, list[CoreScore]]) -> Generator[None]:
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted: {_keep_what_is_done(job, done)}") from None
    except TronlabError as error:
        if not done:
            raise
        raise ScoreError(f"{error}\n{_keep_what_is_done(job, done)}") from error


def _keep_what_is_done(job: _Job, done: dict[int, list[CoreScore]]) -> str:
    text = f"{len(done)} of {len(job.range_los_m)} shots were scored"
    if not done:
        return f"{text}; nothing was written"
    try:
        return f"{text}; their rows are in {save_partial(job.out_dir, _in_order(job, done))}"
    except OSError as error:
        return f"{text}; their rows cannot be written: {error}"


def _say_what_stays(job: _Job, earlier: ScoreResults | None, say: Announce) -> None:
    if earlier is None:
        return
    kept = kept_cores(earlier, job.cores)
    replaced = [name for name in job.cores if name in earlier.summary]
    parts = (("kept", kept), ("replaced", replaced))
    text = "; ".join(f"{verb} {', '.join(names)}" for verb, names in parts if names)
    say(f"{job.out_dir / SCORES}: of the earlier scoring: {text}")


def _info(job: _Job) -> dict[str, Any]:
    return {
        "dataset": os.path.relpath(job.dataset_path.resolve(), job.out_dir.resolve()),
        "cores": list(job.cores),
        "n_shots": len(job.range_los_m),
        "scored_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "software": {"python": platform.python_version()}
        | {name: version(name) for name in _SOFTWARE},
    }


def _keep_quiet(_text: str) -> None:
    pass


def _no_progress(_n_done: int, _n_all: int) -> None:
    pass
