"""Whether errors follow how far a trajectory is off the nominal one: figure 19 and its numbers."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from tronlab.dataset.location import DATASET_NAME
from tronlab.study.config import DatasetName
from tronlab.study.datasets import dataset_steps
from tronlab.study.keys import key_of
from tronlab.study.recording import SCORES_NAME, recording_of
from tronlab.study.steps import Desk, Step
from tronlab.study.study import Study
from tronlab.study.writing import replace_text

FOLDER = Path("perturbation")
TABLE, RANKS = FOLDER / "perturbation.csv", FOLDER / "rank.csv"

_NOMINAL: Mapping[DatasetName, DatasetName] = {
    "dataset_1_perturbed": "dataset_1_nominal",
    "dataset_2_perturbed": "dataset_2_nominal",
}
_COST_S = 15.0


def perturbation_steps(study: Study) -> list[Step]:
    """Measure the perturbations of all perturbed datasets whose nominal one is there too."""
    nominal: dict[DatasetName, DatasetName] = {
        dataset: _NOMINAL[dataset]
        for dataset in study.datasets
        if dataset in _NOMINAL and _NOMINAL[dataset] in study.datasets
    }
    if not nominal:
        return []
    folders = [study.dataset_folder(Path(), name) for name in (*nominal, *nominal.values())]
    needed = {folder / name for folder in folders for name in (DATASET_NAME, SCORES_NAME)}
    step = Step(
        "perturbations: do errors follow them",
        key_of(
            code=["study/perturbation.py", "score/perturbation.py", "score/evaluation"],
            after=[step for step in dataset_steps(study) if needed & set(step.results)],
        ),
        cost=_COST_S,
        run=partial(_measure, study=study, nominal=nominal),
        results=(TABLE, RANKS),
    )
    return [step]


def _measure(desk: Desk, *, study: Study, nominal: Mapping[DatasetName, DatasetName]) -> None:
    import pandas as pd

    from tronlab.dataset.reader import Dataset
    from tronlab.score.perturbation import (
        perturbation_table,
        perturbations,
        rank_table,
        true_views,
    )
    from tronlab.score.results import load_results

    tables: list[pd.DataFrame] = []
    for dataset, base in nominal.items():
        folder = study.dataset_folder(desk.out, dataset)
        base_path = study.dataset_folder(desk.out, base) / DATASET_NAME
        with Dataset(folder / DATASET_NAME) as perturbed, Dataset(base_path) as unperturbed:
            found = perturbations(true_views(perturbed), true_views(unperturbed))
        scores = load_results(folder).scores
        numbers = _trajectories(desk.out, study, dataset)
        tables.append(perturbation_table(dataset, scores, found, numbers))
    table = pd.concat(tables, ignore_index=True)
    desk.live.announce("perturbations: correlating ranks")
    replace_text(desk.out / TABLE, table.to_csv(index=False))
    replace_text(desk.out / RANKS, rank_table(table).to_csv(index=False))


def _trajectories(out: Path, study: Study, dataset: DatasetName) -> dict[int, int]:
    """Give the number of the trajectory of each shot, by the campaign as it was recorded.

    Shots are numbered from 1 in the order of the planned poses.
    """
    from tronlab.campaign.config import load_campaign
    from tronlab.trajectory.poses import trajectory_numbers

    path = out / "campaigns" / recording_of(study, dataset).slug
    campaign = load_campaign(path, overridden={"rig", "calibration"})
    return dict(enumerate(trajectory_numbers(campaign.config.trajectory), start=1))
