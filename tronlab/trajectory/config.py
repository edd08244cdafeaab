"""The ``trajectory`` section of a campaign file."""

import math
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from tronlab.errors import FrameError
from tronlab.geometry.poses import pose_along_boresight, unit
from tronlab.yaml_models import ExistingFile, Model

Vector: TypeAlias = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]


class StraightLine(Model):
    """Equally spaced camera positions on a line, all with one orientation."""

    kind: Literal["straight_line"]
    start_trs_m: Vector
    """First position of the camera, frame trs."""
    end_trs_m: Vector
    """Last position of the camera, frame trs."""
    n_points: Annotated[int, Field(ge=1, le=1_000_000)]
    """Number of poses, both ends included."""
    boresight_trs: Vector = (0.0, 0.0, -1.0)
    """Direction the camera looks in, frame trs; any length."""
    right_trs: Vector = (0.0, 1.0, 0.0)
    """Direction that is to the right in the image, frame trs; any length."""

    @model_validator(mode="after")
    def _is_a_line(self) -> "StraightLine":
        if self.n_points > 1 and self.start_trs_m == self.end_trs_m:
            raise ValueError("start_trs_m and end_trs_m are the same point; expected a line")
        try:
            pose_along_boresight(
                self.start_trs_m, boresight=self.boresight_trs, right=self.right_trs
            )
        except FrameError as error:
            raise ValueError(f"boresight_trs, right_trs: {error}") from error
        return self


class PoseFile(Model):
    """Camera poses from a CSV file."""

    kind: Literal["file"]
    path: ExistingFile
    """CSV with the header ``x,y,z,qx,qy,qz,qw``: trs_from_cam a line, metres and unit quaternion,
    scalar last. Relative to the campaign file."""


class DescentStart(Model):
    """State of the lander where the powered descent begins, at full scale.

    Local vertical frame: origin in the landing point, z up. The defaults are the paper's (section
    3.4).
    """

    position_m: Vector = (-101.0, 50.0, 1500.0)
    """Position."""
    velocity_m_per_s: Vector = (10.0, -10.0, -40.0)
    """Velocity."""

    def __hash__(self) -> int:
        """Hash by value: descents that were found are kept by it."""
        return hash((self.position_m, self.velocity_m_per_s))

    @model_validator(mode="after")
    def _is_above_ground(self) -> "DescentStart":
        if self.position_m[2] <= 0:
            raise ValueError(
                f"position_m[2] is {self.position_m[2]:g}; must be above the landing point, at 0"
            )
        return self


class Lander(Model):
    """The lander, and what it may do; full scale."""

    mass_kg: Positive = 2000.0
    """Mass at the start."""
    dry_mass_kg: Positive = 1000.0
    """Mass without fuel."""
    exhaust_velocity_m_per_s: Positive = 3000.0
    """Effective speed of the exhaust: specific impulse times 9.80665 m/s2."""
    thrust_n: tuple[Positive, Positive] = (1000.0, 8000.0)
    """Least and greatest thrust; the engine never stops."""
    max_tilt_deg: Annotated[float, Field(gt=0, lt=90)] = 10.0
    """Greatest angle between thrust and vertical."""
    min_glide_slope_deg: Annotated[float, Field(ge=0, lt=90)] = 60.0
    """Least elevation of the lander, seen from the landing point."""
    gravity_m_per_s2: Positive = 1.62
    """Gravity; the Moon's unless said otherwise."""

    def __hash__(self) -> int:
        """Hash by value: descents that were found are kept by it."""
        return hash(tuple(self.__dict__.values()))

    @model_validator(mode="after")
    def _can_fly(self) -> "Lander":
        least, greatest = self.thrust_n
        if least >= greatest:
            raise ValueError(f"thrust_n: the first value must be below the second, {greatest:g}")
        if self.dry_mass_kg >= self.mass_kg:
            raise ValueError(
                f"dry_mass_kg {self.dry_mass_kg:g} must be below mass_kg {self.mass_kg:g}"
            )
        weight_n = self.dry_mass_kg * self.gravity_m_per_s2
        if greatest <= weight_n:
            raise ValueError(
                f"thrust_n[1] {greatest:g} must exceed the weight of dry_mass_kg, {weight_n:g} N"
            )
        return self

    @property
    def max_tilt_rad(self) -> float:
        """Get the greatest angle between thrust and vertical."""
        return math.radians(self.max_tilt_deg)

    @property
    def min_glide_slope_rad(self) -> float:
        """Get the least elevation of the lander, seen from the landing point."""
        return math.radians(self.min_glide_slope_deg)


class PathSampling(Model):
    """Which points of a trajectory become poses; lengths in the laboratory."""

    spacing_m: Positive
    """Length of path between two points, counted back from the landing point."""
    height_m: tuple[Annotated[float, Field(ge=0)], Positive]
    """Least and greatest height of the camera above the landing point; other points are left
    out."""

    @model_validator(mode="after")
    def _is_ordered(self) -> "PathSampling":
        if self.height_m[0] >= self.height_m[1]:
            raise ValueError("height_m: the first value must be below the second")
        return self


class Perturbation(Model):
    """Trajectories from other starts than the nominal one; full scale.

    Every coordinate and every component gets an error of its own, uniform between minus and plus
    the value given. A start from which no descent is possible is drawn anew.
    """

    n: Annotated[int, Field(ge=1, le=10_000)]
    """How many; they are numbered from 1."""
    seed: Annotated[int, Field(ge=0, lt=2**32)]
    """Of the errors. Each number has a stream of its own, so that its trajectory does not depend on
    the others."""
    position_m: Annotated[float, Field(ge=0)] = 100.0
    """Greatest error of each coordinate; the default is the paper's."""
    velocity_m_per_s: Annotated[float, Field(ge=0)] = 10.0
    """Greatest error of each component; the default is the paper's."""
    only: Annotated[tuple[int, ...], Field(min_length=1)] | None = None
    """Numbers of those that are flown; null: all."""

    @model_validator(mode="after")
    def _are_among_them(self) -> "Perturbation":
        numbers = self.only or ()
        strange = [number for number in numbers if not 1 <= number <= self.n]
        if strange:
            raise ValueError(f"only: there is no trajectory {strange[0]}; allowed: 1 to {self.n}")
        if len(set(numbers)) < len(numbers):
            raise ValueError("only: a number stands twice")
        return self

    @property
    def numbers(self) -> tuple[int, ...]:
        """Get the numbers of those that are flown."""
        return tuple(range(1, self.n + 1)) if self.only is None else self.only


class PoweredDescent(Model):
    """Minimum-fuel powered descents to a landing point, scaled down into the laboratory.

    The lander's upward axis is along its thrust; the camera looks against the thrust.
    """

    kind: Literal["powered_descent"]
    landing_point_trs_m: Vector
    """Where the descents end, frame trs: origin of the local vertical frame, whose z is Z of
    trs."""
    heading_deg: float = 0.0
    """x of the local vertical frame is X of trs, turned about Z by this."""
    scale: Annotated[float, Field(gt=0, le=1)] = 0.01
    """Length in the laboratory over length at full scale."""
    right_trs: Vector = (0.0, 1.0, 0.0)
    """Direction that is to the right in the image, frame trs; any length. Only its part
    perpendicular to the optical axis counts."""
    start: DescentStart = DescentStart()
    """Where the nominal descent begins."""
    lander: Lander = Lander()
    """The lander, and what it may do."""
    sampling: PathSampling
    """Which points of a trajectory become poses."""
    perturbed: Perturbation | None = None
    """The trajectories of the campaign, in place of the nominal one; null: the nominal one."""

    @model_validator(mode="after")
    def _right_is_never_along_the_boresight(self) -> "PoweredDescent":
        try:
            right = unit(self.right_trs, what="right_trs")
        except FrameError as error:
            raise ValueError(str(error)) from error
        angle_deg = math.degrees(math.acos(min(abs(float(right[2])), 1.0)))
        if angle_deg <= self.lander.max_tilt_deg:
            raise ValueError(
                f"right_trs: is {angle_deg:.3g} degrees from the vertical, where the optical axis"
                f" may be (lander.max_tilt_deg {self.lander.max_tilt_deg:g}); expected a direction"
                " nearer to the horizontal"
            )
        return self

    @model_validator(mode="after")
    def _starts_on_the_glide_slope(self) -> "PoweredDescent":
        elevation_deg = math.degrees(elevation_rad(self.start.position_m))
        if elevation_deg < self.lander.min_glide_slope_deg:
            raise ValueError(
                f"start.position_m: its elevation is {elevation_deg:.4g} degrees, must be at least"
                f" lander.min_glide_slope_deg {self.lander.min_glide_slope_deg:g}"
            )
        return self


def elevation_rad(position_m: Vector) -> float:
    """Give the angle above the horizon at which a point is seen from the origin."""
    x, y, z = position_m
    return float(np.arctan2(z, np.hypot(x, y)))


TrajectoryConfig: TypeAlias = Annotated[
    StraightLine | PoseFile | PoweredDescent, Field(discriminator="kind")
]
