"""Databases of the landmarks that a way of choosing keeps."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tronlab.campaign.live import Live
from tronlab.dataset.reader import Dataset
from tronlab.geometry.poses import FloatArray
from tronlab.nav.database import Database, landmarks_of_view
from tronlab.nav.database_file import DatabaseFile, Pruning, Source, read_database_file
from tronlab.nav.database_writer import new_database, save_selection
from tronlab.nav.features import make_detector
from tronlab.nav.pruning import Tally, place_in_view, preferred_part
from tronlab.nav.settings import DetectorSettings, core_settings
from tronlab.score.results import load_results
from tronlab.study.config import SelectionVariant

CELL_M: Final = 0.05
"""Side of the cells of the ground that give their landmarks in turns."""
RIGHT_PCT_LOS: Final = 1.0
"""Largest error of a pose that landmarks verify with, in per cent of the line of sight."""
HALVES: Final = ("even", "odd")
"""A landmark that is chosen by scores is never tried on the shots that chose it."""
_SEED: Final = 7


@dataclass(frozen=True, slots=True)
class PrunedDatabase:
    """A file of landmarks that a variant is scored with."""

    variant: str
    core: str
    """The name its scores carry."""
    path: Path


def half_name(variant: str, half: str) -> str:
    """Give the name of the scores of a variant whose landmarks the other half of shots chose."""
    return f"{variant}:{half}"


def pruned_databases(
    variants: Mapping[str, SelectionVariant], recording: Path, folder: Path, *, live: Live
) -> list[PrunedDatabase]:
    """Make the databases of all variants that keep a part of the landmarks.

    Args:
        variants: All variants.
        recording: The dataset, whose reference views have the landmarks.
        folder: Scores of the bases on it; the files go there, too.
        live: Told how far it is.

    Raises:
        DatasetError: The dataset cannot be read, or a file cannot be made.
        ScoreError: Too few landmarks are left.
    """
    pruning = {name: variant for name, variant in variants.items() if variant.prune_to is not None}
    made: list[PrunedDatabase] = []
    for n_done, (name, variant) in enumerate(pruning.items()):
        live.advance("choose landmarks", n_done=n_done, n_all=len(pruning))
        source = _all_landmarks(recording, _detector_of(variant), folder)
        if variant.prune_by == "scores":
            for half, preference in _by_scores(variant.base, source.database, recording, folder):
                core = half_name(name, half)
                path = folder / f"{name}-{half}.h5"
                _save(source, variant, preference, path, recording)
                made.append(PrunedDatabase(name, core, path))
        else:
            path = folder / f"{name}.h5"
            _save(source, variant, _preference(variant, source.database), path, None)
            made.append(PrunedDatabase(name, name, path))
    return made


def _detector_of(variant: SelectionVariant) -> DetectorSettings:
    detector = core_settings(variant.base, variant.settings).detector
    if variant.prune_by != "strength":
        return detector
    # The landmarks of a view then come in the order of their strength.
    return detector.model_copy(update={"cell_px": None})


def _all_landmarks(recording: Path, settings: DetectorSettings, folder: Path) -> DatabaseFile:
    """Find the landmarks of the reference views, or take those found for another variant."""
    cells = "anywhere" if settings.cell_px is None else f"{settings.cell_px:g}px"
    path = folder / f"landmarks-{settings.features}-{cells}.h5"
    if not path.exists():
        detector = make_detector(settings)
        with Dataset(recording) as dataset, new_database(path, settings) as writer:
            writer.sources.append(
                Source(
                    kind="dataset",
                    name=recording.name,
                    identity=_identity(dataset),
                    camera=dataset.camera.to_dict(),
                    rig=dataset.provenance.rig_name,
                    views="reference views of the dataset",
                )
            )
            for i in range(dataset.n_references):
                view = dataset.reference(i)
                found = landmarks_of_view(view, dataset.camera, detector)
                writer.add(view.trs_from_cam, found, source=0)
    return read_database_file(path)


def _preference(variant: SelectionVariant, database: Database) -> FloatArray:
    if variant.prune_by == "random":
        return np.random.default_rng(_SEED).random(len(database))
    return -place_in_view(database).astype(np.float64)


def _by_scores(
    base: str, database: Database, recording: Path, folder: Path
) -> list[tuple[str, FloatArray]]:
    """Give for each half of the shots how likely landmarks verify, as the other half tells."""
    verified = _verified(base, database, folder)
    tallies = [Tally(database) for _ in HALVES]
    with Dataset(recording) as dataset:
        rows = {int(shot_id): i for i, shot_id in enumerate(dataset.shot_ids)}
        for rank, shot_id in enumerate(sorted(rows)):
            if shot_id in verified:
                truth, mask = dataset.truth(rows[shot_id]), dataset.mask(rows[shot_id])
                # Scores of the even shots choose for the odd ones.
                tally = tallies[1 - rank % 2]
                tally.add(dataset.camera, truth.trs_from_cam, mask, verified[shot_id])
    counts = [tally.counts for tally in tallies]
    return [
        (half, (of_half.n_verified + 1.0) / (of_half.n_offered + 2.0))
        for half, of_half in zip(HALVES, counts, strict=True)
    ]


def _verified(base: str, database: Database, folder: Path) -> dict[int, NDArray[np.intp]]:
    """Give by shot the landmarks that a right pose of the base rests on."""
    results = load_results(folder)
    rows = results.scores.query("core == @base and status == 'ok'")
    right = set(rows.loc[rows["position_error_pct_los"] <= RIGHT_PCT_LOS, "shot_id"])
    return {
        answer.shot_id: answer.landmark_inliers
        for answer in results.answers()
        if answer.core == base and answer.shot_id in right and answer.database == database.digest
    }


def _identity(dataset: Dataset) -> str:
    return dataset.uuid or f"plan {dataset.provenance.plan_sha256}"


def _save(
    source: DatabaseFile,
    variant: SelectionVariant,
    preference: FloatArray,
    path: Path,
    asked: Path | None,
) -> None:
    """Write the part of the landmarks that is preferred; ``asked`` is whose scores chose."""
    database, part = source.database, variant.prune_to or 1.0
    cell_m = CELL_M if variant.prune_by == "place" else None
    chosen = preferred_part(database, part, preference, cell_m=cell_m)
    datasets: tuple[str, ...] = ()
    if asked is not None:
        with Dataset(asked) as dataset:
            datasets = (_identity(dataset),)
    pruning = Pruning(
        time_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        from_digest=database.digest,
        n_before=len(database),
        n_after=len(chosen),
        datasets=datasets,
        rules={"part": part, "by": variant.prune_by, "cell_m": cell_m},
    )
    save_selection(source, chosen, database.p_trs_m[chosen], path, pruning=pruning, counts=None)
