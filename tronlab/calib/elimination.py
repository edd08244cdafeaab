"""Least squares where many blocks of measurements share some unknowns and each has some of its own.

A block's own unknowns are eliminated by an orthogonal factorisation of its rows: the Schur
complement without squaring the condition number (Golub and Van Loan, Matrix Computations, ch. 5;
Triggs et al., Bundle Adjustment, 2000, sec. 6). The effort grows linearly with the blocks.
"""

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from tronlab.errors import CalibrationError
from tronlab.geometry.poses import FloatArray

N_OWN = 6
"""A block's own unknowns: a pose."""

_FIRST_DAMPING = 1e-16
"""Directions that are determined only weakly already feel it, the others need more."""
_LAST_DAMPING = 1e8
_LEAST_SHRINKAGE = 1 / 3
"""Of the damping after a step that did what it promised."""
_MAX_STEPS = 100
_CONVERGED = 1e-12
"""Relative change of the sum of squares a step must promise to be worth taking."""
_NEGLIGIBLE = 1e-3
"""Change of the sum of squares that says nothing: no unknown is then more than 0.03 of its sigma
away."""
_SMALLEST_PIVOT = 1e-10
"""Relative to its column; below, the unknown is a combination of the others."""

S = TypeVar("S")


@dataclass(frozen=True, slots=True)
class Rows:
    """A problem made linear at some state; all rows in units of their own standard deviation."""

    blocks: FloatArray
    """[by own unknowns | by common unknowns | residual], shape (n, m, 6 + n_common + 1)."""
    shared: FloatArray
    """[by common unknowns | residual] of what belongs to no block, shape (k, n_common + 1)."""

    @property
    def cost(self) -> float:
        """Get the sum of squares of the residuals."""
        return float((self.blocks[:, :, -1] ** 2).sum() + (self.shared[:, -1] ** 2).sum())


class Problem(Protocol[S]):
    """A nonlinear least-squares problem over blocks."""

    def rows(self, state: S) -> Rows:
        """Give the problem made linear at a state."""
        ...

    def moved(self, state: S, own: FloatArray, common: FloatArray) -> S:
        """Give the state that steps of shape (n, 6) and (n_common,) lead to."""
        ...


@dataclass(frozen=True, slots=True)
class Elimination:
    """Triangular rows: those that give each block's own unknowns, and what is left for the rest."""

    own: FloatArray
    """Shape (n, 6, 6 + n_common + 1)."""
    reduced: FloatArray
    """What each block says of the common unknowns, shape (n, k, n_common + 1)."""
    shared: FloatArray
    """As in ``Rows``."""

    @property
    def n_common(self) -> int:
        """Get the number of common unknowns."""
        return self.shared.shape[1] - 1

    def common(self, without: NDArray[np.bool_] | None = None) -> "CommonRows":
        """Give what all blocks together say of the common unknowns.

        Args:
            without: Which blocks to leave out, shape (n,).

        Raises:
            CalibrationError: They do not determine the common unknowns.
        """
        reduced = self.reduced if without is None else self.reduced[~without]
        stacked = np.vstack([reduced.reshape(-1, self.n_common + 1), self.shared])
        rows = _triangular(stacked)[: self.n_common]
        pivots, columns = np.abs(np.diag(rows)), np.linalg.norm(rows[:, :-1], axis=0)
        if len(rows) < self.n_common or (pivots <= _SMALLEST_PIVOT * columns).any():
            raise CalibrationError("the measurements do not determine the solution")
        return CommonRows(rows[:, :-1], rows[:, -1])

    def own_steps(self, common: FloatArray) -> FloatArray:
        """Give each block's own step, shape (n, 6), for a step of the common unknowns."""
        known = self.own[:, :, N_OWN:-1] @ common + self.own[:, :, -1]
        steps = -np.linalg.solve(self.own[:, :, :N_OWN], known[:, :, None])[:, :, 0]
        return np.asarray(steps, dtype=np.float64)

    def covariance(self, common_covariance: FloatArray) -> FloatArray:
        """Give each block's covariance of (own, common) unknowns, shape (n, 6 + n_common, same)."""
        inverse = np.linalg.inv(self.own[:, :, :N_OWN])
        by_common = -inverse @ self.own[:, :, N_OWN:-1]
        cross = by_common @ common_covariance
        own = inverse @ np.swapaxes(inverse, 1, 2) + cross @ np.swapaxes(by_common, 1, 2)
        common = np.broadcast_to(common_covariance, (len(own), *common_covariance.shape))
        above = np.concatenate([own, cross], axis=2)
        below = np.concatenate([np.swapaxes(cross, 1, 2), common], axis=2)
        return np.asarray(np.concatenate([above, below], axis=1), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class CommonRows:
    """Triangular rows of the common unknowns."""

    root: FloatArray
    """Upper triangular, shape (n_common, n_common)."""
    residual: FloatArray
    """Shape (n_common,)."""

    @property
    def step(self) -> FloatArray:
        """Get the step to the least sum of squares, shape (n_common,)."""
        return -np.asarray(solve_triangular(self.root, self.residual), dtype=np.float64)

    @property
    def covariance(self) -> FloatArray:
        """Get the covariance of the common unknowns, shape (n_common, n_common)."""
        inverse = np.asarray(solve_triangular(self.root, np.eye(len(self.root))), dtype=np.float64)
        return np.asarray(inverse @ inverse.T, dtype=np.float64)


def eliminate(rows: Rows) -> Elimination:
    """Eliminate each block's own unknowns."""
    triangular = _triangular(rows.blocks)
    return Elimination(triangular[:, :N_OWN], triangular[:, N_OWN:, N_OWN:], rows.shared)


@dataclass(frozen=True, slots=True)
class _Step:
    """Where a linear problem has its least sum of squares."""

    own: FloatArray
    common: FloatArray
    promise: float
    """By how much the sum of squares falls, if the problem is linear."""

    @classmethod
    def of(cls, rows: Rows) -> "_Step":
        """Solve the linear problem."""
        eliminated = eliminate(rows)
        common = eliminated.common()
        explained = (eliminated.own[:, :, -1] ** 2).sum() + common.residual @ common.residual
        return cls(eliminated.own_steps(common.step), common.step, float(explained))


def minimise(problem: Problem[S], state: S) -> S:
    """Find the state of the least sum of squares by Levenberg's and Marquardt's method.

    Steps are undamped as long as the sum of squares falls: problems here are close to linear. Else
    the damping follows from what a step did of what it promised (Nielsen, Damping parameter in
    Marquardt's method, IMM, DTU, 1999): a direction that is determined only weakly needs just so
    much damping, and would bounce between too much and none.

    Raises:
        CalibrationError: No convergence, or the measurements do not determine the solution.
    """
    rows, damping, growth = problem.rows(state), 0.0, 2.0
    for _ in range(_MAX_STEPS):
        full = _Step.of(rows)
        if full.promise < _CONVERGED * (1.0 + rows.cost):
            return problem.moved(state, full.own, full.common)
        step = full if damping == 0.0 else _Step.of(_damped(rows, damping))
        moved = problem.moved(state, step.own, step.common)
        moved_rows = problem.rows(moved)
        if moved_rows.cost < rows.cost:  # false for NaN
            gain = min(1.0, (rows.cost - moved_rows.cost) / step.promise)
            damping *= max(_LEAST_SHRINKAGE, 1.0 - (2.0 * gain - 1.0) ** 3)
            damping, growth = damping if damping > _FIRST_DAMPING else 0.0, 2.0
            state, rows = moved, moved_rows
        elif full.promise < _NEGLIGIBLE:
            return state
        elif damping < _LAST_DAMPING:
            damping, growth = max(growth * damping, _FIRST_DAMPING), 2.0 * growth
        else:
            break
    raise CalibrationError("the least-squares solution does not converge")


def _damped(rows: Rows, damping: float) -> Rows:
    """Add rows that hold every unknown where it is, in proportion to its column."""
    if damping == 0.0:
        return rows
    n, _, n_columns = rows.blocks.shape
    square_sums = (rows.blocks[:, :, :-1] ** 2).sum(axis=1)
    own = np.zeros((n, N_OWN, n_columns))
    own[:, range(N_OWN), range(N_OWN)] = np.sqrt(damping * square_sums[:, :N_OWN])
    common = square_sums[:, N_OWN:].sum(axis=0) + (rows.shared[:, :-1] ** 2).sum(axis=0)
    shared = np.pad(np.diag(np.sqrt(damping * common)), ((0, 0), (0, 1)))
    return Rows(np.concatenate([rows.blocks, own], axis=1), np.vstack([rows.shared, shared]))


def _triangular(rows: FloatArray) -> FloatArray:
    """Give R of the factorisation Q R, for one matrix or many."""
    return np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)
