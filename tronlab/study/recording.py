"""Steps that make a dataset: record, score."""

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from tronlab.dataset.location import DATASET_NAME
from tronlab.errors import ChangedError
from tronlab.study.config import DatasetName
from tronlab.study.keys import RECORDING_CODE, SCORING_CODE, key_of
from tronlab.study.steps import Desk, Step
from tronlab.study.study import Study
from tronlab.study.variants import Variant, write_variant
from tronlab.yaml_variants import merged

SCORES_NAME = "scores.csv"

_PAPER_SHOTS: Mapping[DatasetName, int] = {
    "dataset_0": 61,
    "dataset_1_nominal": 12,
    "dataset_1_perturbed": 239,
    "dataset_2_nominal": 11,
    "dataset_2_perturbed": 50,
}
"""What the time of a step is guessed from before it was ever done."""
_START_S, _RECORD_S, _SCORE_S = 15.0, 0.7, 0.7
"""To get ready, and for a shot recorded and scored."""


@dataclass(frozen=True, slots=True)
class Recording:
    """A dataset to be recorded and scored; paths are relative to the study's folder."""

    name: str
    """As the steps call it: ``dataset_1_nominal``, ``without_noise, dataset_0``."""
    folder: Path
    """Of dataset, scores and report."""
    campaign: Variant
    rig: Variant
    record: Path
    """Calibration record."""
    n_shots: float
    """About how many it has."""

    @property
    def slug(self) -> Path:
        """Get the name of the files that the study writes for it."""
        return Path("-".join(self.folder.parts) + ".yaml")


def recording_of(
    study: Study,
    dataset: DatasetName,
    *,
    name: str = "",
    folder: Path | None = None,
    larger: bool = False,
    rig_changes: Mapping[str, Any] | None = None,
    campaign_changes: Mapping[str, Any] | None = None,
    record: Path | None = None,
    every_n: int | None = None,
) -> Recording:
    """Give the recording of one of the study's datasets, or of a variant of it.

    Args:
        study: The study.
        dataset: Which dataset.
        name: As the steps call it; by default as the dataset is called.
        folder: Relative to the study's; by default that of the dataset.
        larger: Whether with the larger terrain.
        rig_changes: What of the rig is to be otherwise, nested.
        campaign_changes: Likewise of the campaign.
        record: Calibration record, relative to the study's folder; by default the laboratory's.
        every_n: Of how many shots one is taken; by default what the study says of the dataset.
    """
    every_n = study.every_n(dataset) if every_n is None else every_n
    changes = merged(_quick_changes(study, dataset), campaign_changes or {})
    if every_n > 1:
        changes = merged(changes, {"plan": {"every_n": every_n}})
    return Recording(
        name=name or (f"{dataset}, larger terrain" if larger else dataset),
        folder=folder or study.dataset_folder(Path(), dataset, larger=larger),
        campaign=Variant(study.campaign_file(dataset), changes),
        rig=Variant(study.rig_file(dataset, larger=larger), rig_changes or {}),
        record=record or study.record_path(dataset, larger=larger),
        n_shots=_PAPER_SHOTS[dataset] / every_n,
    )


def recording_steps(
    study: Study, recording: Recording, *, after: Sequence[Step], cores: Sequence[str] = ()
) -> list[Step]:
    """Record and score a dataset.

    Args:
        study: The study.
        recording: What is recorded, and where to.
        after: The steps that it depends on: that of its calibration record.
        cores: Navigation cores; by default the study's.
    """
    cores = tuple(cores) or study.config.cores
    dataset, scores = recording.folder / DATASET_NAME, recording.folder / SCORES_NAME
    record = Step(
        f"record {recording.name}",
        key_of(
            code=RECORDING_CODE,
            after=after,
            campaign=recording.campaign.key,
            rig=recording.rig.key,
        ),
        cost=_START_S + _RECORD_S * recording.n_shots,
        run=partial(_record, recording=recording),
        results=(dataset,),
    )
    score = Step(
        f"score {recording.name}",
        key_of(code=SCORING_CODE, after=[record], cores=cores),
        cost=_SCORE_S * recording.n_shots,
        run=partial(_score, folder=recording.folder, cores=cores),
        results=(scores,),
    )
    return [record, score]


def _quick_changes(study: Study, dataset: DatasetName) -> dict[str, Any]:
    """Give what of a campaign is otherwise in a quick study."""
    if not (study.quick and dataset.endswith("_perturbed")):
        return {}
    return {"trajectory": {"perturbed": {"only": list(study.config.quick.perturbed_only)}}}


def _record(desk: Desk, *, recording: Recording) -> None:
    rig = file_of(recording.rig, desk.out / "rigs" / recording.slug)
    record = desk.out / recording.record
    campaign = desk.out / "campaigns" / recording.slug
    # So that the file can be used by hand, too.
    used = {
        "rig": os.path.relpath(rig, campaign.parent),
        "calibration": os.path.relpath(record, campaign.parent),
    }
    extended, changes = recording.campaign.extends, recording.campaign.changes
    write_variant(campaign, Variant(extended, {**changes, **used}))
    folder = desk.out / recording.folder
    record_dataset(desk, campaign=campaign, rig=rig, record=record, folder=folder)


def record_dataset(desk: Desk, *, campaign: Path, rig: Path, record: Path, folder: Path) -> None:
    """Record a dataset: what a step of the same key began goes on, everything else goes away.

    Args:
        desk: What the step works with.
        campaign: Campaign file.
        rig: Rig file, instead of the one the campaign names.
        record: Calibration record, likewise.
        folder: Of the dataset.

    Raises:
        TronlabError: As ``run_campaign``.
        CampaignInterrupted: Likewise.
    """
    from tronlab.campaign.continuation import GivenFiles
    from tronlab.campaign.run import resume_campaign, run_campaign

    if desk.is_begun and (folder / DATASET_NAME).exists():
        try:
            resume_campaign(folder, files=GivenFiles(campaign, rig, record), live=desk.live)
        except ChangedError as change:
            desk.live.announce(f"{folder}: is recorded anew: {change}")
        else:
            return
    shutil.rmtree(folder, ignore_errors=True)
    run_campaign(campaign, rig_path=rig, calibration_path=record, out_dir=folder, live=desk.live)


def _score(desk: Desk, *, folder: Path, cores: Sequence[str]) -> None:
    score_datasets(desk, cores, [desk.out / folder])


def score_datasets(desk: Desk, cores: Sequence[str], folders: Sequence[Path]) -> None:
    """Score recorded datasets together; answers that are known already are taken.

    Args:
        desk: What the step works with.
        cores: Navigation cores, as ``--core`` takes them.
        folders: Of the datasets, and of their scores.

    Raises:
        TronlabError: As ``score_jobs``.
    """
    from tronlab.nav.specs import parse_cores
    from tronlab.score.rescore import score_jobs
    from tronlab.score.rescoring.cache import usual_cache_folder
    from tronlab.score.rescoring.job import ScoreJob
    from tronlab.score.rescoring.workers import ProcessExecutor
    from tronlab.score.results import INFO, MATCHES, PARTIAL_SCORES, SCORES, SUMMARY

    for folder in folders:  # cores may be gone from the study; answers are kept elsewhere
        for name in (SCORES, MATCHES, SUMMARY, INFO, PARTIAL_SCORES):
            (folder / name).unlink(missing_ok=True)
    specs, cache = parse_cores(cores), usual_cache_folder()
    score_jobs(
        [ScoreJob(each / DATASET_NAME, specs, each, cache_dir=cache) for each in folders],
        executor=ProcessExecutor(desk.n_workers),
        progress=lambda done, n: desk.live.advance("score", n_done=done, n_all=n),
        announce=desk.live.announce,
    )


def file_of(variant: Variant, path: Path) -> Path:
    """Give the file of a variant: the one it extends if nothing is changed, else ``path``."""
    return write_variant(path, variant) if variant.changes else variant.extends
