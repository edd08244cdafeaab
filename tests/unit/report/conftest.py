"""Score tables as `tronlab score` writes them, with known errors."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Truth
from tronlab.nav.core import NavigationResult
from tronlab.score.rescoring.shot import CoreScore
from tronlab.score.results import save_results
from tronlab.score.table import ShotFacts, score_row, with_all_columns

CORE_SCALES_PCT = {"akaze": 0.5, "brisk": 0.4, "akaze-refined": 0.03, "brisk-refined": 0.04}


def make_scores(
    cores: dict[str, float], n_shots: int = 61, *, missed: dict[str, str] | None = None
) -> pd.DataFrame:
    rng = np.random.default_rng(7)
    range_m = np.linspace(4.0, 1.0, n_shots)
    tables = []
    for core, scale_pct in cores.items():
        error_m = (
            rng.normal(size=(n_shots, 3)) * [1.0, 1.0, 0.4] * (scale_pct / 170 * range_m)[:, None]
        )
        norm_m = np.linalg.norm(error_m, axis=1)
        angle_deg = np.abs(rng.normal(size=(n_shots, 3))) * scale_pct * 0.4
        table = pd.DataFrame(
            {
                "core": core,
                "shot_id": np.arange(n_shots),
                "status": "ok",
                "range_los_m": range_m,
                "usable_fraction": np.clip(2.2 / range_m, 0.2, 1.0),
                "position_error_m": norm_m,
                "position_error_pct_los": 100 * norm_m / range_m,
                "rotation_error_deg": angle_deg.max(axis=1),
                "n_features": rng.integers(800, 1500, n_shots),
                "n_matches": rng.integers(80, 150, n_shots),
                "n_inliers": rng.integers(40, 80, n_shots),
                "time_detect_s": rng.uniform(0.2, 0.4, n_shots),
                "time_match_s": rng.uniform(0.02, 0.04, n_shots),
                "time_pose_s": rng.uniform(0.001, 0.004, n_shots),
                "truth_state": "good",
            }
        )
        for i, axis in enumerate("xyz"):
            table[f"error_trs_{axis}_m"] = error_m[:, i]
            table[f"error_cam_{axis}_m"] = error_m[:, i]
            table[f"axis_error_{axis}_deg"] = angle_deg[:, i]
        tables.append(table)
    scores = with_all_columns(pd.concat(tables, ignore_index=True))
    for core, status in (missed or {}).items():
        lose_poses(scores, (scores["core"] == core) & (scores["shot_id"] < 2), status)
    return scores


def lose_poses(scores: pd.DataFrame, which: "pd.Series[bool]", status: str) -> None:
    scores.loc[which, "status"] = status
    errors = [name for name in scores.columns if "error" in name]
    scores.loc[which, errors] = np.nan


@pytest.fixture
def scores() -> pd.DataFrame:
    """Four cores of 61 shots; brisk misses two poses."""
    return make_scores(CORE_SCALES_PCT, missed={"brisk": "no_pose"})


@pytest.fixture
def scores_of() -> Callable[..., pd.DataFrame]:
    return make_scores


@pytest.fixture
def lose() -> Callable[..., None]:
    """The function ``lose(scores, which, status)`` that takes poses away."""
    return lose_poses


ScoreDataset = Callable[..., Path]


@pytest.fixture
def score_by_hand(tmp_path: Path, small_dataset: Path) -> ScoreDataset:
    """The factory ``score_by_hand({core: offset_m or None})``: a folder as scored.

    A core misses every true position by its offset (m) along x of trs; None finds no pose.
    """

    def score(offsets_m: dict[str, float | None]) -> Path:
        out_dir = tmp_path / "scored"
        out_dir.mkdir(exist_ok=True)
        with Dataset(small_dataset) as dataset:
            scores = [
                fake_score(core, shot_id, dataset.truth(i), offset_m)
                for core, offset_m in offsets_m.items()
                for i, shot_id in enumerate(dataset.shot_ids)
            ]
        info = {
            "dataset": os.path.relpath(small_dataset, out_dir),
            "cores": list(offsets_m),
            "software": {"opencv": "5 <beta>"},
            "scored_utc": "2026-11-22T04:00:00+00:00",
        }
        save_results(out_dir, scores, info)
        return out_dir

    return score


def fake_score(core: str, shot_id: int, truth: Truth, offset_m: float | None) -> CoreScore:
    if offset_m is None:
        result = NavigationResult("no_pose", reason="too few <matches>", n_features=3)
    else:
        shift = RigidTransform.from_translation([offset_m * (1 + shot_id), 0.0, 0.0])
        result = NavigationResult(
            "ok", shift * truth.trs_from_cam, uv_inliers=np.array([[20.0, 12.0], [40.0, 30.0]])
        )
    row = score_row(core, 0, ShotFacts(int(shot_id), truth, "good"), result)
    return CoreScore(core, int(shot_id), row, result)
