"""Errors against what can be known: the truth's own sigma, the core's covariance, the bound."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from tronlab.geometry.poses import FloatArray
from tronlab.score.evaluation.recall import Share, share_of
from tronlab.score.evaluation.resampling import CONFIDENCE, Interval

N_SIGMA_TRUTH = 2.0
"""An error below so many sigmas of the truth may be the truth's own."""
NEES_DOF = 3
"""Of a position."""

Verdict: TypeAlias = Literal["consistent", "too sure", "too cautious", "not known"]


@dataclass(frozen=True, slots=True)
class TruthLimit:
    """How often the laboratory, and not the core, sets the limit."""

    within: Share
    """Poses with an error below ``N_SIGMA_TRUTH`` sigmas of the truth."""
    median_ratio: float
    """Of error over the truth's sigma; NaN if no sigma is known."""


@dataclass(frozen=True, slots=True)
class Consistency:
    """Whether a core's covariances are as large as its errors."""

    n: int
    """Poses with a covariance."""
    mean_nees: float
    """Mean of the normalised estimation error squared; ``NEES_DOF`` if all is honest."""
    bounds: Interval
    """Where the mean of honest covariances lies with 95 % confidence."""

    @property
    def verdict(self) -> Verdict:
        """Get what follows: too sure, if errors are larger than the core says."""
        if not self.n:
            return "not known"
        if self.mean_nees > self.bounds.high:
            return "too sure"
        return "too cautious" if self.mean_nees < self.bounds.low else "consistent"


@dataclass(frozen=True, slots=True)
class Efficiency:
    """Errors against the least that the measurements allow."""

    n: int
    """Poses with a bound."""
    rms_ratio: float
    """Root of the mean square of error over bound: 1 for an estimator that reaches the bound, more
    for one that does not, and also if the truth's own error is not small against the bound."""
    median_ratio: float


def truth_limit(rows: pd.DataFrame) -> TruthLimit:
    """Compare the errors of one core with the sigma of the truth."""
    known, ratios = _ratios(rows, "sigma_truth_m")
    is_within = ratios < N_SIGMA_TRUTH
    return TruthLimit(share_of(is_within, int(known["shot_id"].nunique())), _median(ratios))


def nees_consistency(rows: pd.DataFrame) -> Consistency:
    """Test the covariances of one core.

    Repeats of a shot count once, by their mean.
    """
    solved = rows[(rows["status"] == "ok") & np.isfinite(rows["nees"])]
    of_shots = solved.groupby("shot_id")["nees"].mean()
    n_shots = len(of_shots)
    if not n_shots:
        return Consistency(0, np.nan, Interval(0.0, np.inf))
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = nees_quantiles([tail, 1.0 - tail], n_shots)
    return Consistency(len(solved), float(of_shots.mean()), Interval(float(low), float(high)))


def nees_quantiles(shares: ArrayLike, n_shots: int = 1) -> FloatArray:
    """Give quantiles of the mean NEES of honest covariances.

    The sum of the NEES of n honest poses follows chi-square with 3 n degrees of freedom
    (Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    section 5.4.2), whose distribution is an incomplete gamma function.

    Args:
        shares: Which quantiles, 0 to 1, any shape; likewise what is returned.
        n_shots: Over how many poses the mean is.
    """
    from scipy.special import gammaincinv

    return 2.0 * gammaincinv(0.5 * NEES_DOF * n_shots, np.asarray(shares)) / n_shots


def efficiency(rows: pd.DataFrame) -> Efficiency:
    """Compare the errors of one core with the Cramer-Rao bounds of its measurements."""
    return _efficiency(rows, "bound_m")


def floor_m(rows: pd.DataFrame) -> "pd.Series[float]":
    """Give the error that a perfect estimator would show in each row, shape (n,).

    An error is estimate minus truth: the bound of the one and the sigma of the other add as
    squares, for they are independent. NaN where either is not known.
    """
    return (rows["bound_m"] ** 2 + rows["sigma_truth_m"] ** 2) ** 0.5


def efficiency_with_truth(rows: pd.DataFrame) -> Efficiency:
    """Compare the errors of one core with what a perfect estimator would show."""
    return _efficiency(rows.assign(floor_m=floor_m(rows)), "floor_m")


def _efficiency(rows: pd.DataFrame, of: str) -> Efficiency:
    _, ratios = _ratios(rows, of)
    rms = float(np.sqrt((ratios**2).mean())) if ratios.size else np.nan
    return Efficiency(int(ratios.size), rms, _median(ratios))


def _ratios(rows: pd.DataFrame, of: str) -> tuple[pd.DataFrame, FloatArray]:
    """Give the solved rows where a length is known, and position error over it."""
    known = rows[(rows["status"] == "ok") & (rows[of] > 0.0)]
    ratios = known["position_error_m"].to_numpy(np.float64) / known[of].to_numpy(np.float64)
    return known, ratios


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if values.size else np.nan
