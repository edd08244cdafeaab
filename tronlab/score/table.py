"""The table of scores: its columns, and one row of it."""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from tronlab.dataset.records import Truth
from tronlab.dataset.schema import TruthState
from tronlab.nav.core import NavigationResult
from tronlab.score.metrics import pose_errors

COLUMNS = {
    "core": "str",
    "shot_id": "int64",
    "status": "str",
    "range_los_m": "float64",
    "usable_fraction": "float64",
    "position_error_m": "float64",
    "position_error_pct_los": "float64",
    "error_trs_x_m": "float64",
    "error_trs_y_m": "float64",
    "error_trs_z_m": "float64",
    "error_cam_x_m": "float64",
    "error_cam_y_m": "float64",
    "error_cam_z_m": "float64",
    "axis_error_x_deg": "float64",
    "axis_error_y_deg": "float64",
    "axis_error_z_deg": "float64",
    "rotation_error_deg": "float64",
    "n_features": "int64",
    "n_matches": "int64",
    "n_inliers": "int64",
    "time_detect_s": "float64",
    "time_match_s": "float64",
    "time_pose_s": "float64",
    "truth_state": "str",
}
"""Columns of ``scores.csv`` in their order, and the type of each."""

Row = dict[str, str | int | float]


def score_row(
    core: str, shot_id: int, *, truth: Truth, truth_state: TruthState, result: NavigationResult
) -> Row:
    """Give the row of one shot and core; without a pose its error cells stay empty."""
    row: Row = {
        "core": core,
        "shot_id": shot_id,
        "status": result.status,
        "range_los_m": truth.range_los_m,
        "usable_fraction": truth.usable_fraction,
        "truth_state": truth_state,
        "n_features": result.n_features,
        "n_matches": result.n_matches,
        "n_inliers": result.n_inliers,
        "time_detect_s": result.time_detect_s,
        "time_match_s": result.time_match_s,
        "time_pose_s": result.time_pose_s,
    }
    return row | _error_cells(truth, result)


def score_table(rows: Iterable[Row]) -> pd.DataFrame:
    """Put rows into a table with all columns, in their order."""
    table = pd.DataFrame(list(rows), columns=list(COLUMNS))
    return table.astype(COLUMNS)


def _error_cells(truth: Truth, result: NavigationResult) -> Row:
    if result.status != "ok" or result.trs_from_cam is None:
        return {}
    errors = pose_errors(result.trs_from_cam, truth.trs_from_cam)
    vectors = {
        "error_trs_{}_m": errors.error_trs_m,
        "error_cam_{}_m": errors.error_cam_m,
        "axis_error_{}_deg": np.degrees(errors.axis_errors_rad),
    }
    cells: Row = {
        name.format(axis): float(value)
        for name, values in vectors.items()
        for axis, value in zip("xyz", values, strict=True)
    }
    cells["position_error_m"] = errors.position_error_m
    cells["position_error_pct_los"] = 100.0 * errors.position_error_m / truth.range_los_m
    cells["rotation_error_deg"] = float(np.degrees(errors.rotation_error_rad))
    return cells
