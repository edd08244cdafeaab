"""The order of shots that takes least time to move: a travelling salesman's path.

Nearest neighbours give a first path; 2-opt and Or-opt over short lists of neighbours mend it
(Bentley, ORSA Journal on Computing 4, 1992). Both ends of the path are free.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from scipy.spatial import KDTree

from tronlab.devices.protocols import MotionModel
from tronlab.devices.readings import Posture
from tronlab.geometry.poses import FloatArray
from tronlab.planning.reach import check_reach_along
from tronlab.planning.shots import Plan, Shot

Duration = Callable[[Posture, Posture], float]

_N_NEAR = 8
"""Neighbours of a shot that may come before or after it, beyond those that already do."""
_MAX_ROUNDS = 30
_LONGEST_PIECE = 3
_ROUNDING_S = 1e-9


def in_least_motion(plan: Plan, robot: MotionModel) -> Plan:
    """Give the plan in an order that takes the robot little time; shots keep their ids.

    How the robot stands at a shot may depend on the one before, so the order found is taken only if
    it is quicker with the postures it leads to. Shots out of reach come last.
    """
    alone = [(shot, check_reach_along([shot], robot)[0].posture) for shot in plan.shots]
    reached = [(shot, posture) for shot, posture in alone if posture is not None]
    order = least_motion([posture for _, posture in reached], robot.move_duration_s)
    ordered = [reached[i][0] for i in order]
    if _chain_s(ordered, robot) >= _chain_s(plan.shots, robot):
        return plan
    return Plan((*ordered, *(shot for shot, posture in alone if posture is None)))


def least_motion(postures: Sequence[Posture], duration_s: Duration) -> tuple[int, ...]:
    """Find an order of postures in which moving from each to the next takes little time.

    Args:
        postures: In the order of the trajectory.
        duration_s: How long a move takes. While searching, a move back is taken to last as long as
            the move there; what is compared in the end are true sums.

    Returns:
        Indices of ``postures``; those of the trajectory's own order if nothing better was found.
    """
    as_given = tuple(range(len(postures)))
    if len(postures) < 3:
        return as_given
    legs = _Legs(postures, duration_s)
    places = np.array([[posture.rail_m, *posture.axes_rad] for posture in postures])
    near = _neighbours(places, legs)
    starts = as_given, _greedy(places, near, legs)
    found = min((_mended(start, near, legs) for start in starts), key=legs.sum)
    orders = as_given, found, found[::-1]
    return min(orders, key=lambda order: motion_s([postures[i] for i in order], duration_s))


def motion_s(postures: Sequence[Posture], duration_s: Duration) -> float:
    """Give how long it takes to move through postures one after the other."""
    return sum(duration_s(a, b) for a, b in pairwise(postures))


def _chain_s(shots: Sequence[Shot], robot: MotionModel) -> float:
    """Give how long it takes to move through shots, those out of reach left out."""
    postures = [reach.posture for reach in check_reach_along(shots, robot)]
    return motion_s([posture for posture in postures if posture], robot.move_duration_s)


class _Legs:
    """Time from one posture to another, either way; asked for once and kept.

    The index after the last one stands for nowhere, from and to which moves take no time: it closes
    an open path to a ring.
    """

    def __init__(self, postures: Sequence[Posture], duration_s: Duration) -> None:
        self.nowhere = len(postures)
        self._postures = postures
        self._duration_s = duration_s
        self._known: dict[tuple[int, int], float] = {}

    def __call__(self, a: int, b: int) -> float:
        if self.nowhere in (a, b):
            return 0.0
        key = (a, b) if a < b else (b, a)
        if key not in self._known:
            self._known[key] = self._duration_s(self._postures[key[0]], self._postures[key[1]])
        return self._known[key]

    def sum(self, order: Sequence[int]) -> float:
        return sum(self(a, b) for a, b in pairwise(order))


def _neighbours(places: FloatArray, legs: _Legs) -> list[list[int]]:
    """Give the nearest postures of each, nearest first; places are rail and axes, shape (n, 7)."""
    n_asked = min(_N_NEAR + 1, len(places))
    indices = np.asarray(KDTree(places).query(places, k=n_asked)[1], dtype=np.int64)
    rows: list[list[int]] = indices.tolist()
    return [
        sorted(set(row) - {a}, key=lambda b, a=a: (legs(a, b), b)) for a, row in enumerate(rows)
    ]


def _greedy(places: FloatArray, near: Sequence[Sequence[int]], legs: _Legs) -> tuple[int, ...]:
    """Go from the first posture to the nearest that is left, and so on."""
    path, left = [0], set(range(1, legs.nowhere))
    while left:
        here = path[-1]
        neighbours = [b for b in near[here] if b in left]
        if neighbours:
            path.append(min(neighbours, key=lambda b: legs(here, b)))
        else:
            far = np.array(sorted(left))
            path.append(int(far[np.linalg.norm(places[far] - places[here], axis=1).argmin()]))
        left.remove(path[-1])
    return tuple(path)


def _mended(path: tuple[int, ...], near: Sequence[Sequence[int]], legs: _Legs) -> tuple[int, ...]:
    """Improve a path until neither 2-opt nor Or-opt finds anything more."""
    ring = _Ring([*path, legs.nowhere])
    for _ in range(_MAX_ROUNDS):
        improved = [_uncross(a, ring, near, legs) or _shift(a, ring, near, legs) for a in path]
        if not any(improved):
            break
    return ring.path_from(legs.nowhere)


class _Ring:
    """A closed path, and where everything is in it."""

    def __init__(self, order: list[int]) -> None:
        self.order = order
        self.place = {index: k for k, index in enumerate(order)}

    def after(self, index: int, steps: int = 1) -> int:
        return self.order[(self.place[index] + steps) % len(self.order)]

    def reverse(self, first: int, last: int) -> None:
        """Turn the piece from ``first`` on to ``last`` about."""
        start, end = self.place[first], self.place[last]
        n_between = (end - start) % len(self.order)
        places = [(start + k) % len(self.order) for k in range(n_between + 1)]
        for k, index in zip(places, [self.order[k] for k in reversed(places)], strict=True):
            self.order[k] = index
            self.place[index] = k

    def insert(self, piece: Sequence[int], before: int) -> None:
        """Take a piece out and put it in before an index that is not of it."""
        rest = [index for index in self.order if index not in piece]
        k = rest.index(before)
        self.order = [*rest[:k], *piece, *rest[k:]]
        self.place = {index: k for k, index in enumerate(self.order)}

    def path_from(self, index: int) -> tuple[int, ...]:
        k = self.place[index]
        return (*self.order[k + 1 :], *self.order[:k])


def _uncross(a: int, ring: _Ring, near: Sequence[Sequence[int]], legs: _Legs) -> bool:
    """Exchange two legs for two shorter ones, if one of them leads from a to a neighbour."""
    for step in (1, -1):
        b = ring.after(a, step)
        for c in near[a]:
            gain = legs(a, b) - legs(a, c)
            if gain <= _ROUNDING_S:
                break
            d = ring.after(c, step)
            if gain + legs(c, d) - legs(b, d) > _ROUNDING_S:
                # The piece between the two legs is turned about, so that c comes next to a.
                ring.reverse(*((b, c) if step == 1 else (c, b)))
                return True
    return False


def _shift(a: int, ring: _Ring, near: Sequence[Sequence[int]], legs: _Legs) -> bool:
    """Put a short piece that ends with a beside one of a's neighbours, if that is shorter."""
    for step in (1, -1):
        for length in range(1, _LONGEST_PIECE + 1):
            piece = [ring.after(a, -step * k) for k in range(length)]  # from a away
            before, behind = ring.after(piece[-1], -step), ring.after(a, step)
            if legs.nowhere in piece or before == behind:
                continue
            saved = legs(a, behind) + legs(piece[-1], before) - legs(before, behind)
            for c in near[a]:
                if saved - legs(a, c) <= _ROUNDING_S:
                    break
                if c in piece:
                    continue
                if _settled(piece, c, saved, ring, legs):
                    return True
    return False


def _settled(piece: list[int], c: int, saved: float, ring: _Ring, legs: _Legs) -> bool:
    """Put a piece between c and one that follows or precedes c, its first end at c."""
    a, end = piece[0], piece[-1]
    for step in (1, -1):
        d = ring.after(c, step)
        if d in piece:
            continue
        if saved - legs(a, c) - legs(end, d) + legs(c, d) > _ROUNDING_S:
            ring.insert(piece if step == 1 else piece[::-1], before=d if step == 1 else c)
            return True
    return False
