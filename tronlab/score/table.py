"""The table of scores: its columns, and one row of it."""

import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pandas as pd
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Truth
from tronlab.dataset.schema import TruthState
from tronlab.nav.core import NavigationResult
from tronlab.score.light import lamp_position, phase_angle_rad
from tronlab.score.metrics import pose_errors, position_nees, position_sigma_m

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
    "seed": "int64",
    "sigma_truth_m": "float64",
    "sigma_core_m": "float64",
    "bound_m": "float64",
    "nees": "float64",
    "phase_deg": "float64",
    "truth_crc": "int64",
}
"""Columns of ``scores.csv`` in their order, and the type of each."""

DEFAULTS: Mapping[str, str | int | float] = MappingProxyType(
    {
        "truth_state": "unchecked",
        "seed": 0,
        "sigma_truth_m": np.nan,
        "sigma_core_m": np.nan,
        "bound_m": np.nan,
        "nees": np.nan,
        "phase_deg": np.nan,
        "truth_crc": 0,
    }
)
"""What stands for a column that a table of an earlier version does not have."""

Row = dict[str, str | int | float]


@dataclass(frozen=True, slots=True)
class ShotFacts:
    """What is known of a shot, whichever core looks at it."""

    shot_id: int
    truth: Truth
    truth_state: TruthState
    phase_rad: float = float("nan")
    """Angle at the terrain between camera and lamp; NaN if nobody knows where the lamp was."""


def shot_facts(dataset: Dataset, i: int) -> ShotFacts:
    """Read what is known of shot ``i``, with the lamp where the shot's own session had it."""
    truth, number = dataset.truth(i), dataset.session(i)
    records = {session.number: session.calibration_json for session in dataset.sessions}
    lamp = lamp_position(records.get(number, dataset.provenance.calibration_json))
    return ShotFacts(
        shot_id=int(dataset.shot_ids[i]),
        truth=truth,
        truth_state=dataset.truth_states[i],
        phase_rad=np.nan if lamp is None else phase_angle_rad(truth, np.array(lamp)),
    )


def score_row(core: str, seed: int, shot: ShotFacts, result: NavigationResult) -> Row:
    """Give the row of one shot and core; without a pose its error cells stay empty."""
    truth = shot.truth
    row: Row = {
        "core": core,
        "shot_id": shot.shot_id,
        "status": result.status,
        "range_los_m": truth.range_los_m,
        "usable_fraction": truth.usable_fraction,
        "n_features": result.n_features,
        "n_matches": result.n_matches,
        "n_inliers": result.n_inliers,
        "time_detect_s": result.time_detect_s,
        "time_match_s": result.time_match_s,
        "time_pose_s": result.time_pose_s,
        "truth_state": shot.truth_state,
        "seed": seed,
        "sigma_truth_m": position_sigma_m(truth.covariance),
        "phase_deg": float(np.degrees(shot.phase_rad)),
        "truth_crc": pose_crc(truth.trs_from_cam),
    }
    return row | _error_cells(truth, result)


def pose_crc(trs_from_cam: RigidTransform) -> int:
    """Give the checksum of a pose by which scores of the same truth are known; never 0.

    It is the CRC-32 of position and rotation matrix, rounded to a billionth of metre and unit:
    another computer, whose last digits differ, has the same.
    """
    billionths = np.rint(1e9 * trs_from_cam.as_matrix()[:3]).astype("<i8")
    return zlib.crc32(billionths.tobytes()) or 1


def score_table(rows: Iterable[Row]) -> pd.DataFrame:
    """Put rows into a table with all columns, in their order."""
    table = pd.DataFrame(list(rows), columns=list(COLUMNS))
    return table.astype(COLUMNS)


def with_all_columns(table: pd.DataFrame) -> pd.DataFrame:
    """Give a table of an earlier version the columns it lacks, as ``DEFAULTS`` has them."""
    return table.assign(**{n: value for n, value in DEFAULTS.items() if n not in table.columns})


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
    cells["sigma_core_m"] = position_sigma_m(result.covariance)
    cells["bound_m"] = position_sigma_m(result.bound)
    cells["nees"] = position_nees(errors.error_trs_m, result.covariance, truth.covariance)
    return cells
