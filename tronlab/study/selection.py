"""Ways of choosing features and matches, each held against the core that it changes."""

import shutil
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tronlab.dataset.location import DATASET_NAME
from tronlab.nav.settings import PRESETS
from tronlab.nav.specs import CoreSpec
from tronlab.study.config import DatasetName, SelectionVariant
from tronlab.study.datasets import dataset_steps
from tronlab.study.keys import SCORING_CODE, key_of
from tronlab.study.recording import SCORES_NAME
from tronlab.study.steps import Desk, Step
from tronlab.study.study import Study
from tronlab.study.writing import replace_text

if TYPE_CHECKING:
    from tronlab.study.pruned import PrunedDatabase

FOLDER = Path("selection")
TABLE = FOLDER / "selection.csv"

_CODE = ("study/selection.py", "study/pruned.py")
_SHARE_OF_SCORING, _PRUNE_S, _TABLE_S = 0.06, 5.0, 5.0


def selection_steps(study: Study) -> list[Step]:
    """Score the datasets with every variant, and put the gains into a table.

    Raises:
        ConfigError: A variant has the name of a built-in core.
    """
    variants = study.selection
    if not (variants and study.selection_datasets):
        return []
    for name in variants.keys() & PRESETS.keys():
        where = ("selection", "variants", name)
        raise study.error("a built-in core has this name, take another", *where)
    settings = {name: variant.model_dump(mode="json") for name, variant in variants.items()}
    scored: dict[str, DatasetName] = {f"score {d}": d for d in study.selection_datasets}
    before = [step for step in dataset_steps(study) if step.name in scored]
    steps = [
        Step(
            f"choose features and matches, {scored[step.name]}",
            key_of(code=(*SCORING_CODE, *_CODE), after=[step], variants=settings),
            cost=_cost(len(variants), score_s=step.cost),
            run=partial(_score, study=study, dataset=scored[step.name]),
            results=(folder_of(scored[step.name]) / SCORES_NAME,),
        )
        for step in before
    ]
    table = Step(
        "choose features and matches, table",
        key_of(code=("study/selection_table.py", "score/evaluation"), after=steps),
        cost=_TABLE_S,
        run=partial(_write_table, study=study),
        results=(TABLE,),
    )
    return [*steps, table]


def folder_of(dataset: DatasetName) -> Path:
    """Give where the scores of all variants on a dataset are, relative to the study's folder."""
    return FOLDER / dataset


def bases_of(variants: Mapping[str, SelectionVariant]) -> tuple[CoreSpec, ...]:
    """Give the cores that variants are held against."""
    bases = dict.fromkeys(variant.base for variant in variants.values())
    return tuple(CoreSpec(base, "installed", base) for base in bases)


def specs_of(variants: Mapping[str, SelectionVariant]) -> tuple[CoreSpec, ...]:
    """Give the variants that need no database of their own."""
    return tuple(
        CoreSpec(name, "installed", variant.base, variant.settings)
        for name, variant in variants.items()
        if variant.prune_to is None
    )


def _score(desk: Desk, *, study: Study, dataset: DatasetName) -> None:
    """Score one dataset: first the bases, whose answers choose landmarks, then all else at once.

    Answers of the bases are mostly known from the dataset's own scores; so features of an image are
    found once for all variants, those with a part of the landmarks too.
    """
    from tronlab.study.pruned import pruned_databases

    recording = desk.out / study.dataset_folder(Path(), dataset) / DATASET_NAME
    folder = desk.out / folder_of(dataset)
    shutil.rmtree(folder, ignore_errors=True)  # answers are kept elsewhere
    _score_cores(desk, recording, bases_of(study.selection), folder)
    pruned = pruned_databases(study.selection, recording, folder, live=desk.live)
    specs = [*specs_of(study.selection), *(_spec_of(one, study.selection) for one in pruned)]
    _score_cores(desk, recording, specs, folder)


def _spec_of(pruned: "PrunedDatabase", variants: Mapping[str, SelectionVariant]) -> CoreSpec:
    variant = variants[pruned.variant]
    settings = {**variant.settings, "database": str(pruned.path)}
    return CoreSpec(pruned.core, "installed", variant.base, settings)


def _score_cores(desk: Desk, recording: Path, specs: Sequence[CoreSpec], folder: Path) -> None:
    from tronlab.score.rescore import score_jobs
    from tronlab.score.rescoring.cache import usual_cache_folder
    from tronlab.score.rescoring.job import ScoreJob
    from tronlab.score.rescoring.workers import ProcessExecutor

    score_jobs(
        [ScoreJob(recording, tuple(specs), folder, cache_dir=usual_cache_folder())],
        executor=ProcessExecutor(desk.n_workers),
        progress=lambda done, n: desk.live.advance("score variants", n_done=done, n_all=n),
    )


def _write_table(desk: Desk, *, study: Study) -> None:
    from tronlab.score.results import load_results
    from tronlab.study.selection_table import selection_table

    scores = {
        dataset: load_results(desk.out / folder_of(dataset)).scores
        for dataset in study.selection_datasets
    }
    table = selection_table(study.selection, scores)
    replace_text(desk.out / TABLE, table.to_csv(index=False))


def _cost(n_variants: int, *, score_s: float) -> float:
    """Guess seconds from what scoring the dataset once takes."""
    return _PRUNE_S + _SHARE_OF_SCORING * n_variants * score_s
