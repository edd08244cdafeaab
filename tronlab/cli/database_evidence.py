"""What scores say of a database's landmarks: in which shots a right pose rested on them."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tronlab.dataset.reader import Dataset
from tronlab.errors import ScoreError
from tronlab.nav.database import Database
from tronlab.nav.database_file import Counts
from tronlab.nav.pruning import Tally
from tronlab.score.results import MATCHES, load_results


@dataclass(frozen=True, slots=True)
class Evidence:
    """The counts, and whose they are."""

    counts: Counts
    datasets: tuple[str, ...]
    """Uuids."""
    n_shots: int


def gather(
    database: Database,
    folders: Sequence[Path],
    *,
    max_error_pct: float,
    on_shot: Callable[[int, int], None],
) -> Evidence:
    """Count how the landmarks did in scores.

    Args:
        database: The landmarks.
        folders: Results of ``tronlab score`` with this database.
        max_error_pct: Largest error of position, in per cent of the line of sight, of a pose that
            counts as right.
        on_shot: Told (shots done, shots in all).

    Raises:
        ScoreError: A folder has no results, none with this database, or no right pose; or a dataset
            is no longer the one that was scored.
        DatasetError: A dataset that was scored cannot be read.
    """
    of_datasets: dict[Path, dict[int, list[NDArray[np.intp]]]] = {}
    for folder in folders:
        path, verified = _verified(folder, database, max_error_pct=max_error_pct)
        shots = of_datasets.setdefault(path, defaultdict(list))
        for shot_id, landmarks in verified.items():
            shots[shot_id].append(landmarks)
    n_all, n_done = sum(map(len, of_datasets.values())), 0
    tally, uuids = Tally(database), list[str]()
    for path, shots in of_datasets.items():
        with Dataset(path) as dataset:
            uuids.append(dataset.uuid or f"plan {dataset.provenance.plan_sha256}")
            rows = {int(shot_id): i for i, shot_id in enumerate(dataset.shot_ids)}
            for shot_id, landmarks in shots.items():
                if shot_id not in rows:
                    raise ScoreError(
                        f"{path}: has no shot {shot_id}, which was scored: it is not the dataset it"
                        " was then; score it again"
                    )
                i = rows[shot_id]
                truth = dataset.truth(i).trs_from_cam
                tally.add(dataset.camera, truth, dataset.mask(i), np.concatenate(landmarks))
                n_done += 1
                on_shot(n_done, n_all)
    return Evidence(tally.counts, tuple(dict.fromkeys(uuids)), n_done)


def _verified(
    folder: Path, database: Database, *, max_error_pct: float
) -> tuple[Path, dict[int, NDArray[np.intp]]]:
    """Give the dataset of a scoring, and by shot the landmarks that right poses rest on."""
    results = load_results(folder)
    table = results.scores
    is_right = (table["status"] == "ok") & (table["position_error_pct_los"] <= max_error_pct)
    found: dict[int, list[NDArray[np.intp]]] = defaultdict(list)
    others: set[str] = set()
    right = set(table.loc[is_right, ["core", "seed", "shot_id"]].itertuples(index=False, name=None))
    for answer in results.answers():
        if (answer.core, answer.seed, answer.shot_id) not in right:
            continue
        if answer.database == database.digest:
            found[answer.shot_id].append(answer.landmark_inliers)
        else:
            others.add(answer.database)
    if not found:
        raise ScoreError(_nothing(folder, database, n_right=len(right), others=others))
    merged = {shot_id: np.concatenate(landmarks) for shot_id, landmarks in found.items()}
    if max(int(landmarks.max(initial=-1)) for landmarks in merged.values()) >= len(database):
        raise ScoreError(f"{folder / MATCHES}: names landmarks that the database does not have")
    return results.dataset_path, merged


def _nothing(folder: Path, database: Database, *, n_right: int, others: set[str]) -> str:
    if not n_right:
        return f"{folder}: no pose there is right: there is nothing to learn from it"
    digests = ", ".join(sorted(other[:12] for other in others if other)) or "none that has a digest"
    return (
        f"{folder}: no right pose there rests on this database ({database.digest[:12]}); the cores"
        f" used {digests}: score again with --database and this file"
    )
