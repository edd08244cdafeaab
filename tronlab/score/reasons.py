"""Why the error of a shot is as large as it is, in one sentence.

What dominates is decided in this order; the first that applies is the reason:

1. *no pose*: the core said why.
2. *truth*: the error is below ``N_SIGMA_TRUTH`` sigmas of the truth, and may be the truth's own.
3. *wrong matches*: they are at least half of those the pose rests on. Or robust least squares on
   the very same matches, begun at the truth, would have at most ``ESTIMATOR_PART`` of the error,
   and ``WRONG_SHARE`` of them are wrong. If fewer are, it is the *estimator*, which makes less of
   right matches than they hold.
4. *view*: the error is within ``N_BOUNDS`` Cramer-Rao bounds: no estimator does much better with so
   few matches, or so far, or so close together.
5. *landmarks*: the matches are right, and the view would allow more. Then all of them are displaced
   together: by light, terrain model or calibration that are not as believed.
6. *unknown*: neither the matches nor a bound are known, as with many cores of others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

N_SIGMA_TRUTH = 2.0
ESTIMATOR_PART = 0.5
WRONG_SHARE = 0.05
_MOST_WRONG = 0.5
WRONG_PX = 4.0
"""A match is wrong if the true pose puts its landmark farther off than this."""
N_BOUNDS = 3.0

Cause: TypeAlias = Literal[
    "no pose", "truth", "wrong matches", "estimator", "view", "landmarks", "unknown"
]


@dataclass(frozen=True, slots=True)
class Evidence:
    """What is known of one answer, besides its row of the scores. NaN: not known."""

    no_pose: str = ""
    """Why there is no pose, as the core says."""
    flags: Sequence[str] = ()
    """What the quality gate held against the shot: saturation, contrast..."""
    width_deg: float = np.nan
    """Angle that the matches of the pose cover, across the image."""
    height_deg: float = np.nan
    """Likewise from top to bottom."""
    wrong_share: float = np.nan
    """Of the matches the pose rests on, those farther than ``WRONG_PX`` off at the true pose."""
    refit_error_m: float = np.nan
    """Position error of robust least squares on these matches, begun at the truth; infinite if they
    do not determine a pose."""
    noise_px: float = np.nan
    """Of that least squares: standard deviation of one coordinate, of the most certain matches."""
    smooth_ratio: float = np.nan
    """Of it, too: variance of the position over what independent noise would make it."""


@dataclass(frozen=True, slots=True)
class Reason:
    """What dominates an error."""

    cause: Cause
    sentence: str
    """With the numbers it rests on."""


def explain(row: Mapping[str, Any], evidence: Evidence) -> Reason:
    """Say why an error is as large as it is.

    Args:
        row: Of ``scores.csv``.
        evidence: What else is known of the answer.
    """
    cause = _cause(row, evidence)
    flags = f"; the quality gate flagged {', '.join(evidence.flags)}" if evidence.flags else ""
    return Reason(cause, f"{_sentence(cause, row, evidence)}{flags}.")


def _cause(row: Mapping[str, Any], evidence: Evidence) -> Cause:
    if row["status"] != "ok":
        return "no pose"
    error_m, bound_m = float(row["position_error_m"]), float(row["bound_m"])
    if error_m < N_SIGMA_TRUTH * float(row["sigma_truth_m"]):
        return "truth"
    has_matches = np.isfinite(evidence.wrong_share)
    if evidence.wrong_share >= _MOST_WRONG:
        return "wrong matches"
    if evidence.refit_error_m <= ESTIMATOR_PART * error_m:
        return "wrong matches" if evidence.wrong_share >= WRONG_SHARE else "estimator"
    if error_m <= N_BOUNDS * bound_m:
        return "view"
    # Without least squares on the matches nothing tells the estimator from the landmarks.
    return "landmarks" if has_matches and np.isfinite(bound_m) else "unknown"


def _sentence(cause: Cause, row: Mapping[str, Any], evidence: Evidence) -> str:
    usable = f"{100 * float(row['usable_fraction']):.0f} % of the image is usable"
    if cause == "no pose":
        why = evidence.no_pose or str(row["status"])
        return f"No pose: {why}; {row['n_features']} features, {usable}"
    error_m, range_m = float(row["position_error_m"]), float(row["range_los_m"])
    off = f"the error of {_mm(error_m)}"
    matches = f"{row['n_inliers']} matches{_within(evidence)}"
    if cause == "truth":
        n_sigmas = error_m / float(row["sigma_truth_m"])
        return f"Truth: {off} is {n_sigmas:.1f} sigmas of the truth itself, and may be its own"
    if cause in ("wrong matches", "estimator"):
        refit = (
            f"would be off by {_pct(evidence.refit_error_m, range_m)} of LOS"
            if np.isfinite(evidence.refit_error_m)
            else "would find no pose"
        )
        instead = f"least squares on the same {matches} {refit} instead of {_pct(error_m, range_m)}"
        wrong = f"{100 * evidence.wrong_share:.0f} % of them are more than {WRONG_PX:g} px off"
        return f"{cause.capitalize()}: {instead}; {wrong}"
    if cause == "unknown":
        return f"Unknown: neither bound nor landmarks are known of {matches}; {usable}"
    n_bounds = error_m / float(row["bound_m"])
    best = f"fix the position to {_pct(float(row['bound_m']), range_m)} of LOS at best"
    if cause == "view":
        return f"View: {matches} {best}, {off} is {n_bounds:.1f} times that; {usable}"
    right = f"{100 * (1 - evidence.wrong_share):.0f} % of {matches} are right, and would {best}"
    together = f"{off} is {n_bounds:.1f} times that: all are displaced together"
    return f"Landmarks: {right}; {together}{_smooth(evidence)}"


def _within(evidence: Evidence) -> str:
    if not np.isfinite(evidence.width_deg):
        return ""
    return f" within {evidence.width_deg:.0f} x {evidence.height_deg:.0f} deg"


def _smooth(evidence: Evidence) -> str:
    if not evidence.smooth_ratio > 1.0:
        return ""
    times = f"{np.sqrt(evidence.smooth_ratio):.1f} times"
    return (
        f" (by what is left in smooth fields, {times} as uncertain as independent noise of"
        f" {evidence.noise_px:.2f} px makes it)"
    )


def _mm(length_m: float) -> str:
    return f"{1e3 * length_m:.2g} mm" if length_m < 0.0995 else f"{length_m:.2g} m"


def _pct(length_m: float, range_m: float) -> str:
    return f"{100 * length_m / range_m:.2g} %"
