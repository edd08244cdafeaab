"""Scoring a recorded dataset against navigation cores."""

import os
import platform
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from tronlab.dataset.reader import Dataset
from tronlab.errors import ScoreError
from tronlab.nav.cores import BUILT_IN_CORES, known_cores
from tronlab.score.results import SCORES, save_partial, save_results
from tronlab.score.shot import CoreScore
from tronlab.score.workers import score_shots

Progress = Callable[[int, int], None]
"""Told how many shots are done, and of how many."""

_SOFTWARE = ("tronlab", "numpy", "scipy", "opencv-contrib-python-headless")


@dataclass(frozen=True, slots=True)
class _Job:
    dataset_path: Path
    cores: tuple[str, ...]
    shot_ids: tuple[int, ...]
    out_dir: Path
    n_workers: int


def score_dataset(
    dataset_path: Path,
    *,
    cores: Sequence[str] | None = None,
    out_dir: Path | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    announce: Callable[[str], None] | None = None,
) -> pd.DataFrame:
    """Score every shot with every core; write the table, its summary and the matches.

    The files of an earlier scoring are replaced when this one is complete, never before.

    Args:
        dataset_path: The dataset.
        cores: Names of cores; by default those the dataset's campaign names, else all built-in.
        out_dir: Folder of the results; by default that of the dataset.
        workers: Number of processes; by default as many as there are processors.
        progress: Told how far it is.
        announce: Told what a person should know.

    Returns:
        The table of scores, ordered by core (as asked for) and shot id.

    Raises:
        DatasetError: The dataset cannot be read.
        ScoreError: An unknown core, nothing to score, or results that cannot be written.
        KeyboardInterrupt: Its text says where the rows scored so far are.
    """
    say = announce or _keep_quiet
    job = _job(dataset_path, cores=cores, out_dir=out_dir, workers=workers, say=say)
    scores = _score(job, progress or _no_progress)
    is_replacing = (job.out_dir / SCORES).exists()
    table = save_results(job.out_dir, scores, _info(job))
    if is_replacing:
        say(f"{job.out_dir / SCORES}: replaced that of an earlier scoring")
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
    say: Callable[[str], None],
) -> _Job:
    n_workers = (os.cpu_count() or 1) if workers is None else workers
    if n_workers < 1:
        raise ScoreError(f"workers is {n_workers}, must be 1 or more")
    with Dataset(dataset_path) as dataset:
        if not dataset.n_shots:
            raise ScoreError(f"{dataset_path}: holds no shots: there is nothing to score")
        n_planned = dataset.provenance.n_shots_planned
        if dataset.n_shots < n_planned:
            say(f"{dataset_path}: is incomplete: {dataset.n_shots} of {n_planned} shots")
        names = tuple(dict.fromkeys(cores or campaign_cores(dataset.provenance.campaign_yaml)))
        shot_ids = tuple(int(shot_id) for shot_id in dataset.shot_ids)
    _check_known(names)
    return _Job(dataset_path, names, shot_ids, _folder(out_dir, dataset_path), n_workers)


def _check_known(names: Sequence[str]) -> None:
    known = known_cores()
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ScoreError(
            f"no navigation core {', '.join(map(repr, unknown))};"
            f" known cores: {', '.join(sorted(known)) or 'none'}"
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


def _score(job: _Job, progress: Progress) -> list[CoreScore]:
    """Score all shots, and put them in order whatever order they were done in."""
    n_shots = len(job.shot_ids)
    done: dict[int, list[CoreScore]] = {}
    progress(0, n_shots)
    working = score_shots(job.dataset_path, job.cores, n_shots=n_shots, n_workers=job.n_workers)
    try:
        with closing(working):
            for i, scores in working:
                done[i] = scores
                progress(len(done), n_shots)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(_keep_what_is_done(job, done)) from None
    return _in_order(job, done)


def _in_order(job: _Job, done: dict[int, list[CoreScore]]) -> list[CoreScore]:
    by_id = sorted(done, key=lambda i: job.shot_ids[i])
    return [done[i][k] for k in range(len(job.cores)) for i in by_id]


def _keep_what_is_done(job: _Job, done: dict[int, list[CoreScore]]) -> str:
    text = f"interrupted: {len(done)} of {len(job.shot_ids)} shots were scored"
    if not done:
        return f"{text}; nothing was written"
    return f"{text}; their rows are in {save_partial(job.out_dir, _in_order(job, done))}"


def _info(job: _Job) -> dict[str, Any]:
    return {
        "dataset": os.path.relpath(job.dataset_path, job.out_dir),
        "cores": list(job.cores),
        "n_shots": len(job.shot_ids),
        "scored_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "software": {"python": platform.python_version()}
        | {name: version(name) for name in _SOFTWARE},
    }


def _keep_quiet(_text: str) -> None:
    pass


def _no_progress(_n_done: int, _n_all: int) -> None:
    pass
