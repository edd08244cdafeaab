"""The tables of a study with known numbers, in the files a study leaves."""

import json
from pathlib import Path

import numpy as np
import pandas as pd

from tronlab.report.paper import DATASETS
from tronlab.score.evaluation.ablation import Source, ablation_table, shares_table
from tronlab.score.evaluation.limits import limits_table
from tronlab.score.table import COLUMNS, with_all_columns

SCALES_PCT = {"akaze": 0.6, "brisk": 0.8, "akaze-refined": 0.03, "brisk-refined": 0.04}
"""Typical position error of each core, percent of the range."""
RANGES_M = {
    "dataset_0": (1.0, 4.0),
    "dataset_1_nominal": (0.5, 5.4),
    "dataset_1_perturbed": (0.5, 5.4),
    "dataset_2_nominal": (5.8, 9.6),
    "dataset_2_perturbed": (5.8, 9.6),
}


def scores_of(dataset: str, *, n_shots: int | None = None, scale: float = 1.0) -> pd.DataFrame:
    """Scores of four cores; errors scatter as those of real ones do."""
    n = n_shots or DATASETS[dataset].n_shots
    rng = np.random.default_rng([list(DATASETS).index(dataset), n])
    range_m = np.linspace(*RANGES_M[dataset][::-1], n)
    tables = [_scores_of_core(core, pct * scale, range_m, rng) for core, pct in SCALES_PCT.items()]
    return with_all_columns(pd.concat(tables, ignore_index=True))[list(COLUMNS)]


def _scores_of_core(
    core: str, pct: float, range_m: np.ndarray, rng: np.random.Generator
) -> pd.DataFrame:
    n = len(range_m)
    error_m = rng.normal(size=(n, 3)) * [1.0, 1.0, 0.4] * (pct / 170 * range_m)[:, None]
    norm_m = np.linalg.norm(error_m, axis=1)
    angle_deg = np.abs(rng.normal(size=(n, 3))) * pct * 0.4
    vectors = {"error_trs_{}_m": error_m, "error_cam_{}_m": error_m, "axis_error_{}_deg": angle_deg}
    return pd.DataFrame(
        {
            "core": core,
            "shot_id": np.arange(1, n + 1),
            "status": "ok",
            "range_los_m": range_m,
            "usable_fraction": np.clip(1.4 / range_m, 0.2, 1.0),
            "position_error_m": norm_m,
            "position_error_pct_los": 100 * norm_m / range_m,
            "rotation_error_deg": angle_deg.max(axis=1),
            "n_features": rng.integers(800, 1500, n),
            "n_matches": rng.integers(80, 150, n),
            "n_inliers": rng.integers(40, 80, n),
            "time_detect_s": rng.uniform(0.2, 0.4, n),
            "time_match_s": rng.uniform(0.02, 0.04, n),
            "time_pose_s": rng.uniform(0.001, 0.004, n),
            "truth_state": "good",
            "sigma_truth_m": 1e-4,
            "bound_m": norm_m.mean() / 1.2 if core.endswith("refined") else np.nan,
            **{
                name.format(axis): values[:, i]
                for name, values in vectors.items()
                for i, axis in enumerate("xyz")
            },
        }
    )


def perturbation_table() -> pd.DataFrame:
    """Measures of figure 19, unrelated to the error."""
    rng = np.random.default_rng(19)
    tables = []
    for dataset in ("dataset_1_perturbed", "dataset_2_perturbed"):
        scores = scores_of(dataset)
        n = len(scores)
        horizontal_m, plane_m = rng.uniform(0, 1.4, n), rng.uniform(0, 0.3, n)
        tables.append(
            pd.DataFrame(
                {
                    "dataset": dataset,
                    "core": scores["core"],
                    "shot_id": scores["shot_id"],
                    "trajectory": rng.integers(1, 21, n),
                    "paired_shot_id": 1,
                    "plane_distance_m": plane_m,
                    "horizontal_distance_m": horizontal_m,
                    "angle_difference_deg": rng.uniform(0, 5, n),
                    "plane_distance_pct_los": 100 * plane_m / scores["range_los_m"],
                    "horizontal_distance_pct_los": 100 * horizontal_m / scores["range_los_m"],
                    "position_error_pct_los": scores["position_error_pct_los"],
                }
            )
        )
    return pd.concat(tables, ignore_index=True)


def rank_table() -> pd.DataFrame:
    correlation = (0.07, -0.06, 0.2, 0.27)
    measures = ("plane_distance_pct_los", "horizontal_distance_pct_los", "angle_difference_deg")
    rows = [
        (dataset, core, measure, DATASETS[dataset].n_shots, *correlation, *correlation)
        for dataset in ("dataset_1_perturbed", "dataset_2_perturbed")
        for core in SCALES_PCT
        for measure in measures
    ]
    numbers = ["spearman_rho", "low", "high", "p"]
    partial = ["partial_rho", "partial_low", "partial_high", "partial_p"]
    return pd.DataFrame(rows, columns=["dataset", "core", "measure", "n", *numbers, *partial])


def selection_table() -> pd.DataFrame:
    variants = {
        "spread_matches": ("matches spread over the image", "spread", "akaze", 0.11, 0.06, 0.16),
        "ratio": ("ratio test at 0.8", "ratio", "akaze", 0.02, -0.03, 0.07),
        "mutual": ("mutual check", "mutual", "akaze", 0.09, 0.03, 0.15),
        "ransac": ("geometric verification", "geometry", "akaze", 0.35, 0.28, 0.44),
        "no_second_look": ("no guided second look", "guided", "akaze-refined", -0.02, -0.03, -0.01),
        "pruned": ("a tenth of the landmarks", "pruning", "akaze-refined", -0.004, -0.01, 0.002),
    }
    common = {
        "n": 12, "n_solved": 12, "median_pct_los": 0.5, "max_pct_los": 1.9, "inlier_share": 0.8,
        "time_all_s": 0.4, "n_matches": 100, "n_inliers": 80,
    }  # fmt: skip
    rows = [
        {
            "variant": name, "title": title, "step": step, "base": base, "dataset": dataset,
            "mean_pct_los": 0.6 - gain, "gain_pct_los": gain, "gain_low": low, "gain_high": high,
            "p": 0.0004, "p_holm": 0.004 if low * high > 0 else 0.4, "n_paired": 12, **common,
        }
        for dataset in ("dataset_1_nominal", "dataset_2_nominal", "all")
        for name, (title, step, base, gain, low, high) in variants.items()
    ]  # fmt: skip
    bases = [
        {
            "variant": base, "title": "as it is", "step": "base", "base": base, "dataset": "all",
            "mean_pct_los": 0.6, **common,
        }
        for base in ("akaze", "akaze-refined")
    ]  # fmt: skip
    return pd.DataFrame([*bases, *rows])


def load_table() -> pd.DataFrame:
    """Time of detection grows with pixels, of matching with features and landmarks."""
    varied = {
        "image": ([512, 1024, 2048], lambda v: 0.2 * (v / 1024) ** 2, lambda v: 0.03),
        "features": ([500, 2000, 8000], lambda v: 0.2, lambda v: 0.03 * v / 2000),
        "landmarks": ([10_000, 100_000, 1_000_000], lambda v: 0.2, lambda v: 0.03 * v / 1e5),
    }
    rows = [
        {
            "varied": name, "value": value, "core": core, "time_detect_s": detect(value),
            "time_match_s": match(value), "time_pose_s": 0.002,
            "time_all_s": detect(value) + match(value) + 0.002,
            "peak_memory_mb": 150 + value / 4000, "n_features": 2000, "n_landmarks": 50_000,
            "error_pct_los": 0.05,
        }
        for core in ("akaze", "akaze-refined")
        for name, (values, detect, match) in varied.items()
        for value in values
    ]  # fmt: skip
    return pd.DataFrame(rows)


def worst_table() -> pd.DataFrame:
    rows = [
        {
            "dataset": dataset, "core": core, "shot_id": 3, "error_pct_los": 1.5,
            "reason": "the view: 8 inliers within 4 deg", "picture": f"worst/{dataset}_{core}.jpg",
            "page": f"datasets/{dataset}/report.html#worst-{core}",
        }
        for dataset in DATASETS
        for core in SCALES_PCT
    ]  # fmt: skip
    return pd.DataFrame(rows)


def ablation_tables() -> dict[str, pd.DataFrame]:
    """A source that makes the error twice as large, for two cores."""
    usual = scores_of("dataset_0")
    usual = usual[usual["core"].isin(["akaze", "akaze-refined"])]
    half = usual.assign(
        position_error_m=usual["position_error_m"] / 2,
        position_error_pct_los=usual["position_error_pct_los"] / 2,
    )
    scores = {
        name: {"dataset_0": table}
        for name, table in {"all": usual, "without_dem": half, "none": half}.items()
    }
    shares = shares_table(scores)
    return {
        "ablation/ablation.csv": ablation_table(scores, [Source("dem", "coarse DEM", "terrain")]),
        "ablation/shares.csv": shares,
        "limits/limits.csv": limits_table(scores["all"], scores["none"], shares),
    }


def write_scores(folder: Path, scores: pd.DataFrame) -> None:
    folder.mkdir(parents=True)
    scores.to_csv(folder / "scores.csv", index=False)


def write_study(out: Path, *, datasets: tuple[str, ...] = tuple(DATASETS)) -> None:
    """Write the files of a study in which these datasets were taken."""
    for dataset in datasets:
        write_scores(out / "datasets" / dataset, scores_of(dataset))
    write_scores(out / "larger" / "dataset_1_nominal", scores_of("dataset_1_nominal", scale=0.4))
    for path, table in {
        "selection/selection.csv": selection_table(),
        "load/load.csv": load_table(),
        "perturbation/perturbation.csv": perturbation_table(),
        "perturbation/rank.csv": rank_table(),
        "worst/worst.csv": worst_table(),
        **ablation_tables(),
    }.items():
        (out / path).parent.mkdir(parents=True, exist_ok=True)
        table.to_csv(out / path, index=False)
    (out / "worst" / "dataset_0_akaze.jpg").write_bytes(b"")
    steps = [
        {"name": "record dataset_0", "seconds": 200.0, "peak_memory_mb": 900.0},
        {"name": "load", "seconds": 300.0, "peak_memory_mb": 2400.0},
    ]
    info = {"title": "A study", "quick": False, "software": {"numpy": "2"}, "steps": steps}
    (out / "study.json").write_text(json.dumps(info))
