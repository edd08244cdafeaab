"""The worst shot of every dataset and core, the reason, and where its picture is."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from tronlab.study.config import DatasetName
from tronlab.study.datasets import PAGE_NAME, dataset_steps
from tronlab.study.keys import key_of
from tronlab.study.steps import Desk, Step
from tronlab.study.study import Study
from tronlab.study.writing import replace_text

TABLE = Path("worst/worst.csv")
COLUMNS = (
    "dataset",
    "core",
    "shot_id",
    "seed",
    "error_pct_los",
    "cause",
    "reason",
    "picture",
    "page",
)

_COST_S = 5.0


def worst_steps(study: Study) -> list[Step]:
    """Gather the worst shots from the reports of all datasets."""
    pages = {study.dataset_folder(Path(), name) / PAGE_NAME for name in study.datasets}
    step = Step(
        "worst shots",
        key_of(
            code=["study/worst.py", "report/worst.py"],
            after=[step for step in dataset_steps(study) if pages & set(step.results)],
        ),
        cost=_COST_S,
        run=partial(_gather, folders={d: study.dataset_folder(Path(), d) for d in study.datasets}),
        results=(TABLE,),
    )
    return [step]


def _gather(desk: Desk, *, folders: dict[DatasetName, Path]) -> None:
    import pandas as pd

    rows: list[tuple[object, ...]] = []
    for dataset, folder in folders.items():
        rows += _rows(desk.out, dataset, folder)
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    replace_text(desk.out / TABLE, table.to_csv(index=False))


def _rows(out: Path, dataset: DatasetName, folder: Path) -> Sequence[tuple[object, ...]]:
    from tronlab.report.style import core_styles
    from tronlab.report.worst import reasons_of, worst_answers
    from tronlab.score.results import load_results

    results = load_results(out / folder)
    worst = worst_answers(results.scores)
    reasons = reasons_of(results, [answer.key for answer in worst])
    styles = core_styles([answer.core for answer in worst])
    rows: list[tuple[object, ...]] = []
    for answer in worst:
        slug = styles[answer.core].slug
        picture = folder / "figures" / f"worst_{slug}.jpg"
        reason = reasons[answer.key]
        rows.append(
            (
                dataset,
                answer.core,
                answer.shot_id,
                answer.seed,
                answer.error_pct_los,
                reason.cause,
                reason.sentence,
                picture.as_posix() if (out / picture).is_file() else "",
                f"{(folder / PAGE_NAME).as_posix()}#worst-{slug}",
            )
        )
    return rows
