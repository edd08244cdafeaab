"""Powered descents of a campaign: the nominal one and perturbed ones, and their camera poses."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import ConfigError
from tronlab.geometry.poses import FloatArray, pose_along_boresight
from tronlab.trajectory.cone_programme import Flight
from tronlab.trajectory.config import (
    DescentStart,
    Lander,
    Perturbation,
    PoweredDescent,
    elevation_rad,
)
from tronlab.trajectory.guidance import land, limits_in_the_way
from tronlab.trajectory.path_sampling import equally_spaced, path_length_m

NOMINAL = 0
"""Number of the nominal trajectory; perturbed ones count from 1."""
MAX_DRAWS = 20
"""So many starts are drawn for one perturbed trajectory, then it is given up."""
TIGHT = 1e-3
"""Relative difference of thrust and its bound up to which the relaxation counts as tight."""
_ROUNDING_M = 1e-6


@dataclass(frozen=True, slots=True)
class Descent:
    """One trajectory, and the poses of the camera on it."""

    number: int
    """0 is the nominal trajectory; perturbed ones count from 1."""
    start: DescentStart
    flight: Flight
    """States at full scale, in the local vertical frame."""
    path_m: float
    """Length at full scale."""
    sampled_time_s: FloatArray
    """When it is at each pose, full scale, shape (n,)."""
    trs_from_cam: tuple[RigidTransform, ...]
    """Poses, in the order they are flown, in the laboratory."""

    @property
    def flight_time_s(self) -> float:
        """Get the time until it lands."""
        return float(self.flight.time_s[-1])

    @property
    def fuel_kg(self) -> float:
        """Get the fuel it takes."""
        return float(self.flight.mass_kg[0] - self.flight.mass_kg[-1])

    @property
    def max_tilt_deg(self) -> float:
        """Get the greatest angle between thrust and vertical."""
        return float(np.degrees(tilt_rad(self.flight).max()))

    @property
    def relaxation_gap(self) -> float:
        """Get by how much of itself the thrust is below its bound, at the time it is most."""
        magnitude = np.linalg.norm(self.flight.acceleration_m_per_s2, axis=1)
        return float(np.max(1.0 - magnitude / self.flight.slack_m_per_s2))

    @property
    def is_tight(self) -> bool:
        """Get whether the convex programme solved the problem itself, not only a relaxation."""
        return self.relaxation_gap <= TIGHT


@dataclass(frozen=True, slots=True)
class RejectedStart:
    """A start that was drawn and from which no descent is possible."""

    number: int
    """Trajectory it was drawn for."""
    start: DescentStart
    reason: str


@dataclass(frozen=True, slots=True)
class DescentSet:
    """The trajectories of a campaign."""

    lander: Lander
    nominal: Descent
    trajectories: tuple[Descent, ...]
    """Those the campaign flies, in their order: the nominal one, or the perturbed ones."""
    rejected: tuple[RejectedStart, ...]
    """Starts that were drawn anew."""


def fly(
    config: PoweredDescent, *, on_descent: Callable[[int, int], None] | None = None
) -> DescentSet:
    """Find the trajectories of a campaign.

    A descent once found is kept as long as the process lives, so that this is slow only once.

    Args:
        config: Section ``trajectory``.
        on_descent: Told (descents found, descents in all) after each.

    Raises:
        ConfigError: There is no descent from the nominal start, or from any start drawn for one
            trajectory; no point of any is within the heights; or Clarabel is not installed.
    """
    perturbed = config.perturbed
    tell = on_descent or (lambda n_done, n_all: None)
    n_all = 1 if perturbed is None else 1 + len(perturbed.numbers)
    nominal = _nominal(config)
    tell(1, n_all)
    flown: list[Descent] = []
    rejected: list[RejectedStart] = []
    if perturbed is None:
        flown.append(nominal)
    else:
        for number in perturbed.numbers:
            flown.append(_perturbed(config, perturbed, number, rejected))
            tell(1 + len(flown), n_all)
    _check_has_poses(flown, config)
    return DescentSet(config.lander, nominal, tuple(flown), tuple(rejected))


def tilt_rad(flight: Flight) -> FloatArray:
    """Give the angle between thrust and vertical over time, shape (n + 1,)."""
    x, y, z = flight.acceleration_m_per_s2.T
    return np.arctan2(np.hypot(x, y), z)


def draw_start(
    nominal: DescentStart, perturbed: Perturbation, rng: np.random.Generator
) -> DescentStart:
    """Draw a start about the nominal one; it need not be one from which a lander can land."""
    position_m = nominal.position_m + perturbed.position_m * rng.uniform(-1.0, 1.0, 3)
    velocity = nominal.velocity_m_per_s + perturbed.velocity_m_per_s * rng.uniform(-1.0, 1.0, 3)
    return DescentStart.model_construct(
        position_m=tuple(position_m.tolist()), velocity_m_per_s=tuple(velocity.tolist())
    )


def _nominal(config: PoweredDescent) -> Descent:
    flight = land(config.start, config.lander)
    if flight is None:
        raise ConfigError(
            f"there is no descent from here: {_reason(config.start, config.lander)}; change the"
            " start, or widen a limit of trajectory.lander",
            key="trajectory.start",
        )
    return _descent(config, NOMINAL, config.start, flight)


def _perturbed(
    config: PoweredDescent, perturbed: Perturbation, number: int, rejected: list[RejectedStart]
) -> Descent:
    """Draw starts until there is a descent from one; note the others."""
    rng = np.random.default_rng([perturbed.seed, number])
    reason = ""
    for _ in range(MAX_DRAWS):
        start = draw_start(config.start, perturbed, rng)
        flight = _land_from_anywhere(start, config.lander)
        if flight is not None:
            return _descent(config, number, start, flight)
        reason = _reason(start, config.lander)
        rejected.append(RejectedStart(number, start, reason))
    raise ConfigError(
        f"trajectory {number}: there is no descent from any of {MAX_DRAWS} starts drawn; the last"
        f" one: {reason}; make position_m or velocity_m_per_s smaller, or widen a limit of"
        " trajectory.lander",
        key="trajectory.perturbed",
    )


def _check_has_poses(flown: Sequence[Descent], config: PoweredDescent) -> None:
    if any(descent.trs_from_cam for descent in flown):
        return
    least_m, greatest_m = config.sampling.height_m
    highest_m = config.scale * max(float(d.flight.position_m[:, 2].max()) for d in flown)
    raise ConfigError(
        f"no point of any trajectory is {least_m:g} to {greatest_m:g} m above the landing point;"
        f" they reach up to {highest_m:.3g} m, with a point every"
        f" {config.sampling.spacing_m:g} m: change height_m or spacing_m",
        key="trajectory.sampling",
    )


def _land_from_anywhere(start: DescentStart, lander: Lander) -> Flight | None:
    return land(start, lander) if _is_on_glide_slope(start, lander) else None


def _is_on_glide_slope(start: DescentStart, lander: Lander) -> bool:
    return start.position_m[2] > 0 and elevation_rad(start.position_m) >= lander.min_glide_slope_rad


def _reason(start: DescentStart, lander: Lander) -> str:
    """Say why there is no descent from a start."""
    if not _is_on_glide_slope(start, lander):
        elevation_deg = math.degrees(elevation_rad(start.position_m))
        return (
            f"its elevation is {elevation_deg:.1f} degrees, below min_glide_slope_deg"
            f" {lander.min_glide_slope_deg:g}"
        )
    limits = limits_in_the_way(start, lander)
    if not limits:
        return "several of the lander's limits are in the way, none of them alone"
    return f"in the way {'is' if len(limits) == 1 else 'is each of'} {', '.join(limits)}"


def _descent(config: PoweredDescent, number: int, start: DescentStart, flight: Flight) -> Descent:
    """Sample a flight and take it into the laboratory."""
    gravity = config.lander.gravity_m_per_s2
    points = equally_spaced(
        flight, config.sampling.spacing_m / config.scale, gravity_m_per_s2=gravity
    )
    heights_m = config.scale * points.position_m[:, 2]
    least_m, greatest_m = config.sampling.height_m
    is_kept = (heights_m >= least_m - _ROUNDING_M) & (heights_m <= greatest_m + _ROUNDING_M)
    trs_from_local = RigidTransform.from_components(
        config.landing_point_trs_m, Rotation.from_euler("Z", config.heading_deg, degrees=True)
    )
    positions_trs_m = trs_from_local.apply(config.scale * points.position_m[is_kept])
    boresights_trs = -trs_from_local.rotation.apply(points.thrust_direction[is_kept])
    return Descent(
        number=number,
        start=start,
        flight=flight,
        path_m=path_length_m(flight, gravity_m_per_s2=gravity),
        sampled_time_s=points.time_s[is_kept],
        trs_from_cam=tuple(
            pose_along_boresight(p_m, boresight=boresight, right=config.right_trs)
            for p_m, boresight in zip(positions_trs_m, boresights_trs, strict=True)
        ),
    )
