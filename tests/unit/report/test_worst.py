"""The reason beside the worst shots."""

import pandas as pd

from tronlab.report.worst import reasons_of, worst_answers
from tronlab.score.results import load_results


def test_worst_answers_are_those_without_a_pose_then_the_largest(scores: pd.DataFrame) -> None:
    brisk = [answer for answer in worst_answers(scores, 3) if answer.core == "brisk"]
    of_core = scores[scores["core"] == "brisk"]
    lost = of_core[of_core["status"] != "ok"]["shot_id"].tolist()
    assert [answer.shot_id for answer in brisk[: len(lost)]] == sorted(lost)[:3]
    assert len(worst_answers(scores)) == scores["core"].nunique()


def test_without_the_dataset_rows_tell_what_they_can(score_by_hand, small_dataset) -> None:
    directory = score_by_hand({"fine": 0.0005, "blind": None})
    small_dataset.unlink()
    results = load_results(directory)
    found = reasons_of(results, [answer.key for answer in worst_answers(results.scores)])
    assert {key[0]: reason.cause for key, reason in found.items()}["blind"] == "no pose"
