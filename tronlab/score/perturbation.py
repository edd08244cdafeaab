"""How far shots are off a nominal trajectory, and whether errors follow it (paper, section 5.2).

The paper judges its figure 19 by eye; here a rank correlation does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
import pandas as pd
from scipy.spatial.transform import RigidTransform
from scipy.stats import false_discovery_control

from tronlab.dataset.reader import Dataset
from tronlab.geometry.poses import FloatArray
from tronlab.score.evaluation.rank import RankCorrelation, rank_correlation
from tronlab.score.evaluation.resampling import Interval

MEASURES = (
    "plane_distance_pct_los",
    "horizontal_distance_pct_los",
    "angle_difference_deg",
    "angle_difference_x_deg",
    "angle_difference_y_deg",
    "angle_difference_z_deg",
)
"""Columns of the table of perturbations that the error may follow; angles by their size."""
_ERROR = "position_error_pct_los"
_FALSE_DISCOVERY_RATE = 0.05
_VIEW = ("range_los_m", "usable_fraction")
"""What errors depend on by themselves, and what differs along a trajectory as perturbations do."""


@dataclass(frozen=True, slots=True)
class TrueViews:
    """The true camera poses of a dataset's shots."""

    shot_ids: tuple[int, ...]
    trs_from_cam: tuple[RigidTransform, ...]
    range_los_m: FloatArray
    """Shape (n,)."""


@dataclass(frozen=True, slots=True)
class Perturbations:
    """How far each of n shots is off the nominal one it is paired with.

    Differences are those of the true poses, not of the planned ones.
    """

    shot_id: tuple[int, ...]
    paired_shot_id: tuple[int, ...]
    """Of the nominal dataset: least difference of Z in trs, the first of equals."""
    plane_distance_m: FloatArray
    """Difference of Z in trs, shape (n,)."""
    horizontal_distance_m: FloatArray
    """Distance in X and Y of trs, shape (n,)."""
    plane_distance_pct_los: FloatArray
    """Over the range along the optical axis of the shot itself, not of the nominal one."""
    horizontal_distance_pct_los: FloatArray
    angle_difference_deg: FloatArray
    """Angle of the rotation from the nominal to the shot's attitude, shape (n,)."""
    angle_difference_x_deg: FloatArray
    """Component about X of trs of its rotation vector, with its sign."""
    angle_difference_y_deg: FloatArray
    angle_difference_z_deg: FloatArray


def true_views(dataset: Dataset) -> TrueViews:
    """Read the true poses of a dataset.

    Raises:
        IntegrityError: What is read is damaged.
    """
    truths = [dataset.truth(i) for i in range(dataset.n_shots)]
    return TrueViews(
        tuple(dataset.shot_ids.tolist()),
        tuple(truth.trs_from_cam for truth in truths),
        np.array([truth.range_los_m for truth in truths], dtype=np.float64),
    )


def perturbations(shots: TrueViews, nominal: TrueViews) -> Perturbations:
    """Pair every shot with a nominal one, and measure how far they are apart.

    Args:
        shots: Of the perturbed trajectories; there may be none.
        nominal: Of the nominal one, at least one.
    """
    p_m, p_nominal_m = _positions_m(shots), _positions_m(nominal)
    apart_m = np.abs(p_m[:, None, 2] - p_nominal_m[None, :, 2])
    pair = apart_m.argmin(axis=1)
    plane_m = apart_m.min(axis=1)
    horizontal_m = np.linalg.norm((p_m - p_nominal_m[pair])[:, :2], axis=1)
    turns = [
        (pose.rotation * nominal.trs_from_cam[i].rotation.inv()).as_rotvec()
        for pose, i in zip(shots.trs_from_cam, pair.tolist(), strict=True)
    ]
    turn_deg = np.degrees(np.array(turns).reshape(-1, 3))
    return Perturbations(
        shot_id=shots.shot_ids,
        paired_shot_id=tuple(nominal.shot_ids[i] for i in pair.tolist()),
        plane_distance_m=plane_m,
        horizontal_distance_m=horizontal_m,
        plane_distance_pct_los=100.0 * plane_m / shots.range_los_m,
        horizontal_distance_pct_los=100.0 * horizontal_m / shots.range_los_m,
        angle_difference_deg=np.linalg.norm(turn_deg, axis=1),
        angle_difference_x_deg=turn_deg[:, 0],
        angle_difference_y_deg=turn_deg[:, 1],
        angle_difference_z_deg=turn_deg[:, 2],
    )


def perturbation_table(
    dataset: str, scores: pd.DataFrame, found: Perturbations, trajectories: Mapping[int, int]
) -> pd.DataFrame:
    """Put measures and errors side by side, one row an answer.

    Args:
        dataset: Its name.
        scores: Of the dataset, as ``scores.csv`` has them.
        found: Of its shots.
        trajectories: Number of the trajectory that each shot belongs to, by shot id.

    Returns:
        Errors are NaN where there is no pose.
    """
    measures = pd.DataFrame({field.name: getattr(found, field.name) for field in fields(found)})
    measures.insert(1, "trajectory", [trajectories[shot_id] for shot_id in found.shot_id])
    answers = scores[["core", "shot_id", "seed", *_VIEW, _ERROR]]
    table = answers.merge(measures, on="shot_id", how="left", validate="many_to_one")
    table.insert(0, "dataset", dataset)
    first = ["dataset", "core", "shot_id", "seed", "trajectory", "paired_shot_id"]
    return table[[*first, *(name for name in table.columns if name not in first)]]


def rank_table(perturbation: pd.DataFrame) -> pd.DataFrame:
    """Correlate the errors of each dataset and core with every measure of the perturbation.

    Repeats of a shot with other seeds count once, by their mean. Interval and probability keep
    trajectories whole: shots of one are perturbed alike. Six of them can be exchanged in 720 ways,
    so that no probability is below 0.0014. Beside each correlation stands the partial one,
    given range and usable fraction (``partial_``): both make errors larger, and both are tied to
    where on its trajectory a shot is, as the perturbation is.
    """
    rows: list[dict[str, object]] = []
    for (dataset, core), answers in perturbation.groupby(["dataset", "core"], sort=False):
        shots = answers.groupby("shot_id").mean(numeric_only=True)
        for measure in MEASURES:
            plain, partial = _correlations(shots, measure)
            rows.append(
                {
                    "dataset": dataset,
                    "core": core,
                    "measure": measure,
                    "n": plain.n,
                    **_cells("spearman_rho", "", plain),
                    **_cells("partial_rho", "partial_", partial),
                }
            )
    return pd.DataFrame(rows, columns=list(_RANK_COLUMNS))


def view_sentence(ranks: pd.DataFrame) -> str:
    """Say whether it changes what follows that range and usable fraction are held.

    Of many correlations some are large by chance: Benjamini and Hochberg's rule (Journal of the
    Royal Statistical Society B 57 (1995), 289) counts.

    Args:
        ranks: What ``rank_table`` gives.
    """
    known = ranks[np.isfinite(ranks["p"]) & np.isfinite(ranks["partial_p"])]
    if known.empty:
        return "No correlation could be computed."
    is_plain, is_partial = (
        false_discovery_control(known[p].to_numpy(np.float64)) < _FALSE_DISCOVERY_RATE
        for p in ("p", "partial_p")
    )
    changed = int((is_plain != is_partial).sum())
    start = (
        f"Of {len(known)} correlations {int(is_plain.sum())} differ from zero (at a false discovery"
        f" rate of 5 %), and {int(is_partial.sum())} once range and usable fraction are held"
    )
    return f"{start}: " + (f"{changed} change." if changed else "the answer stays.")


_RANK_COLUMNS = (
    "dataset",
    "core",
    "measure",
    "n",
    "spearman_rho",
    "low",
    "high",
    "p",
    "partial_rho",
    "partial_low",
    "partial_high",
    "partial_p",
)


def _correlations(shots: pd.DataFrame, measure: str) -> tuple[RankCorrelation, RankCorrelation]:
    """Give the correlation of a measure with the error, and that given the view."""
    x, y = shots[measure].abs().to_numpy(np.float64), shots[_ERROR].to_numpy(np.float64)
    trajectory = shots["trajectory"].to_numpy()
    view = shots[list(_VIEW)].to_numpy(np.float64)
    return (
        rank_correlation(x, y, groups=trajectory),
        rank_correlation(x, y, given=view, groups=trajectory),
    )


def _cells(name: str, prefix: str, found: RankCorrelation) -> dict[str, float]:
    interval = found.interval or Interval(np.nan, np.nan)
    return {
        name: found.rho,
        f"{prefix}low": interval.low,
        f"{prefix}high": interval.high,
        f"{prefix}p": found.p,
    }


def _positions_m(views: TrueViews) -> FloatArray:
    """Give the camera centres in trs, shape (n, 3)."""
    poses: Sequence[RigidTransform] = views.trs_from_cam
    return np.array([pose.translation for pose in poses], dtype=np.float64).reshape(-1, 3)
