"""The worst answers of each core, and why they are so bad."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from tronlab.dataset.reader import Dataset
from tronlab.errors import TronlabError
from tronlab.report.recording import dataset_behind
from tronlab.report.tables import N_WORST, by_core, worst_first
from tronlab.score.evidence import AnswerKey, read_evidence
from tronlab.score.reasons import Evidence, Reason, explain
from tronlab.score.rescoring.cache import usual_cache_folder
from tronlab.score.results import ScoreResults


@dataclass(frozen=True, slots=True)
class WorstAnswer:
    """One answer to a shot."""

    core: str
    seed: int
    shot_id: int
    error_pct_los: float
    """NaN without a pose."""

    @property
    def key(self) -> AnswerKey:
        """Get what tells it from others."""
        return self.core, self.seed, self.shot_id


def worst_answers(scores: pd.DataFrame, n: int = 1) -> list[WorstAnswer]:
    """Give the worst answers of every core, worst first, core after core.

    Args:
        scores: As ``scores.csv`` has them.
        n: How many a core, at most.
    """
    columns = ["core", "seed", "shot_id", "position_error_pct_los"]
    return [
        WorstAnswer(str(core), int(seed), int(shot_id), float(error))
        for _, rows in by_core(scores)
        for core, seed, shot_id, error in worst_first(rows).head(n)[columns].itertuples(index=False)
    ]


def worst_reasons(results: ScoreResults, cores: Collection[str]) -> dict[AnswerKey, str]:
    """Say why the worst answers are so bad, as the table of worst shots has them.

    Args:
        results: The scoring.
        cores: Those to look into; of the others stays why they gave no pose.
    """
    worst = worst_answers(results.scores, N_WORST)
    found = reasons_of(results, [answer.key for answer in worst if answer.core in cores])
    return {**results.reasons, **{key: reason.sentence for key, reason in found.items()}}


def reasons_of(results: ScoreResults, keys: Collection[AnswerKey]) -> dict[AnswerKey, Reason]:
    """Give the reason of some answers; without a readable dataset what their rows tell."""
    try:
        with Dataset(dataset_behind(results)) as dataset:
            evidence = read_evidence(results, dataset, keys, cache_dir=usual_cache_folder())
    except TronlabError:  # the page says what is wrong with it
        evidence: Mapping[AnswerKey, Evidence] = {}
    rows = _rows(results.scores, keys)
    return {
        key: explain(rows[key], evidence.get(key) or Evidence(no_pose=results.reasons.get(key, "")))
        for key in keys
    }


def _rows(
    scores: pd.DataFrame, keys: Collection[AnswerKey]
) -> Mapping[AnswerKey, Mapping[Any, Any]]:
    """Give the row of each answer."""
    of_all = zip(*(scores[name].tolist() for name in ("core", "seed", "shot_id")), strict=True)
    places = {key: i for i, key in enumerate(of_all)}
    found = scores.iloc[[places[key] for key in keys]].to_dict("records")
    return dict(zip(keys, found, strict=True))
