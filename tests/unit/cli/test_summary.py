from pathlib import Path

import pandas as pd

from tronlab.cli.summary import missing_poses, summary_table
from tronlab.score.results import ScoreResults


def statistics(mean: float | None, maximum: float | None, n_ok: int) -> dict[str, object]:
    return {
        "n_shots": 61,
        "n_ok": n_ok,
        "position_error_pct_los": {"mean": mean, "max": maximum},
    }


def test_table_stands_beside_the_claim_of_the_paper() -> None:
    table = summary_table(
        {"akaze": statistics(0.5, 1.25, 61), "brisk": statistics(None, None, 0)}
    ).splitlines()
    assert table[1].split() == ["akaze", "0.500", "1.250", "61/61"]
    assert table[2].split() == ["brisk", "-", "-", "0/61"]
    assert table[3].split() == ["the", "paper,", "AKAZE", "and", "BRISK", "<", "1", "<", "3"]


def test_a_core_without_poses_says_how_many_and_why() -> None:
    status = {
        "good": ["ok", "ok"],
        "raiser": ["error", "error"],
        "mute": ["ok", "no_pose"],
    }
    rows = [(core, 0, shot_id, s) for core, of in status.items() for shot_id, s in enumerate(of)]
    results = ScoreResults(
        directory=Path(),
        scores=pd.DataFrame(rows, columns=["core", "seed", "shot_id", "status"]),
        summary={core: {} for core in status},
        dataset_path=Path("dataset.h5"),
        cores=tuple(status),
        software={},
        scored_utc="",
        reasons={("raiser", 0, 0): "ValueError: boom\n  at noon", ("raiser", 0, 1): "later"},
        kept={},
    )
    assert missing_poses(results) == [
        "raiser: 2 of 2 shots without a pose; first: shot 0, error: ValueError: boom at noon",
        "mute: 1 of 2 shots without a pose; first: shot 1, no_pose",
    ]
