"""How near anything comes to anything on the way from one posture to the next.

The robot moves all axes and the rail at once, each in proportion. Between two postures no two
bodies come nearer to each other than the turns of the axes between them, times their levers, and
the rail's way allow: where that leaves the clearance that is asked for, nothing can happen. Else
the way is halved, until it is shorter than a centimetre. So nothing that comes nearer than allowed
is missed by more than half of that; of what does not, the distance is that at the places examined.

A robot that takes its rail past the target and back, to come from below, is not followed there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tronlab.devices.readings import Posture
from tronlab.geometry.poses import FloatArray
from tronlab.kinematics.kr16 import AXIS_NAMES, FLANGE_OUT_M
from tronlab.kinematics.kr16_shape import LINK_NAMES, levers_m
from tronlab.planning.assessment import Finding
from tronlab.planning.clearance import Distances, clearances, distances_at
from tronlab.planning.collision import FOOT, PLATE, Clearance, Scene
from tronlab.planning.distances import CORNER_SIGNS

_FINEST_M: Final = 0.01
_N_AXES: Final = len(AXIS_NAMES)
_N_AXES_BEFORE: Final = {name: i for i, name in enumerate((FOOT, *LINK_NAMES, PLATE))}
"""How many axes move each body of the robot."""


@dataclass(frozen=True, slots=True)
class ClearanceCheck:
    """How near anything comes to anything at a shot, and on the way there."""

    at_shot: Clearance | None
    """None if the robot cannot stand there."""
    on_way: Clearance | None
    """From the shot before that can be reached; None if there is none."""
    findings: tuple[Finding, ...]

    @property
    def least_m(self) -> float:
        """Get the lesser distance; NaN if there is none."""
        known = [c.distance_m for c in (self.at_shot, self.on_way) if c is not None]
        return min(known, default=float("nan"))


def check_clearance_along(
    postures: Sequence[Posture | None], scene: Scene, *, start: Posture | None = None
) -> tuple[ClearanceCheck, ...]:
    """Hold shots, and the moves between them, against the envelope.

    Args:
        postures: One a shot, in the order taken; None where the robot cannot stand.
        scene: The cell.
        start: Where the robot stands before; the way to the first shot is checked only then.

    Returns:
        One check a shot; refusals where anything comes nearer than the envelope allows, or the
        robot meets itself. A way is refused only where both its ends are free: of any other it is
        not the way that has to change.
    """
    chain = [posture for posture in (start, *postures) if posture is not None]
    if not chain:
        return tuple(ClearanceCheck(None, None, ()) for _ in postures)
    at = clearances(chain, scene)
    ways = passage_clearances(chain, scene)
    checks = [
        _check(before, here, way, scene)
        for before, here, way in zip((None, *at[:-1]), at, (None, *ways), strict=True)
    ]
    standing = iter(checks if start is None else checks[1:])
    nowhere = ClearanceCheck(None, None, ())
    return tuple(nowhere if posture is None else next(standing) for posture in postures)


def passage_clearances(postures: Sequence[Posture], scene: Scene) -> tuple[Clearance, ...]:
    """Give what comes nearest on the way between each two consecutive postures, and how near."""
    states = np.array([[p.rail_m, *p.axes_rad] for p in postures])
    if len(states) < 2:
        return ()
    at = distances_at(states[:, 0], states[:, 1:], scene)
    levers = _Levers.of(at, scene)
    # Of each motion and pair the least distance found so far.
    least_m = np.minimum(at.distance_m[:-1], at.distance_m[1:])
    ways = _Ways(
        motion=np.arange(len(states) - 1),
        start=states[:-1],
        end=states[1:],
        start_m=at.distance_m[:-1],
        end_m=at.distance_m[1:],
    )
    while True:
        ways = ways.chosen(_is_doubtful(ways, levers, at.is_own, scene, least_m))
        if not len(ways.motion):
            break
        middle = (ways.start + ways.end) / 2.0
        middle_m = distances_at(middle[:, 0], middle[:, 1:], scene).distance_m
        np.minimum.at(least_m, ways.motion, middle_m)
        ways = ways.halved(middle, middle_m)
    return Distances(least_m, at.pairs, at.is_own).nearest


@dataclass(frozen=True, slots=True)
class _Levers:
    """How far the bodies of each pair move towards each other, at most."""

    rail: FloatArray
    """Metres for each metre of the rail, shape (pairs,)."""
    axes_m: FloatArray
    """Metres for each radian of the axes, shape (6, pairs)."""

    @classmethod
    def of(cls, distances: Distances, scene: Scene) -> "_Levers":
        envelope = scene.envelope
        corners = np.array(envelope.plate_centre_m) + CORNER_SIGNS * envelope.plate_m / 2.0
        from_wrist = corners + np.array([0.0, 0.0, FLANGE_OUT_M])
        by_body = levers_m(float(np.linalg.norm(from_wrist, axis=-1).max()))
        rail_m = float(np.linalg.norm(scene.mounting.rail_axis))
        n_before = [
            [_N_AXES_BEFORE[name] for name in (pair if is_own else pair[:1])]
            for pair, is_own in zip(distances.pairs, distances.is_own, strict=True)
        ]
        return cls(
            np.where(distances.is_own, 0.0, rail_m),  # the rail carries all of the robot alike
            np.stack([_between(by_body, n) for n in n_before], axis=1),
        )


def _between(by_body: FloatArray, n_before: Sequence[int]) -> FloatArray:
    """Give the levers for the outermost of bodies, of the axes that do not move all of them."""
    outer, inner = max(n_before), min(n_before) if len(n_before) > 1 else 0
    if outer == 0:  # the foot
        return np.zeros(_N_AXES)
    return np.where(np.arange(_N_AXES) < inner, 0.0, by_body[outer - 1])


@dataclass(frozen=True, slots=True)
class _Ways:
    """Parts of motions, a stack of m."""

    motion: NDArray[np.intp]
    """Which motion each is a part of, shape (m,)."""
    start: FloatArray
    """Rail and axes, shape (m, 7)."""
    end: FloatArray
    start_m: FloatArray
    """Distances of all pairs there, shape (m, pairs)."""
    end_m: FloatArray

    def lengths_m(self, levers: _Levers) -> FloatArray:
        """Bound how far the bodies of each pair move towards each other, shape (m, pairs)."""
        travel = np.abs(self.end - self.start)
        return np.outer(travel[:, 0], levers.rail) + travel[:, 1:] @ levers.axes_m

    def chosen(self, which: NDArray[np.bool_]) -> "_Ways":
        """Give some of them."""
        return _Ways(
            self.motion[which],
            self.start[which],
            self.end[which],
            self.start_m[which],
            self.end_m[which],
        )

    def halved(self, middle: FloatArray, middle_m: FloatArray) -> "_Ways":
        """Give twice as many, half as long."""
        return _Ways(
            np.concatenate([self.motion, self.motion]),
            np.concatenate([self.start, middle]),
            np.concatenate([middle, self.end]),
            np.concatenate([self.start_m, middle_m]),
            np.concatenate([middle_m, self.end_m]),
        )


def _is_doubtful(
    ways: _Ways,
    levers: _Levers,
    is_own: NDArray[np.bool_],
    scene: Scene,
    least_m: FloatArray,
) -> NDArray[np.bool_]:
    """Tell which could come nearer than allowed, and than is known of their motion; shape (m,).

    Where bodies meet on a motion it is refused: how deep they go is of no interest.
    """
    length_m = ways.lengths_m(levers)
    possible_m = (ways.start_m + ways.end_m - length_m) / 2.0
    allowed_m = np.where(is_own, 0.0, scene.envelope.clearance_m)
    is_near = possible_m < np.minimum(allowed_m, least_m[ways.motion])
    is_open = least_m.min(axis=1)[ways.motion] >= 0.0
    return is_open & np.logical_or.reduce(is_near & (length_m > _FINEST_M), axis=1)


def _check(
    before: Clearance | None, here: Clearance, way: Clearance | None, scene: Scene
) -> ClearanceCheck:
    allowed_m = scene.envelope.clearance_m
    findings: tuple[Finding, ...] = ()
    if here.distance_m < allowed_m:
        findings = (Finding("collision", _describe(here, allowed_m)),)
    elif before is not None and way is not None and way.distance_m < allowed_m <= before.distance_m:
        findings = (Finding("collision", f"on the way there {_describe(way, allowed_m)}"),)
    return ClearanceCheck(here, way, findings)


def _describe(found: Clearance, allowed_m: float) -> str:
    first, second = found.between
    if found.distance_m < 0.0:
        return f"{first} and {second} meet, {-found.distance_m:.3f} m deep"
    return (
        f"{first} comes to {found.distance_m:.3f} m from {second}, allowed {allowed_m:g} m"
        " (cell.envelope.clearance_m)"
    )
