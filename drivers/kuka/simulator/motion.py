"""How the controller moves: along a path, with a speed that rises and falls as a trapezoid."""

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform, Slerp

from drivers.kuka.simulator.command import Refusal, Refused
from drivers.kuka.simulator.machine import ENCODER_STEP_MM, N_ARM, RAIL, Machine, axes_at, flange_of
from tronlab.geometry.poses import FloatArray

_N_SAMPLES: Final = 64
"""A line is examined at so many places before it is begun."""
_LARGEST_STEP_DEG: Final = 45.0
"""An axis that turns more between two of them is on its way into another branch."""


class Path(Protocol):
    """A way from here to there, by progress from 0 to 1."""

    def at(self, progress: float) -> FloatArray:
        """Give the axes, shape (7,), degrees and mm."""
        ...


class Profile(Protocol):
    """Progress over time."""

    @property
    def duration_s(self) -> float:
        """Get how long it takes."""
        ...

    def at(self, time_s: float) -> tuple[float, float]:
        """Give progress, and its speed per second, so long after the start."""
        ...


@dataclass(frozen=True, slots=True)
class Trapezoid:
    """From 0 to 1: speed up, go on, slow down."""

    speed: float
    """Highest, per second."""
    acceleration: float
    """Per second squared."""

    @property
    def duration_s(self) -> float:
        """Get how long it takes."""
        return 1.0 / self._top + self._top / self.acceleration

    @property
    def _top(self) -> float:
        """Get the highest speed there is room for."""
        return min(self.speed, float(np.sqrt(self.acceleration)))

    def at(self, time_s: float) -> tuple[float, float]:
        """Give progress and speed."""
        left_s = self.duration_s - time_s
        ramp_s = self._top / self.acceleration
        if left_s <= 0.0:
            return 1.0, 0.0
        if time_s < ramp_s:
            return 0.5 * self.acceleration * time_s**2, self.acceleration * time_s
        if left_s < ramp_s:
            return 1.0 - 0.5 * self.acceleration * left_s**2, self.acceleration * left_s
        return self._top * (time_s - 0.5 * ramp_s), self._top


@dataclass(frozen=True, slots=True)
class Brake:
    """From some progress and speed to a stop, as soon as the acceleration allows."""

    progress: float
    speed: float
    acceleration: float

    @property
    def duration_s(self) -> float:
        """Get how long it takes."""
        return self.speed / self.acceleration

    def at(self, time_s: float) -> tuple[float, float]:
        """Give progress and speed."""
        t = min(time_s, self.duration_s)
        gone = self.speed * t - 0.5 * self.acceleration * t**2
        return self.progress + gone, self.speed - self.acceleration * t


@dataclass(frozen=True)
class AxisPath:
    """All axes move at once, from start to end, shape (7,) each."""

    start: FloatArray
    end: FloatArray

    def at(self, progress: float) -> FloatArray:
        """Give the axes."""
        return self.end if progress >= 1.0 else self.start + progress * (self.end - self.start)


class LinePath:
    """The flange moves along a straight line and turns about one axis; E1 moves along.

    Raises:
        Refused: Somewhere on the line an axis is beyond its limits, or jumps.
    """

    def __init__(
        self, start: FloatArray, base_from_flange: RigidTransform, e1_mm: float, machine: Machine
    ) -> None:
        self._machine = machine
        self._e1_mm = start[RAIL], e1_mm
        self._poses = flange_of(start), base_from_flange
        turns = RigidTransform.concatenate(self._poses).rotation
        self._slerp = Slerp([0.0, 1.0], turns)
        self._samples = self._examine(start)

    @property
    def length_mm(self) -> float:
        """Get how far the flange moves."""
        first, last = (pose.translation for pose in self._poses)
        return float(np.linalg.norm(last - first)) * 1e3

    @property
    def turn_deg(self) -> float:
        """Get how far the flange turns."""
        first, last = (pose.rotation for pose in self._poses)
        return float(np.degrees((first.inv() * last).magnitude()))

    @property
    def steepest(self) -> FloatArray:
        """Get how fast each axis changes with progress at most, shape (7,)."""
        return np.abs(np.diff(self._samples, axis=0)).max(axis=0) * _N_SAMPLES

    def at(self, progress: float) -> FloatArray:
        """Give the axes."""
        near = self._samples[min(round(progress * _N_SAMPLES), _N_SAMPLES)]
        return self._axes(min(progress, 1.0), near)

    def _examine(self, start: FloatArray) -> FloatArray:
        samples = [start]
        for progress in np.linspace(0.0, 1.0, _N_SAMPLES + 1)[1:]:
            samples.append(self._axes(float(progress), samples[-1]))
        steps = np.abs(np.diff(samples, axis=0))[:, :N_ARM]
        if steps.max() > _LARGEST_STEP_DEG:
            raise Refused(Refusal.FAILED)  # the wrist would turn over
        return np.array(samples)

    def _axes(self, progress: float, near: FloatArray) -> FloatArray:
        first, last = (pose.translation for pose in self._poses)
        place = first + progress * (last - first)
        pose = RigidTransform.from_components(place, self._slerp([progress])[0])
        arm = axes_at(pose, near, self._machine)
        if arm is None:
            raise Refused(Refusal.FAILED)
        return np.array([*arm, self._e1_mm[0] + progress * (self._e1_mm[1] - self._e1_mm[0])])


def axis_path(start: FloatArray, end: FloatArray) -> AxisPath:
    """Make the path of a PTP motion; a rail that would move by less than it can tell stays."""
    end = end.copy()
    if abs(end[RAIL] - start[RAIL]) < ENCODER_STEP_MM:
        end[RAIL] = start[RAIL]
    return AxisPath(start, end)


def axis_profile(path: AxisPath, machine: Machine, *, speed: float, ramp: float) -> Trapezoid:
    """Let all axes start and stop together, as fast as the slowest of them can.

    Args:
        path: The path.
        machine: Whose speeds count.
        speed: Part of the full speed.
        ramp: Part of the full acceleration.
    """
    return _profile(
        (machine.speeds, machine.accelerations, np.abs(path.end - path.start)), speed, ramp
    )


def line_profile(path: LinePath, machine: Machine, *, speed: float, ramp: float) -> Trapezoid:
    """Move along a line no faster than path, turning and every axis allow."""
    speeds = [machine.path_speed_mm_per_s, machine.path_turn_deg_per_s, *machine.speeds]
    ramps = [
        machine.path_acceleration_mm_per_s2,
        machine.path_turn_deg_per_s / machine.axis_ramp_s,
        *machine.accelerations,
    ]
    distances = np.array([path.length_mm, path.turn_deg, *path.steepest])
    return _profile((np.array(speeds), np.array(ramps), distances), speed, ramp)


def _profile(
    limits: tuple[FloatArray, FloatArray, FloatArray], speed: float, ramp: float
) -> Trapezoid:
    speeds, ramps, distances = limits
    moves = distances > 1e-9
    if not moves.any():
        return Trapezoid(speed=1e3, acceleration=1e6)  # nothing to do: done at the next tick
    return Trapezoid(
        speed=speed * float((speeds[moves] / distances[moves]).min()),
        acceleration=ramp * float((ramps[moves] / distances[moves]).min()),
    )
