"""The descent of given flight time as a second-order cone programme, solved by Clarabel.

Variables at each of n + 1 times, equally spaced: position r, velocity v, acceleration by thrust u,
its bound s and the logarithm z of the mass. u and s are linear between two times, and the dynamics
are integrated exactly under that assumption.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from scipy import sparse

from tronlab.errors import ConfigError
from tronlab.geometry.poses import FloatArray
from tronlab.trajectory.config import DescentStart, Lander

MISS_WEIGHT = 100.0
"""Cost of a miss by 1 m/s, in m/s: more than what landing a little better can cost in velocity
increment, except where landing is hardly possible, so that the penalty is exact."""
_PER_NODE = 11
_R, _V, _U, _S, _Z = slice(0, 3), slice(3, 6), slice(6, 9), 9, 10


@dataclass(frozen=True, slots=True)
class Flight:
    """A descent at full scale, local vertical frame, at n + 1 times."""

    time_s: FloatArray
    position_m: FloatArray
    """Shape (n + 1, 3)."""
    velocity_m_per_s: FloatArray
    """Shape (n + 1, 3)."""
    acceleration_m_per_s2: FloatArray
    """By the thrust alone, linear between two times; shape (n + 1, 3)."""
    slack_m_per_s2: FloatArray
    """Bound of its magnitude, which it equals where the relaxation is tight; shape (n + 1,)."""
    mass_kg: FloatArray
    """Shape (n + 1,)."""
    velocity_increment_m_per_s: float
    """What the fuel is for: integral of the slack."""
    miss_m_per_s: float
    """Length of final position over flight time and final velocity: 0 if it lands."""
    is_accurate: bool
    """Whether the solver reached its accuracy; otherwise only the cost is of use."""

    @property
    def n_steps(self) -> int:
        """Get the number of steps between its times."""
        return len(self.time_s) - 1

    @property
    def thrust_n(self) -> FloatArray:
        """Get the thrust, shape (n + 1, 3)."""
        return self.mass_kg[:, None] * self.acceleration_m_per_s2

    @property
    def cost_m_per_s(self) -> float:
        """Get what was minimised."""
        return self.velocity_increment_m_per_s + MISS_WEIGHT * self.miss_m_per_s


def solve_fixed_time(
    start: DescentStart,
    lander: Lander,
    flight_time_s: float,
    *,
    reference_kg: FloatArray,
) -> Flight | None:
    """Find the descent of least fuel in a given time, which lands or comes nearest to it.

    The bounds of s = thrust over mass, convex in z, are made linear about a reference mass
    (Acikmese and Ploen, equation 38, to first order): exact where the reference is the solution.

    Args:
        start: Where it begins.
        lander: What it may do.
        flight_time_s: Time to the landing.
        reference_kg: Mass expected at each of the n + 1 times, shape (n + 1,).

    Returns:
        The descent; None where no descent keeps to the lander's limits so long.

    Raises:
        ConfigError: Clarabel is not installed.
    """
    units = _Units(length_m=float(np.linalg.norm(start.position_m)), time_s=flight_time_s)
    programme = _programme(units.start(start), units.lander(lander), reference_kg)
    solution = _solve(programme)
    if solution is None:
        return None
    x, is_accurate = solution
    nodes = x[:-1].reshape(-1, _PER_NODE)
    return Flight(
        time_s=np.linspace(0.0, flight_time_s, len(nodes)),
        position_m=units.length_m * nodes[:, _R],
        velocity_m_per_s=units.speed_m_per_s * nodes[:, _V],
        acceleration_m_per_s2=units.acceleration_m_per_s2 * nodes[:, _U],
        slack_m_per_s2=units.acceleration_m_per_s2 * nodes[:, _S],
        mass_kg=lander.mass_kg * np.exp(nodes[:, _Z]),
        velocity_increment_m_per_s=units.speed_m_per_s * float(programme.cost[:-1] @ x[:-1]),
        miss_m_per_s=units.speed_m_per_s * float(x[-1]),
        is_accurate=is_accurate,
    )


@dataclass(frozen=True, slots=True)
class _Units:
    """Units in which all variables are near 1: the solver needs a third fewer iterations."""

    length_m: float
    time_s: float

    @property
    def speed_m_per_s(self) -> float:
        return self.length_m / self.time_s

    @property
    def acceleration_m_per_s2(self) -> float:
        return self.length_m / self.time_s**2

    def start(self, start: DescentStart) -> DescentStart:
        """Express a start in these units."""
        return DescentStart.model_construct(
            position_m=tuple(x / self.length_m for x in start.position_m),
            velocity_m_per_s=tuple(v / self.speed_m_per_s for v in start.velocity_m_per_s),
        )

    def lander(self, lander: Lander) -> Lander:
        """Express a lander in these units and kg."""
        return lander.model_copy(
            update={
                "exhaust_velocity_m_per_s": lander.exhaust_velocity_m_per_s / self.speed_m_per_s,
                "thrust_n": tuple(force / self.acceleration_m_per_s2 for force in lander.thrust_n),
                "gravity_m_per_s2": lander.gravity_m_per_s2 / self.acceleration_m_per_s2,
            }
        )


@dataclass(frozen=True, slots=True)
class _Programme:
    """Least ``cost @ x`` with ``bound - matrix @ x`` in the cones, one after the other."""

    cost: FloatArray
    matrix: sparse.csc_matrix
    bound: FloatArray
    n_equal: int
    n_at_most: int
    cone_sizes: Sequence[int]


class _Rows:
    """Rows of a sparse matrix and of its right side, put together piece by piece."""

    def __init__(self) -> None:
        self._rows: list[Any] = []
        self._columns: list[Any] = []
        self._values: list[Any] = []
        self._bounds: list[FloatArray] = []
        self.n = 0

    def add(self, bound: Any, terms: Iterable[tuple[Any, Any]]) -> None:
        """Append rows: their right sides, and terms of columns and factors, one a row each."""
        bounds = np.atleast_1d(np.asarray(bound, dtype=np.float64)).ravel()
        rows = np.arange(self.n, self.n + len(bounds))
        for columns, factors in terms:
            self._rows.append(rows)
            self._columns.append(np.ravel(columns))
            self._values.append(np.broadcast_to(np.ravel(factors), rows.shape))
        self._bounds.append(bounds)
        self.n += len(bounds)

    def matrix(self, n_columns: int) -> sparse.csc_matrix:
        """Give the matrix."""
        entries = np.concatenate(self._values)
        places = np.concatenate(self._rows), np.concatenate(self._columns)
        return sparse.csc_matrix((entries, places), shape=(self.n, n_columns))

    def bounds(self) -> FloatArray:
        """Give the right sides."""
        return np.concatenate(self._bounds)


def _programme(start: DescentStart, lander: Lander, reference_kg: FloatArray) -> _Programme:
    """Put the programme together, in units in which the flight takes the time 1."""
    n = len(reference_kg) - 1
    column = np.arange((n + 1) * _PER_NODE).reshape(n + 1, _PER_NODE)
    step = 1.0 / n
    rows = _Rows()
    _add_start(rows, column, start)
    _add_dynamics(rows, column, lander, step)
    n_equal = rows.n
    _add_thrust_limits(rows, column, lander, reference_kg)
    n_at_most = rows.n - n_equal
    cone_sizes = _add_cones(rows, column, lander)
    cost = np.zeros(column.size + 1)
    cost[column[:, _S]] = step
    cost[column[[0, -1], _S]] = 0.5 * step
    cost[-1] = MISS_WEIGHT
    return _Programme(cost, rows.matrix(cost.size), rows.bounds(), n_equal, n_at_most, cone_sizes)


def _add_start(rows: _Rows, column: Any, start: DescentStart) -> None:
    rows.add(start.position_m, [(column[0, _R], 1.0)])
    rows.add(start.velocity_m_per_s, [(column[0, _V], 1.0)])
    rows.add(0.0, [(column[0, _Z], 1.0)])


def _add_dynamics(rows: _Rows, column: Any, lander: Lander, step: float) -> None:
    """Join each node to the next: thrust's acceleration is linear in between, gravity constant."""
    here, there = column[:-1], column[1:]
    n = len(here)
    gravity = np.tile([0.0, 0.0, -lander.gravity_m_per_s2], n)
    rows.add(
        step * gravity,
        [
            (there[:, _V], 1.0),
            (here[:, _V], -1.0),
            (here[:, _U], -step / 2),
            (there[:, _U], -step / 2),
        ],
    )
    rows.add(
        step**2 / 2 * gravity,
        [
            (there[:, _R], 1.0),
            (here[:, _R], -1.0),
            (here[:, _V], -step),
            (here[:, _U], -(step**2) / 3),
            (there[:, _U], -(step**2) / 6),
        ],
    )
    half = step / (2 * lander.exhaust_velocity_m_per_s)
    rows.add(
        np.zeros(n),
        [
            (there[:, _Z], 1.0),
            (here[:, _Z], -1.0),
            (here[:, _S], half),
            (there[:, _S], half),
        ],
    )


def _add_thrust_limits(rows: _Rows, column: Any, lander: Lander, reference_kg: FloatArray) -> None:
    """Limit thrust on both sides, its tilt, and the fuel."""
    least, greatest = (thrust_n / reference_kg for thrust_n in lander.thrust_n)
    z_reference = np.log(reference_kg / lander.mass_kg)
    s, z = column[:, _S], column[:, _Z]
    rows.add(greatest * (1 + z_reference), [(s, 1.0), (z, greatest)])
    rows.add(-least * (1 + z_reference), [(s, -1.0), (z, -least)])
    upward = column[:, _U][:, 2]
    rows.add(np.zeros(len(s)), [(s, np.cos(lander.max_tilt_rad)), (upward, -1.0)])
    rows.add(np.log(lander.mass_kg / lander.dry_mass_kg), [(column[-1, _Z], -1.0)])


def _add_cones(rows: _Rows, column: Any, lander: Lander) -> list[int]:
    """Append |u| <= s, the glide slope between start and landing, and the miss."""
    n_nodes = len(column)
    thrust = column[:, [_S, *range(*_U.indices(_PER_NODE))]]
    rows.add(np.zeros(thrust.size), [(thrust, -1.0)])
    inner = column[1:-1, [2, 0, 1]]
    slope = np.tan(lander.min_glide_slope_rad)
    rows.add(np.zeros(inner.size), [(inner, np.tile([-1.0, -slope, -slope], len(inner)))])
    rows.add(0.0, [(column.size, -1.0)])
    rows.add(np.zeros(6), [(column[-1, : _V.stop], -1.0)])
    return [*(4 for _ in range(n_nodes)), *(3 for _ in range(len(inner))), 7]


def _solve(programme: _Programme) -> tuple[FloatArray, bool] | None:
    """Give the optimum and whether it is accurate; None where no feasible point was found."""
    clarabel = _import_solver()
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    n = programme.cost.size
    cones = [
        clarabel.ZeroConeT(programme.n_equal),
        clarabel.NonnegativeConeT(programme.n_at_most),
        *(clarabel.SecondOrderConeT(size) for size in programme.cone_sizes),
    ]
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix((n, n)),
        programme.cost,
        programme.matrix,
        programme.bound,
        cones,
        settings,
    )
    solution = solver.solve()
    # Right at the limit of feasibility the solver may find neither a point nor a proof.
    statuses = clarabel.SolverStatus
    is_accurate = {statuses.Solved: True, statuses.AlmostSolved: False}.get(solution.status)
    return None if is_accurate is None else (np.array(solution.x), is_accurate)


def _import_solver() -> Any:
    """Import the solver, which has no types, only when a descent is sought."""
    try:
        return import_module("clarabel")
    except ImportError:
        raise ConfigError(
            "kind: powered_descent needs the package clarabel\npip install 'tronlab[trajectory]'",
            key="trajectory",
        ) from None
