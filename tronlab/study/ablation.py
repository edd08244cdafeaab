"""What each source of dissimilarity costs: the same shots in laboratories without one of them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial, reduce
from pathlib import Path
from typing import Any

from tronlab.score.evaluation.ablation import ALL, KINDS, NONE, Kind, Source, only, without
from tronlab.study.calibration import calibration_steps
from tronlab.study.config import DatasetName, MeasuredPart, SourceConfig
from tronlab.study.keys import RECORDING_CODE, SCORING_CODE, key_of
from tronlab.study.recording import (
    SCORES_NAME,
    Recording,
    recording_of,
    recording_steps,
    score_datasets,
)
from tronlab.study.steps import Desk, Step
from tronlab.study.study import Study
from tronlab.study.variants import Variant, write_variant
from tronlab.study.writing import replace_text
from tronlab.yaml_variants import merged

FOLDER = Path("ablation")
COSTS_FILE = FOLDER / "ablation.csv"
SHARES_FILE = FOLDER / "shares.csv"

_SCORE_START_S, _SCORE_S = 4.0, 0.7
_TABLE_S = 5.0


@dataclass(frozen=True, slots=True)
class AblationVariant:
    """A laboratory in which some sources of dissimilarity are gone."""

    name: str
    off: Mapping[str, SourceConfig] = field(default_factory=dict[str, SourceConfig])
    """The sources that are gone."""

    @property
    def rig(self) -> dict[str, Any]:
        """Get what of the rig is otherwise."""
        return _together(source.rig for source in self.off.values())

    @property
    def campaign(self) -> dict[str, Any]:
        """Get what of the campaign is otherwise."""
        return _together(source.campaign for source in self.off.values())

    @property
    def known(self) -> tuple[MeasuredPart, ...]:
        """Get which parts of the calibration are without error."""
        return tuple(sorted({part for source in self.off.values() for part in source.known}))


def variants_of(study: Study) -> tuple[AblationVariant, ...]:
    """Give the laboratories that are compared; a quick study leaves those with one kind out."""
    every = study.config.ablation.sources
    there = {source.kind for source in every.values()}
    kinds: list[Kind] = [kind for kind in KINDS if kind in there]
    return (
        AblationVariant(ALL),
        *(AblationVariant(without(name), {name: one}) for name, one in study.sources.items()),
        *(_with_only(kind, every) for kind in kinds if not study.quick and len(kinds) > 1),
        AblationVariant(NONE, every),
    )


def ablation_steps(study: Study) -> list[Step]:
    """Record and score every variant, then say what each source costs.

    Raises:
        ConfigError: The ablation names a dataset that the study does not take.
    """
    datasets = _datasets(study)
    calibrations = {step.results[0]: step for step in calibration_steps(study)}
    steps: list[Step] = []
    scored: list[Step] = []
    for variant in variants_of(study):
        steps += _steps_of(study, variant, datasets, calibrations)
        scored.append(steps[-1])
    sources = tuple(Source(name, one.title, one.kind) for name, one in study.sources.items())
    table = Step(
        "ablation: what each source costs",
        key_of(
            code=["study/ablation.py", "score/evaluation"],
            after=scored,
            sources=[(source.name, source.title, source.kind) for source in sources],
        ),
        cost=_TABLE_S,
        run=partial(_tabulate, folders=folders_of(study), sources=sources),
        results=(COSTS_FILE, SHARES_FILE),
    )
    return [*steps, table]


def folders_of(study: Study) -> dict[str, dict[str, Path]]:
    """Give the folder of each variant and dataset, relative to the study's."""
    return {
        variant.name: {dataset: _folder(variant, dataset) for dataset in _datasets(study)}
        for variant in variants_of(study)
    }


def _datasets(study: Study) -> tuple[DatasetName, ...]:
    for dataset in study.ablation_every_n:
        if dataset not in study.datasets:
            keys = ("quick", "ablation_every_n") if study.quick else ("ablation", "every_n")
            raise study.error(
                f"the study does not take {dataset}; it takes: {', '.join(study.datasets)}",
                *keys,
                dataset,
            )
    return tuple(study.ablation_every_n)


def _with_only(kind: Kind, every: Mapping[str, SourceConfig]) -> AblationVariant:
    others = {name: source for name, source in every.items() if source.kind != kind}
    return AblationVariant(only(kind), others)


def _steps_of(
    study: Study,
    variant: AblationVariant,
    datasets: Sequence[DatasetName],
    calibrations: Mapping[Path, Step],
) -> list[Step]:
    """Prepare the records of a variant, record its datasets, score them all at once."""
    of_laboratories: dict[str, Step] = {}
    recordings: list[Step] = []
    for dataset in datasets:
        laboratory = study.laboratory_name(dataset)
        if laboratory not in of_laboratories:
            of_laboratories[laboratory] = _record_step(study, variant, dataset, calibrations)
        own = of_laboratories[laboratory]
        recording = _recording(study, variant, dataset, record=own.results[0])
        recordings += recording_steps(study, recording, after=[own])[:1]
    new = [step for step in of_laboratories.values() if step not in calibrations.values()]
    return [*new, *recordings, _score_step(study, variant, datasets, recordings)]


def _record_step(
    study: Study,
    variant: AblationVariant,
    dataset: DatasetName,
    calibrations: Mapping[Path, Step],
) -> Step:
    """Give the step that makes the calibration record of a variant."""
    measured = calibrations[study.record_path(dataset)]
    if not variant.off:
        return measured
    laboratory = study.laboratory_name(dataset)
    record = FOLDER / variant.name / f"{laboratory}.json"
    rig = Variant(study.rig_file(dataset), variant.rig)
    return Step(
        f"calibration of {laboratory}, {variant.name}",
        key_of(
            code=(*RECORDING_CODE, "study/known_truth.py"),
            after=[measured],
            rig=rig.key,
            known=variant.known,
        ),
        cost=1.0,
        run=partial(
            _make_record, rig=rig, known=variant.known, measured=measured.results[0], record=record
        ),
        results=(record,),
    )


def _recording(
    study: Study, variant: AblationVariant, dataset: DatasetName, *, record: Path
) -> Recording:
    return recording_of(
        study,
        dataset,
        name=f"{dataset}, {variant.name}",
        folder=_folder(variant, dataset),
        rig_changes=variant.rig,
        campaign_changes=variant.campaign,
        record=record,
        every_n=study.ablation_every_n[dataset],
    )


def _folder(variant: AblationVariant, dataset: DatasetName) -> Path:
    return FOLDER / variant.name / dataset


def _score_step(
    study: Study,
    variant: AblationVariant,
    datasets: Sequence[DatasetName],
    recordings: Sequence[Step],
) -> Step:
    folders = [_folder(variant, dataset) for dataset in datasets]
    cores = study.config.cores
    n_shots = sum(
        _recording(study, variant, dataset, record=Path()).n_shots for dataset in datasets
    )
    return Step(
        f"score {variant.name}",
        key_of(code=SCORING_CODE, after=recordings, cores=cores),
        cost=_SCORE_START_S + _SCORE_S * n_shots,
        run=partial(_score, folders=folders, cores=cores),
        results=tuple(folder / SCORES_NAME for folder in folders),
    )


def _make_record(
    desk: Desk,
    *,
    rig: Variant,
    known: Sequence[MeasuredPart],
    measured: Path,
    record: Path,
) -> None:
    from tronlab.calib.record import CalibrationRecord
    from tronlab.campaign.rig import load_rig
    from tronlab.study.known_truth import with_truth

    name = "-".join(record.with_suffix("").parts)
    path = rig.extends
    if rig.changes:
        path = write_variant(desk.out / "rigs" / f"{name}.yaml", rig)
    as_measured = CalibrationRecord.load(desk.out / measured)
    with_truth(as_measured, load_rig(path), known).save(desk.out / record)


def _score(desk: Desk, *, folders: Sequence[Path], cores: Sequence[str]) -> None:
    score_datasets(desk, cores, [desk.out / folder for folder in folders])


def _tabulate(
    desk: Desk, *, folders: Mapping[str, Mapping[str, Path]], sources: Sequence[Source]
) -> None:
    from tronlab.score.evaluation.ablation import ablation_table, shares_table
    from tronlab.score.results import load_results

    scores = {
        variant: {
            dataset: load_results(desk.out / folder).scores for dataset, folder in own.items()
        }
        for variant, own in folders.items()
    }
    for path, table in (
        (COSTS_FILE, ablation_table(scores, sources)),
        (SHARES_FILE, shares_table(scores)),
    ):
        replace_text(desk.out / path, table.to_csv(index=False))


def _together(changes: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    return reduce(merged, changes, dict[str, Any]())
