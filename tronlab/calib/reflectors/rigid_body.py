"""Whether measured reflectors are those of the design, and if not, which of them is wrong.

The distances between reflectors are the same in every frame, so they tell at once what a frame
fitted to wrong reflectors would only blur: labels, seats, units, and a left-handed frame.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.spatial.distance import cdist

from tronlab.geometry.alignment import align_points, largest_misfit_m
from tronlab.geometry.poses import FloatArray

_MM_PER_M = 1000.0
_SAME_FACTOR = 0.01
_FARTHER = 100.0
"""A point so many times as far from the tracker as the nearest one is given in another unit."""
_NEAREST_M = 0.01
_MIRROR = np.array([1.0, 1.0, -1.0])


@dataclass(frozen=True, slots=True)
class RigidBody:
    """Reflectors as designed and as measured."""

    names: tuple[str, ...]
    nominal_m: FloatArray
    """Designed centres, shape (n, 3), in trs or, for a drift, any other frame."""
    measured_m: FloatArray
    """Measured centres, shape (n, 3), in trk."""
    tolerance_m: float
    """How much a measured length may differ from the designed one."""

    @classmethod
    def of(
        cls,
        nominal_m: Mapping[str, FloatArray],
        measured_m: Mapping[str, FloatArray],
        *,
        tolerance_m: float,
    ) -> "RigidBody":
        """Put together what has the same name."""
        return cls(
            names=tuple(nominal_m),
            nominal_m=np.array(list(nominal_m.values())),
            measured_m=np.array([measured_m[name] for name in nominal_m]),
            tolerance_m=tolerance_m,
        )

    @property
    def lengths(self) -> list[tuple[str, str, float, float]]:
        """Get both names, the measured and the nominal length of each pair."""
        measured = cdist(self.measured_m, self.measured_m)
        nominal = cdist(self.nominal_m, self.nominal_m)
        return [
            (self.names[i], self.names[j], float(measured[i, j]), float(nominal[i, j]))
            for i, j in combinations(range(len(self.names)), 2)
        ]

    @property
    def length_errors_m(self) -> dict[str, float]:
        """Get measured minus nominal distance of each pair, keyed ``a-b``."""
        return {f"{a}-{b}": measured - nominal for a, b, measured, nominal in self.lengths}

    @property
    def are_lengths_right(self) -> bool:
        """Get whether every length is as designed."""
        return all(abs(error) <= self.tolerance_m for error in self.length_errors_m.values())

    @property
    def fits(self) -> bool:
        """Get whether the measured points are the designed ones in another place."""
        is_placed = largest_misfit_m(self.nominal_m, self.measured_m) <= self.tolerance_m
        return is_placed and self.are_lengths_right

    @property
    def tracker_height_m(self) -> float:
        """Get how far in front of the model the tracker would stand, along z of the design."""
        return float(align_points(self.nominal_m, self.measured_m).translation[2])

    @property
    def wrong_lengths(self) -> str:
        """Get the lengths that are not as designed, for people."""
        return "; ".join(
            f"{a} to {b} {measured:.4f} m, nominal {nominal:.4f} m"
            for a, b, measured, nominal in self.lengths
            if abs(measured - nominal) > self.tolerance_m
        )

    def without(self, left_out: Sequence[int]) -> "RigidBody":
        """Give the body without some reflectors."""
        kept = [i for i in range(len(self.names)) if i not in left_out]
        return RigidBody(
            names=tuple(self.names[i] for i in kept),
            nominal_m=self.nominal_m[kept],
            measured_m=self.measured_m[kept],
            tolerance_m=self.tolerance_m,
        )

    def relabelled(self, order: Sequence[int]) -> "RigidBody":
        """Give the body whose i-th reflector is where number ``order[i]`` was measured."""
        return replace(self, measured_m=self.measured_m[list(order)])

    def labellings(self) -> list[tuple[int, ...]]:
        """Give all labels under which the points fit and the tracker stands in front.

        The labels as they are come first if they are among them, then those that change least.
        """
        orders = [
            order
            for order in _matches(self.nominal_m, self.measured_m, self.tolerance_m)
            if self.relabelled(order).is_plausible
        ]
        return sorted(orders, key=lambda order: len(self.changed(order)))

    @property
    def is_plausible(self) -> bool:
        """Get whether the points fit and the tracker stands in front of the model."""
        return self.fits and self.tracker_height_m > 0.0

    def changed(self, order: Sequence[int]) -> tuple[str, ...]:
        """Give the reflectors that other labels concern."""
        return tuple(name for i, name in enumerate(self.names) if order[i] != i)

    def culprits(self) -> list[tuple[int, ...]]:
        """Give the fewest reflectors without which all others fit; several sets if in doubt."""
        n = len(self.names)
        for size in range(1, max(1, n - 3) + 1):
            found = [out for out in combinations(range(n), size) if self.without(out).fits]
            if found:
                return found
        return []


def find_fault(body: RigidBody) -> str | None:
    """Say what is wrong with measured reflectors; None if nothing is."""
    labellings = body.labellings()
    if labellings and not body.changed(labellings[0]):
        return None
    if labellings:
        return _name_swap(body, body.changed(labellings[0]))
    if body.fits:
        return (
            f"the tracker would stand {-body.tracker_height_m:.3f} m behind the model, where it"
            " sees no reflector: its coordinates are left-handed (one axis is reversed)"
        )
    if replace(body, measured_m=body.measured_m * _MIRROR).fits:
        return (
            "the reflectors are the mirror image of those designed: the tracker's coordinates are"
            " left-handed (one axis is reversed)"
        )
    return _explain_unit(body) or _explain_places(body)


def find_mixed_units(measured_m: Mapping[str, FloatArray]) -> tuple[str, ...]:
    """Give the points that are in millimetres while others are in metres."""
    distances = {name: float(np.linalg.norm(point)) for name, point in measured_m.items()}
    far_m = _FARTHER * max(min(distances.values()), _NEAREST_M)
    return tuple(name for name, distance in distances.items() if distance > far_m)


def _name_swap(body: RigidBody, names: tuple[str, ...]) -> str:
    swap = f"reflectors {', '.join(names)} are swapped"
    if not body.are_lengths_right:
        return f"{swap}: the lengths fit other labels (wrong now: {body.wrong_lengths})"
    either = f"{swap}, or the tracker's coordinates are left-handed (one axis is reversed)"
    if body.fits:
        return (
            f"the tracker would stand {-body.tracker_height_m:.3f} m behind the model, where it"
            f" sees no reflector: {either}"
        )
    return f"the reflectors are the mirror image of those designed: {either}"


def _explain_unit(body: RigidBody) -> str | None:
    """Say whether all lengths are wrong by one factor."""
    if any(abs(error) <= body.tolerance_m for error in body.length_errors_m.values()):
        return None
    ratios = np.array([measured / nominal for *_, measured, nominal in body.lengths])
    factor = float(ratios.mean())
    shortest_m = min(nominal for *_, nominal in body.lengths)
    if np.ptp(ratios) > 2 * body.tolerance_m / shortest_m * factor:
        return None
    is_mm = abs(factor / _MM_PER_M - 1.0) < _SAME_FACTOR
    unit = "they are in millimetres" if is_mm else "wrong unit or scale"
    return f"all lengths are {factor:.5g} times the nominal ones: {unit}"


def _explain_places(body: RigidBody) -> str:
    """Say which reflector is out of place."""
    culprits = body.culprits()
    table = f" ({body.wrong_lengths})" if body.wrong_lengths else ""
    if not culprits:
        names = ", ".join(body.names[:-1]) + f" and {body.names[-1]}"
        return (
            f"too many lengths are wrong to say what is out of place: {names} are in doubt{table}"
        )
    named = " or ".join(", ".join(body.names[i] for i in out) for out in culprits)
    if len(culprits) == 1 and len(body.names) > 3:
        return f"reflector {named} is out of place by {_displacement(body, culprits[0])}{table}"
    return f"reflector {named} is out of place{table}"


def _displacement(body: RigidBody, out: Sequence[int]) -> str:
    """Say how far reflectors stand from where the others would have them."""
    rest = body.without(out)
    placed = align_points(rest.nominal_m, rest.measured_m).apply(body.measured_m)
    off_m = np.linalg.norm(placed - body.nominal_m, axis=1)[list(out)]
    return ", ".join(f"{off * 1e3:.2f} mm" for off in off_m)


def _matches(
    nominal_m: FloatArray, measured_m: FloatArray, tolerance_m: float
) -> Iterator[tuple[int, ...]]:
    """Give every assignment of measured to nominal points under which all lengths agree."""
    nominal, measured = cdist(nominal_m, nominal_m), cdist(measured_m, measured_m)
    n = len(nominal)

    def extend(order: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        i = len(order)
        if i == n:
            yield order
            return
        for candidate in range(n):
            errors = np.abs(measured[candidate, list(order)] - nominal[i, :i])
            if candidate not in order and (errors <= tolerance_m).all():
                yield from extend((*order, candidate))

    yield from extend(())
