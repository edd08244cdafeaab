"""Hand-eye transform by least squares over pairs of poses, their noise estimated with it.

Unknown are X = tmac_from_cam and Y = trk_from_board; a pair's residual leads from Y to
trk_from_tmac * X * cam_from_board. What noise the poses have is not known beforehand: three
variances are estimated from the residuals, and a pair that fits none of it is left out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from tronlab.calib.hand_eye.closed_forms import HandEyeStart
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.poses import FloatArray, skew
from tronlab.geometry.uncertainty import perturb

NOISE = ("tmac_rotation_rad", "board_rotation_rad", "translation_m")
"""One sigma each: rotation of the T-MAC, which also moves the board by its lever; rotation of the
board in the camera; translation of both together, which cannot be told apart."""
MIN_PAIRS_FOR_OUTLIERS = 6
"""Fewer leave nothing to tell a wrong pair by."""
_OUTLIER_PROBABILITY = 1e-3
"""How often a good pair is taken for an outlier."""
_TAIL_WEIGHT = 4.0
"""Degrees of freedom of the t-distribution the robust start assumes: few mean heavy tails."""
_CORRELATION_SIGMAS = 3.0
"""A smaller correlation of neighbours is taken for chance."""
_MAX_STEPS = 100
_MAX_SELECTIONS = 20
_CONVERGED_STEP = 1e-6
"""Square of a step in units of its sigma."""
_CONVERGED_NOISE = 1e-3
"""Change of a variance, relative to that of all rotations or translations."""
_SMALLEST_SIGMA = 1e-9
"""Radians or metres: below this, residuals are rounding."""
_LARGEST_SCATTER = 0.1
"""Of the board's place by the single pairs, relative to its distance: beyond any noise."""
_SMALLEST_SHARE = 1e-6
"""Of a variance in the whole: keeps the weights finite where one vanishes."""


@dataclass(frozen=True, slots=True)
class PosePairs:
    """Poses of T-MAC and board taken at the same times."""

    trk_from_tmac: RigidTransform
    """n poses."""
    cam_from_board: RigidTransform
    """n poses."""

    def __len__(self) -> int:
        return len(self.trk_from_tmac)

    def __getitem__(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> "PosePairs":
        return PosePairs(self.trk_from_tmac[chosen], self.cam_from_board[chosen])

    def boards(self, tmac_from_cam: RigidTransform) -> RigidTransform:
        """Give trk_from_board by each pair."""
        return self.trk_from_tmac * tmac_from_cam * self.cam_from_board


@dataclass(frozen=True, slots=True)
class PoseFit:
    """What the pairs determine."""

    start: HandEyeStart
    """The transforms."""
    covariance: FloatArray
    """Of (rotation vector, translation) of tmac_from_cam in tmac, then of trk_from_board in trk,
    shape (12, 12), rad and m."""
    variances: FloatArray
    """Of ``NOISE``, shape (3,)."""
    is_used: NDArray[np.bool_]
    """False for outliers, shape (n,)."""


def fit_pose_pairs(
    pairs: PosePairs, start: HandEyeStart, *, variances: FloatArray | None = None
) -> PoseFit:
    """Solve for both transforms and the noise, outliers left out.

    A t-distribution's weights lead to a start that a few gross errors do not move; from there pairs
    beyond the 99.9 % limit of chi-square are left out until the choice stays the same.

    Args:
        pairs: In the order of time.
        start: Where the transforms start.
        variances: Where those of ``NOISE`` start, shape (3,); from the residuals if None.

    Raises:
        CalibrationError: Fewer than half of the pairs agree, or what they agree on is no place.
        DegenerateGeometryError: The pairs do not determine the transforms.

    Source: variances by iterated almost unbiased estimation: Foerstner, Zeitschrift fuer
        Vermessungswesen 104 (1979) 446; weights: Lange, Little and Taylor, J. American Statistical
        Association 84 (1989) 881.
    """
    if len(pairs) < MIN_PAIRS_FOR_OUTLIERS:
        fit = _fit(pairs, start, np.ones(len(pairs), dtype=np.bool_), variances=variances)
    else:
        fit = _fit_without_outliers(pairs, start, variances)
    _check_scatter(pairs, fit)
    return fit


def _fit_without_outliers(
    pairs: PosePairs, start: HandEyeStart, variances: FloatArray | None
) -> PoseFit:
    n = len(pairs)
    everything = np.ones(n, dtype=np.bool_)
    limit = chi2.isf(_OUTLIER_PROBABILITY, 6)
    fit = _fit(pairs, start, everything, variances=variances, tail_weight=_TAIL_WEIGHT)
    for _ in range(_MAX_SELECTIONS):
        is_used = _square_distances(pairs, fit) < limit
        if 2 * is_used.sum() < n or is_used.sum() < MIN_PAIRS_FOR_OUTLIERS // 2:
            raise CalibrationError(
                f"hand-eye: only {is_used.sum()} of {n} pairs of poses agree with each other; are"
                " the poses of the same moments, and is the board fixed?"
            )
        selected = _fit(pairs, fit.start, is_used, variances=fit.variances)
        if (is_used == fit.is_used).all() and fit.is_used is not everything:
            return selected
        fit = selected
    return fit


def _check_scatter(pairs: PosePairs, fit: PoseFit) -> None:
    """Refuse translations that have nothing to do with each other, though the turns fit."""
    scatter_m = float(np.sqrt(fit.variances[2]))
    distance_m = float(np.median(np.linalg.norm(pairs.cam_from_board.translation, axis=1)))
    if scatter_m > _LARGEST_SCATTER * distance_m:
        raise CalibrationError(
            f"hand-eye: the place of the board scatters by {scatter_m:.3g} m from pair to pair,"
            f" {distance_m:.3g} m from the camera: the turns of T-MAC and camera fit each other,"
            " the translations do not; are all of them in metres, and the quaternion's scalar last"
            " (qx qy qz qw)?"
        )


def refit(pairs: PosePairs, fit: PoseFit, is_used: NDArray[np.bool_]) -> HandEyeStart:
    """Solve again with the same noise and other pairs."""
    return _fit(pairs, fit.start, is_used, variances=fit.variances, is_noise_known=True).start


def residuals(pairs: PosePairs, start: HandEyeStart) -> FloatArray:
    """Give (rotation vector, translation) from trk_from_board to each pair's, shape (n, 6)."""
    boards = pairs.boards(start.tmac_from_cam)
    turns = (boards.rotation * start.trk_from_board.rotation.inv()).as_rotvec()
    return np.hstack([turns, boards.translation - start.trk_from_board.translation])


def jacobian(pairs: PosePairs, start: HandEyeStart) -> FloatArray:
    """Give d(residuals) by small (rotation, translation) of X in tmac and Y in trk, (n, 6, 12)."""
    tmac = pairs.trk_from_tmac.rotation.as_matrix()
    levers = start.tmac_from_cam.rotation.apply(pairs.cam_from_board.translation)
    derivatives = np.zeros((len(pairs), 6, 12))
    derivatives[:, :3, :3] = derivatives[:, 3:, 3:6] = tmac
    derivatives[:, 3:, :3] = -tmac @ skew(levers)
    derivatives[:, :, 6:] = -np.eye(6)
    return derivatives


def one_more_unknown(pairs: PosePairs, fit: PoseFit, by_unknown: FloatArray) -> tuple[float, float]:
    """Solve for one more unknown together with the transforms, by one step.

    Args:
        pairs: The pairs.
        fit: Their solution without it.
        by_unknown: Derivatives of the residuals by it, shape (n, 6).

    Returns:
        The unknown, from where it is in ``pairs``, and its sigma; infinite if it is not determined.
    """
    derivatives = np.concatenate([jacobian(pairs, fit.start), by_unknown[:, :, None]], axis=2)
    weighted = weights(pairs, fit) * fit.is_used[:, None, None] @ derivatives
    try:
        covariance = _invert(np.einsum("nki,nkj->ij", derivatives, weighted))
    except DegenerateGeometryError:
        return 0.0, np.inf
    gradient = np.einsum("nki,nk->i", weighted, residuals(pairs, fit.start))
    return -float(covariance[-1] @ gradient), float(np.sqrt(covariance[-1, -1]))


def mean_correlation(pairs: PosePairs, fit: PoseFit) -> float:
    """Give how many neighbouring pairs count as one, since they share their errors.

    Residuals in units of their covariance are compared with those of later pairs, until their
    product is lost in noise; 1 if neighbours show no correlation. The order of the pairs must be
    that of time.

    Source: integrated autocorrelation time; Sokal, Monte Carlo methods in statistical mechanics,
        1996, section 3.
    """
    used = pairs[fit.is_used]
    roots = np.linalg.cholesky(weights(used, fit))
    e = np.einsum("nji,nj->ni", roots, residuals(used, fit.start))
    limit = _CORRELATION_SIGMAS / np.sqrt(e.size)
    total = 1.0
    for lag in range(1, len(e) // 2):
        correlation = float((e[lag:] * e[:-lag]).sum() / (e**2).sum())
        if correlation < limit:
            break
        total += 2.0 * correlation
    return total


def weights(pairs: PosePairs, fit: PoseFit) -> FloatArray:
    """Give the inverse covariance of each pair's residual, shape (n, 6, 6)."""
    return _inverses(_noise_shapes(pairs, fit.start), fit.variances)


@dataclass(frozen=True, slots=True)
class _Linear:
    """The problem about one point."""

    e: FloatArray
    """Residuals there, shape (n, 6)."""
    by_unknowns: FloatArray
    """Shape (n, 6, 12)."""
    shapes: FloatArray
    """Covariances of the residuals for unit variances of ``NOISE``, shape (3, n, 6, 6)."""


def _fit(
    pairs: PosePairs,
    start: HandEyeStart,
    is_used: NDArray[np.bool_],
    *,
    variances: FloatArray | None = None,
    tail_weight: float = np.inf,
    is_noise_known: bool = False,
) -> PoseFit:
    chosen = pairs[is_used]
    for _ in range(_MAX_STEPS):
        problem = _Linear(
            residuals(chosen, start), jacobian(chosen, start), _noise_shapes(chosen, start)
        )
        if variances is None:
            variances = _first_variances(problem.e)
        if not is_noise_known:
            variances = _estimate_noise(problem, variances, tail_weight)
        step, covariance, _ = _step(problem, variances, tail_weight, np.zeros(12))
        start = HandEyeStart(
            perturb(start.tmac_from_cam, step[:6]), perturb(start.trk_from_board, step[6:])
        )
        if step @ np.linalg.solve(covariance, step) < _CONVERGED_STEP:
            return PoseFit(start, covariance, variances, is_used)
    raise CalibrationError(
        "hand-eye: the least-squares solution over pairs of poses does not converge; the poses"
        " contradict each other"
    )


def _estimate_noise(problem: _Linear, variances: FloatArray, tail_weight: float) -> FloatArray:
    """Find the variances of ``NOISE`` that the residuals of their own solution show."""
    least = _SMALLEST_SHARE * variances + _SMALLEST_SIGMA**2
    step = np.zeros(12)
    for _ in range(_MAX_STEPS):
        step, _, ratios = _step(problem, variances, tail_weight, step)
        previous, variances = variances, np.maximum(variances * ratios, least)
        if (np.abs(variances - previous) < _CONVERGED_NOISE * _whole(previous)).all():
            break
    return variances


def _step(
    problem: _Linear, variances: FloatArray, tail_weight: float, previous: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve the linear problem once.

    Args:
        problem: About the point where the step starts.
        variances: Of ``NOISE``.
        tail_weight: Degrees of freedom of the t-distribution; infinite for a normal one.
        previous: The last step, shape (12,): it tells which residuals are large.

    Returns:
        The step, its covariance, and by what each variance must grow: what the residuals are in
        relation to what they should be, shape (3,).
    """
    inverses = _inverses(problem.shapes, variances)
    leverages = inverses @ problem.by_unknowns
    factors = _tail_factors(problem.e + problem.by_unknowns @ previous, inverses, tail_weight)
    weighted = factors[:, None, None] * leverages
    covariance = _invert(np.einsum("nki,nkj->ij", problem.by_unknowns, weighted))
    step = -covariance @ np.einsum("nki,nk->i", weighted, problem.e)
    pulls = np.einsum("nij,nj->ni", inverses, problem.e + problem.by_unknowns @ step)
    unexplained = inverses - weighted @ covariance @ np.swapaxes(leverages, 1, 2)
    by_shape = np.einsum("knij,nj->kni", problem.shapes, pulls)
    found = np.einsum("ni,kni->k", factors[:, None] * pulls, by_shape)
    expected = np.einsum("nij,knij->k", unexplained, problem.shapes)
    return step, covariance, found / np.maximum(expected, np.finfo(np.float64).tiny)


def _noise_shapes(pairs: PosePairs, start: HandEyeStart) -> FloatArray:
    """Give the covariance of each residual for unit variance of each of ``NOISE``, (3, n, 6, 6)."""
    shapes = np.zeros((len(NOISE), len(pairs), 6, 6))
    boards = pairs.boards(start.tmac_from_cam)
    levers = boards.translation - pairs.trk_from_tmac.translation
    by_turn = np.concatenate(
        [np.broadcast_to(np.eye(3), (len(pairs), 3, 3)), -skew(levers)], axis=1
    )
    shapes[0] = by_turn @ np.swapaxes(by_turn, 1, 2)
    shapes[1, :, :3, :3] = shapes[2, :, 3:, 3:] = np.eye(3)
    return shapes


def _covariances(shapes: FloatArray, variances: FloatArray) -> FloatArray:
    return np.einsum("k,knij->nij", variances, shapes)


def _inverses(shapes: FloatArray, variances: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(_covariances(shapes, variances)), dtype=np.float64)


def _first_variances(e: FloatArray) -> FloatArray:
    """Guess the variances from the medians of the residuals; half of the turns each."""
    turn, shift = np.median(e[:, :3] ** 2), np.median(e[:, 3:] ** 2)
    return np.array([turn / 2, turn / 2, shift]) + _SMALLEST_SIGMA**2


def _tail_factors(e: FloatArray, inverses: FloatArray, tail_weight: float) -> FloatArray:
    """Give the weight of each pair, shape (n,): 1 for a normal distribution."""
    if np.isinf(tail_weight):
        return np.ones(len(e))
    return (tail_weight + 6) / (tail_weight + np.einsum("ni,nij,nj->n", e, inverses, e))


def _whole(variances: FloatArray) -> FloatArray:
    """Give what each variance is a part of: all rotation, or all translation, shape (3,)."""
    turn = variances[0] + variances[1]
    return np.array([turn, turn, variances[2]])


def _square_distances(pairs: PosePairs, fit: PoseFit) -> FloatArray:
    """Give each residual's square in units of its covariance, that of the solution included."""
    e, by_unknowns = residuals(pairs, fit.start), jacobian(pairs, fit.start)
    covariances = _covariances(_noise_shapes(pairs, fit.start), fit.variances)
    solution = by_unknowns @ fit.covariance @ np.swapaxes(by_unknowns, 1, 2)
    # A pair the solution rests on lies closer to it than its noise, another one farther away.
    signs = np.where(fit.is_used, -1.0, 1.0)[:, None, None]
    total = covariances + signs * solution
    return np.einsum("ni,nij,nj->n", e, np.linalg.inv(total), e)


def _invert(normal: FloatArray) -> FloatArray:
    """Invert the normal equations, scaled to a unit diagonal before."""
    scale = np.sqrt(np.diag(normal))
    try:
        inverse = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    except np.linalg.LinAlgError:
        raise DegenerateGeometryError(
            "hand-eye: the pairs of poses do not determine the transform; add some with other turns"
        ) from None
    return (inverse + inverse.T) / 2
