"""Score tables as `tronlab score` writes them, with known errors."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

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
            }
        )
        for i, axis in enumerate("xyz"):
            table[f"error_trs_{axis}_m"] = error_m[:, i]
            table[f"error_cam_{axis}_m"] = error_m[:, i]
            table[f"axis_error_{axis}_deg"] = angle_deg[:, i]
        tables.append(table)
    scores = pd.concat(tables, ignore_index=True)
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
