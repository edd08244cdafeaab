"""What limits accuracy: every core's error beside its bound, its truth and what sources cost."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from tronlab.score.evaluation.ablation import NONE
from tronlab.study.ablation import SHARES_FILE, ablation_steps, folders_of
from tronlab.study.datasets import dataset_steps
from tronlab.study.keys import key_of
from tronlab.study.recording import SCORES_NAME
from tronlab.study.steps import Desk, Step
from tronlab.study.study import Study
from tronlab.study.writing import replace_text

LIMITS_FILE = Path("limits/limits.csv")
_TABLE_S = 2.0


def limits_steps(study: Study) -> list[Step]:
    """Put the table of limits together from the scores of all datasets and the ablation."""
    folders = {dataset: study.dataset_folder(Path(), dataset) for dataset in study.datasets}
    scores = [folder / SCORES_NAME for folder in folders.values()]
    scored = [step for step in dataset_steps(study) if set(scores) & set(step.results)]
    step = Step(
        "limits: what limits accuracy",
        key_of(
            code=["study/limits.py", "score/evaluation"], after=[*scored, *ablation_steps(study)]
        ),
        cost=_TABLE_S,
        run=partial(_tabulate, folders=folders, without_any=folders_of(study)[NONE]),
        results=(LIMITS_FILE,),
    )
    return [step]


def _tabulate(desk: Desk, *, folders: Mapping[str, Path], without_any: Mapping[str, Path]) -> None:
    import pandas as pd

    from tronlab.score.evaluation.limits import limits_table
    from tronlab.score.results import load_results

    table = limits_table(
        {dataset: load_results(desk.out / folder).scores for dataset, folder in folders.items()},
        {dataset: load_results(desk.out / path).scores for dataset, path in without_any.items()},
        pd.read_csv(desk.out / SHARES_FILE),
    )
    replace_text(desk.out / LIMITS_FILE, table.to_csv(index=False))
