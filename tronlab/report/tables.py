"""The report's tables of shots, and of what the paper states."""

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
import pandas as pd

from tronlab.geometry.poses import FloatArray
from tronlab.report.paper import DATASET_0, PAPER_CORES
from tronlab.score.evaluation.export import MISSING, Cell, Column, Table
from tronlab.score.evaluation.statistics import statistics

Reasons: TypeAlias = Mapping[tuple[str, int, int], str]
"""Why a core gave no pose, or a bad one, by core, seed and shot id."""
N_WORST = 5
"""Rows of the table of worst shots, a core."""

_POSITION = "position_error_pct_los"
_ROTATION = "rotation_error_deg"
_TIMES = ("time_detect_s", "time_match_s", "time_pose_s")
_COUNTS = ("n_features", "n_matches", "n_inliers")


def effort_table(scores: pd.DataFrame) -> Table:
    """Give, for each core, the medians over all shots of its counts and of the time of each stage.

    Shots without a pose are among them: they took their time as well.
    """
    columns = (
        Column("core", "core"),
        *(Column(f"{name}_median", name[2:], ".0f") for name in _COUNTS),
        *(Column(f"{name}_median", f"{name[5:-2]} [s]", ".3g") for name in _TIMES),
    )
    return Table(
        "effort",
        "Features and time of each core, median over all shots",
        columns,
        tuple(
            (core, *(_median(_finite(rows[name])) for name in (*_COUNTS, *_TIMES)))
            for core, rows in by_core(scores)
        ),
    )


def paper_table(scores: pd.DataFrame) -> Table:
    """Give our position errors beside what the paper states for the same estimator."""
    columns = (
        Column("core", "core"),
        Column("n_shots", "shots"),
        Column("n_answers", "answers"),
        Column("n_ok", "with pose"),
        Column("mean_pct_los", "mean [% LOS]", ".3g"),
        Column("max_pct_los", "max [% LOS]", ".3g"),
        Column("paper_detector", "paper: detector"),
        Column("paper_mean", "paper: mean"),
        Column("paper_max", "paper: max"),
        Column("within", "within the paper's bounds"),
    )
    return Table(
        "paper",
        f"Position error beside the paper's ({DATASET_0.dataset}, {DATASET_0.n_shots} shots)",
        columns,
        tuple(_paper_row(core, rows) for core, rows in by_core(scores)),
    )


def worst_shots_table(scores: pd.DataFrame, reasons: Reasons) -> Table:
    """Give the shots of each core without a pose and with the largest position errors, worst first.

    Args:
        scores: At most ``N_WORST`` of a core are shown.
        reasons: Why they are so bad.
    """
    columns = (
        Column("core", "core"),
        Column("shot_id", "shot"),
        Column("seed", "seed"),
        Column("status", "status"),
        Column("range_los_m", "range [m]", ".3f"),
        Column(_POSITION, "position [% LOS]", ".3g"),
        Column("position_error_mm", "position [mm]", ".3g"),
        Column(_ROTATION, "rotation [deg]", ".3g"),
        Column("n_matches", "matches"),
        Column("n_inliers", "inliers"),
        Column("truth_state", "truth"),
        Column("reason", "why"),
    )
    rows: list[tuple[Cell, ...]] = []
    for _, of_core in by_core(scores):
        shown = worst_first(of_core).head(N_WORST)
        shown = shown.assign(position_error_mm=1e3 * shown["position_error_m"])
        shown = _with_reason(shown, reasons)
        rows += _rows(shown, columns)
    return Table("worst_shots", "Worst shots of each core", columns, tuple(rows))


def shots_table(scores: pd.DataFrame, core: str, reasons: Reasons) -> Table:
    """Give every shot of one core."""
    columns = (
        Column("shot_id", "shot"),
        Column("seed", "seed"),
        Column("status", "status"),
        Column("range_los_m", "range [m]", ".3f"),
        Column("usable_fraction", "usable", ".2f"),
        Column(_POSITION, "position [% LOS]", ".3g"),
        *(Column(f"error_trs_{a}_m", f"{a} trs [m]", ".2e") for a in "xyz"),
        *(Column(f"axis_error_{a}_deg", f"axis {a} [deg]", ".3g") for a in "xyz"),
        Column(_ROTATION, "rotation [deg]", ".3g"),
        *(Column(name, name[2:]) for name in _COUNTS),
        *(Column(name, f"{name[5:-2]} [s]", ".3g") for name in _TIMES),
        Column("truth_state", "truth"),
        Column("reason", "why no pose"),
    )
    rows = _rows(_with_reason(scores[scores["core"] == core], reasons), columns)
    return Table("shots", f"Every shot of {core}", columns, tuple(rows))


def worst_first(rows: pd.DataFrame) -> pd.DataFrame:
    """Sort the shots of a core: those without a pose first, then the largest position error."""
    is_solved = rows["status"] == "ok"
    return (
        rows.assign(_is_solved=is_solved)
        .sort_values(
            ["_is_solved", _POSITION, "shot_id", "seed"],
            ascending=[True, False, True, True],
            kind="stable",
        )
        .drop(columns="_is_solved")
    )


def cores_of(scores: pd.DataFrame) -> list[str]:
    """Give the names of the cores in the order the scores have them."""
    return [str(core) for core in pd.unique(scores["core"])]


def by_core(scores: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """Give the rows of each core, in the order the scores have them."""
    return [(core, scores[scores["core"] == core]) for core in cores_of(scores)]


def _statistics(values: "pd.Series[float]") -> dict[str, float]:
    """Give the statistics of ``summary.json``, NaN where there are none."""
    return {name: np.nan if value is None else value for name, value in statistics(values).items()}


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if values.size else np.nan


def _paper_row(core: str, rows: pd.DataFrame) -> tuple[Cell, ...]:
    solved = rows[rows["status"] == "ok"]
    error = _statistics(solved[_POSITION])
    is_within = (
        len(solved) == len(rows)
        and error["mean"] < DATASET_0.mean_below_pct_los
        and error["max"] < DATASET_0.max_below_pct_los
    )
    return (
        core,
        int(rows["shot_id"].nunique()),
        len(rows),
        len(solved),
        error["mean"],
        error["max"],
        PAPER_CORES.get(core, MISSING),
        f"< {DATASET_0.mean_below_pct_los:g} %" if core in PAPER_CORES else MISSING,
        f"< {DATASET_0.max_below_pct_los:g} %" if core in PAPER_CORES else MISSING,
        _verdict(is_within) if core in PAPER_CORES else MISSING,
    )


def _verdict(is_within: bool) -> str:
    return "yes" if is_within else "no"


def _with_reason(rows: pd.DataFrame, reasons: Reasons) -> pd.DataFrame:
    keys = zip(*(rows[name].tolist() for name in ("core", "seed", "shot_id")), strict=True)
    return rows.assign(reason=[reasons.get(key, "") for key in keys])


def _rows(frame: pd.DataFrame, columns: Sequence[Column]) -> list[tuple[Cell, ...]]:
    lists = [frame[column.name].tolist() for column in columns]
    return list(zip(*lists, strict=True))


def _finite(column: "pd.Series[float]") -> FloatArray:
    values = np.asarray(column, dtype=np.float64)
    return values[np.isfinite(values)]
