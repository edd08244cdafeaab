"""Stations whose reading contradicts the others: found robustly, then left out.

First each reading counts the less the farther it lies from what the others say (Cauchy's weights,
iterated: Holland and Welsch, Commun. Statist. A6 (1977) 813), so that a gross error cannot hide
itself by bending the solution. Then readings beyond a chi-square limit count nothing, and the rest
is plain least squares. The image of such a station still serves the camera.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from tronlab.calib.elimination import N_OWN, eliminate
from tronlab.calib.hand_eye.bundle import (
    BundleProblem,
    BundleSolution,
    BundleState,
    distances_without_own,
    leverages,
    solve_bundle,
)
from tronlab.errors import CalibrationError
from tronlab.geometry.poses import FloatArray

OUTLIER_PROBABILITY = 1e-3
"""How often a good station is taken for an outlier."""
MAX_OUTLIERS = 1 / 3
"""Part of the stations that may be outliers; with more, it is not known who is right."""

_LIMIT = float(chi2.isf(OUTLIER_PROBABILITY, 6))
_MEDIAN = float(chi2.median(6))
_DOUBTFUL = float(chi2.isf(0.05, 6))
"""At this squared distance a reading counts half."""
_ROUNDS = 20
_SETTLED = 0.05
"""Change of trust that decides nothing any more."""


def solve_without_outliers(
    problem: BundleProblem, start: BundleState
) -> tuple[BundleProblem, BundleSolution]:
    """Solve for everything, by the stations that agree.

    Returns:
        The problem with trust 1 in the stations that agree and 0 in the others, and its solution.

    Raises:
        CalibrationError: More than ``MAX_OUTLIERS`` of the stations disagree, or no solution.
    """
    state, distances = _solve_robustly(problem, start)
    is_outlier = _is_outlier(distances)
    for _ in range(problem.n_stations):
        if is_outlier.mean() > MAX_OUTLIERS:
            break
        trusting = problem.trusting(np.where(is_outlier, 0.0, 1.0))
        solution = solve_bundle(trusting, state)
        found = _is_outlier(solution.distances)
        if (found <= is_outlier).all():
            return trusting, solution
        state, is_outlier = solution.state, is_outlier | found
    raise CalibrationError(
        f"the readings of {is_outlier.sum()} of {len(is_outlier)} stations contradict the others"
    )


def _solve_robustly(problem: BundleProblem, state: BundleState) -> tuple[BundleState, FloatArray]:
    """Give the state with readings trusted by their distance, and the distances, (n_stations,)."""
    distances = (problem.reading_rows(state)[:, :, -1] ** 2).sum(axis=1)
    trust = _trust(distances)
    for _ in range(_ROUNDS):
        state, distances = _reweighted(problem.trusting(trust), state)
        before, trust = trust, _trust(distances)
        if np.abs(trust - before).max() < _SETTLED:
            break
    return state, distances


def _reweighted(problem: BundleProblem, state: BundleState) -> tuple[BundleState, FloatArray]:
    """Take one step of Gauss and Newton; give the state and the distances there."""
    eliminated = eliminate(problem.rows(state))
    common = eliminated.common()
    own = eliminated.own_steps(common.step)
    readings = problem.reading_rows(state)
    found = leverages(problem, readings, eliminated, common.covariance)
    residuals = readings[:, :, -1] + readings[:, :, N_OWN:-1] @ common.step
    residuals += np.einsum("nij,nj->ni", readings[:, :, :N_OWN], own[: problem.n_stations])
    distances = distances_without_own(residuals, found, problem.trust)
    return problem.moved(state, own, common.step), distances


def _trust(distances: FloatArray) -> FloatArray:
    return 1.0 / (1.0 + distances / (_DOUBTFUL * _scale(distances)))


def _is_outlier(distances: FloatArray) -> NDArray[np.bool_]:
    return distances > _LIMIT * _scale(distances)


def _scale(distances: FloatArray) -> float:
    """Give how much larger than stated the readings' variance is, at least 1.

    By the median, so that outliers do not enlarge it, and stations are not left out one after the
    other where the tracker's accuracy is stated too well for all of them.
    """
    return max(1.0, float(np.median(distances)) / _MEDIAN)
