"""What limits the accuracy of each core: its error beside its bound, its truth and its shares."""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from tronlab.score.evaluation.ablation import METRIC, PARTS
from tronlab.score.evaluation.consistency import efficiency, floor_m


def limits_table(
    scores: Mapping[str, pd.DataFrame],
    without_any: Mapping[str, pd.DataFrame],
    shares: pd.DataFrame,
) -> pd.DataFrame:
    """Put beside each other what could limit each core on each dataset.

    Args:
        scores: Rows of ``scores.csv`` of each dataset.
        without_any: Those of the ablation's variant without any source of error.
        shares: As ``shares_table`` gives them.

    Returns:
        A row a dataset and core: ``dataset``, ``core``, ``n``, ``n_solved``; ``median_pct_los`` and
        ``mean_pct_los`` of the error; medians ``bound_pct_los`` of the Cramer-Rao bound and
        ``truth_sigma_pct_los`` of the truth's own sigma; quartiles of error over bound,
        ``error_over_bound_q25``, ``_median`` and ``_q75``, and of error over the truth's sigma
        ``error_over_truth_median``; ``floor_pct_los``, the median of what a perfect estimator would
        show, bound and truth together, and quartiles of error over it, ``error_over_floor_q25``,
        ``_median`` and ``_q75``; ``bound_rho``, the rank correlation of error and bound over the
        shots; ``none_over_bound``, the median of error over bound where no source of error is left;
        ``share_PART``, and ``largest`` if one of them certainly is. What the ablation did not look
        at is NaN, and ``largest`` empty.
    """
    rows = [
        {
            "dataset": dataset,
            "core": core,
            **_errors(table[table["core"] == core]),
            "none_over_bound": _none_over_bound(without_any.get(dataset), str(core)),
            **_shares_of(shares, dataset, str(core)),
        }
        for dataset, table in scores.items()
        for core in table["core"].unique()
    ]
    return pd.DataFrame(rows)


def _errors(rows: pd.DataFrame) -> dict[str, float]:
    solved = rows[rows["status"] == "ok"]
    error_m = solved["position_error_m"]
    to_pct_los = 100.0 / solved["range_los_m"]
    over_bound = error_m / solved["bound_m"]
    over_floor = error_m / floor_m(solved)
    return {
        "n": int(rows["shot_id"].nunique()),
        "n_solved": len(solved),
        "median_pct_los": _quantile(solved[METRIC], 0.5),
        "mean_pct_los": float(solved[METRIC].mean()),
        "bound_pct_los": _quantile(solved["bound_m"] * to_pct_los, 0.5),
        "truth_sigma_pct_los": _quantile(solved["sigma_truth_m"] * to_pct_los, 0.5),
        "error_over_bound_q25": _quantile(over_bound, 0.25),
        "error_over_bound_median": _quantile(over_bound, 0.5),
        "error_over_bound_q75": _quantile(over_bound, 0.75),
        "floor_pct_los": _quantile(floor_m(solved) * to_pct_los, 0.5),
        "error_over_floor_q25": _quantile(over_floor, 0.25),
        "error_over_floor_median": _quantile(over_floor, 0.5),
        "error_over_floor_q75": _quantile(over_floor, 0.75),
        "error_over_truth_median": _quantile(error_m / solved["sigma_truth_m"], 0.5),
        "bound_rho": _rank_correlation(solved[METRIC], solved["bound_m"] * to_pct_los),
    }


def _none_over_bound(none: pd.DataFrame | None, core: str) -> float:
    if none is None:
        return np.nan
    return efficiency(none[none["core"] == core]).median_ratio


def _shares_of(shares: pd.DataFrame, dataset: str, core: str) -> dict[str, float | str]:
    own = shares[(shares["dataset"] == dataset) & (shares["core"] == core)]
    by_part = dict(zip(own["part"], own["share"].astype(float), strict=True))
    largest = own.loc[own["is_largest"].astype(bool), "part"]
    return {
        **{f"share_{part}": by_part.get(part, np.nan) for part in PARTS},
        "largest": str(largest.iloc[0]) if len(largest) else "",
    }


def _quantile(values: "pd.Series[float]", share: float) -> float:
    v = values.to_numpy(np.float64)
    v = v[np.isfinite(v)]
    return float(np.quantile(v, share)) if v.size else np.nan


def _rank_correlation(a: "pd.Series[float]", b: "pd.Series[float]") -> float:
    """Give Spearman's rho; NaN of fewer than three shots, or if all are alike."""
    both = np.isfinite(a) & np.isfinite(b)
    ranks = [values[both].rank().to_numpy(np.float64) for values in (a, b)]
    if both.sum() < 3 or min(np.ptp(rank) for rank in ranks) == 0.0:
        return np.nan
    return float(np.corrcoef(ranks[0], ranks[1])[0, 1])
