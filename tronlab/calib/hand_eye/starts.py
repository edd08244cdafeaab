"""Where the hand-eye solution starts: the closed form that most stations agree with."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.calib.hand_eye.bundle import BundleProblem, BundleState
from tronlab.calib.hand_eye.closed_forms import CLOSED_FORMS, HandEyeStart
from tronlab.errors import CalibrationError

_SAMPLE = 4
"""Stations a sample; two of them leave nothing to spare, and each more may be an outlier."""
_N_SAMPLES = 60
"""With three of ten stations wrong, every sample has one of them once in 50 000 times."""


def best_start(problem: BundleProblem, states: Iterable[BundleState]) -> BundleState:
    """Give the state whose median distance from the readings is least."""
    return min(states, key=lambda state: misfit(problem, state))


def misfit(problem: BundleProblem, state: BundleState) -> float:
    """Give the median squared distance of the readings, in units of their own covariance."""
    residuals = problem.reading_rows(state)[:, :, -1]
    return float(np.median((residuals**2).sum(axis=1)))


def sampled_starts(
    trk_from_tmac: Sequence[RigidTransform], cam_from_board: Sequence[RigidTransform]
) -> Iterator[HandEyeStart]:
    """Give closed forms of a few stations each, some of which have no outlier among them.

    Source: random sample consensus, Fischler and Bolles, Commun. ACM 24 (1981) 381; drawn the same
    way every time.
    """
    rng, solve = np.random.default_rng(0), CLOSED_FORMS["park"]
    for _ in range(_N_SAMPLES):
        sample = rng.choice(len(trk_from_tmac), min(_SAMPLE, len(trk_from_tmac)), replace=False)
        try:
            yield solve([trk_from_tmac[i] for i in sample], [cam_from_board[i] for i in sample])
        except (CalibrationError, np.linalg.LinAlgError):
            continue
