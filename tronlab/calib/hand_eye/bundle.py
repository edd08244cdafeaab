"""Camera, hand-eye transform and board in one least-squares solution over pixels and poses."""

from dataclasses import dataclass

import numpy as np

from tronlab.calib.camera.projection import N_INTRINSICS
from tronlab.calib.camera.state import N_COMMON
from tronlab.calib.elimination import Elimination, eliminate, minimise
from tronlab.calib.hand_eye.bundle_problem import (
    BundleProblem,
    BundleState,
    Station,
    make_problem,
)
from tronlab.geometry.poses import FloatArray

__all__ = [
    "BundleProblem",
    "BundleSolution",
    "BundleState",
    "Station",
    "distances_without_own",
    "evaluate",
    "leverages",
    "make_problem",
    "solve_bundle",
]


_LEAST_REDUNDANCY = 1e-9
"""Of a reading along an axis; below, nothing else says anything about it."""


@dataclass(frozen=True, slots=True)
class BundleSolution:
    """What stations and free views determine, with covariance and residuals."""

    state: BundleState
    camera_covariance: FloatArray
    """Of ``INTRINSICS``, shape (12, 12); zero for what is not free."""
    bow_covariance_m2: FloatArray
    """Shape (3, 3); zero if the bow was not free."""
    tmac_from_cam_covariance: FloatArray
    """Of (rotation vector, translation) in tmac, shape (6, 6), rad and m."""
    residuals_px: tuple[FloatArray, ...]
    """Projected minus detected corners of each view, shape (n, 2)."""
    pose_corrections: FloatArray
    """From the tracker's reading to the estimated pose, (rotation vector, translation) in trk,
    shape (n_stations, 6), rad and m."""
    pose_correction_covariances: FloatArray
    """How far each may scatter, shape (n_stations, 6, 6)."""
    distances: FloatArray
    """Squared Mahalanobis distance of each reading from what all others say of it, with the same
    image, shape (n_stations,); of chi-square distribution with 6 degrees of freedom."""
    chi_square_pixels: float
    dof_pixels: float
    chi_square_poses: float
    """Squared pose corrections in units of the tracker's covariance, of trusted readings."""
    dof_poses: float
    """What ``chi_square_poses`` is expected to be."""


def solve_bundle(problem: BundleProblem, start: BundleState) -> BundleSolution:
    """Solve for everything at once.

    Args:
        problem: At least three trusted stations, with turns about two axes (``check_motions``).
        start: Where the solution starts.

    Raises:
        CalibrationError: No convergence, or the measurements do not determine the solution.
    """
    return evaluate(problem, minimise(problem, start))


def evaluate(problem: BundleProblem, state: BundleState) -> BundleSolution:
    """Give covariances and statistics of the state of least squares."""
    rows = problem.rows(state)
    eliminated = eliminate(rows)
    covariance = eliminated.common().covariance
    readings = problem.reading_rows(state)
    residuals = readings[:, :, -1]
    found = leverages(problem, readings, eliminated, covariance)
    explained = float(np.einsum("n,nii->", problem.trust, found))
    lens_and_bow = _spread(covariance, problem)
    n_free, n_unknowns = len(problem.free), problem.n_common + 6 * len(problem.pixel_weights)
    explained_before = float(problem.priors**2 @ np.diag(covariance)[:n_free])
    n_pixels = 2 * int((problem.pixel_weights > 0).sum())
    return BundleSolution(
        state=state,
        camera_covariance=lens_and_bow[:N_INTRINSICS, :N_INTRINSICS],
        bow_covariance_m2=lens_and_bow[N_INTRINSICS:, N_INTRINSICS:],
        tmac_from_cam_covariance=covariance[problem.hand_eye, problem.hand_eye],
        residuals_px=problem.residuals_px(state),
        pose_corrections=problem.corrections(state),
        pose_correction_covariances=_scatter(problem, found),
        distances=distances_without_own(residuals, found, problem.trust),
        chi_square_pixels=float((rows.blocks[:, 6:, -1] ** 2).sum()),
        dof_pixels=n_pixels - (n_unknowns - explained - explained_before),
        chi_square_poses=float((problem.trust[:, None] * residuals**2).sum()),
        dof_poses=6 * float(problem.trust.sum()) - explained,
    )


def distances_without_own(
    residuals: FloatArray, leverages: FloatArray, trust: FloatArray
) -> FloatArray:
    """Give each reading's squared distance from what is found without it, shape (n,).

    With residual r, trust w and leverage h (its covariance as found, in units of the reading's),
    along each principal axis of h: r / (1 - w h) is the residual without the reading, and
    (1 + (1 - w) h) / (1 - w h) its variance (Cook and Weisberg, Residuals and Influence in
    Regression, 1982, ch. 2). An axis along which only the reading itself counts adds nothing.

    Args:
        residuals: In units of the reading's covariance, shape (n, 6).
        leverages: Shape (n, 6, 6).
        trust: Shape (n,).
    """
    values, axes = np.linalg.eigh(leverages)
    along = np.einsum("nij,ni->nj", axes, residuals)
    left = 1.0 - trust[:, None] * values
    variance = left * (1.0 + (1.0 - trust[:, None]) * values)
    is_checked = left > _LEAST_REDUNDANCY
    squares = np.where(is_checked, along**2 / np.where(is_checked, variance, 1.0), 0.0)
    return squares.sum(axis=1)


def leverages(
    problem: BundleProblem, readings: FloatArray, eliminated: Elimination, common: FloatArray
) -> FloatArray:
    """Give the covariance of each estimated reading in units of the reading's, (n, 6, 6)."""
    derivatives = readings[:, :, :-1]
    covariance = eliminated.covariance(common)[: problem.n_stations]
    return derivatives @ covariance @ np.swapaxes(derivatives, 1, 2)


def _scatter(problem: BundleProblem, leverages: FloatArray) -> FloatArray:
    """Give the covariance of each correction; what counts pulls the estimate to itself."""
    roots = np.linalg.inv(problem.pose_weights)
    scatter = np.eye(6) + (1.0 - 2.0 * problem.trust)[:, None, None] * leverages
    return roots @ scatter @ np.swapaxes(roots, 1, 2)


def _spread(covariance: FloatArray, problem: BundleProblem) -> FloatArray:
    """Give the covariance of intrinsics and bow, zero for what is not free, shape (15, 15)."""
    free = problem.free
    spread = np.zeros((N_COMMON, N_COMMON))
    spread[np.ix_(free, free)] = covariance[: len(free), : len(free)]
    return spread
