"""The simulated AT901-MR itself: where its beam goes, what it is locked to, what it then measures.

It knows no time, no bytes and no client.
"""

from dataclasses import dataclass, replace
from math import pi, sin
from typing import Final

import numpy as np

from drivers.leica.simulator.codes import MeasurementStatus, Status, TrackerStatus
from drivers.leica.simulator.faults import (
    BEAM_BROKEN,
    POSE_INVALID,
    PROBE_MISSING,
    WARMING_UP,
)
from drivers.leica.simulator.presentation import hvd_of, point_of_hvd
from drivers.leica.simulator.refraction import adm_index, ifm_index
from drivers.leica.simulator.scene import Scene
from drivers.leica.simulator.settings import MONITOR_COMPUTE, MONITOR_OFF, Settings
from drivers.leica.simulator.targets import HOME, MOUNTED, REFLECTORS, TMAC, Target
from tronlab.devices.readings import AirReading, PointReading, PoseReading
from tronlab.geometry.poses import FloatArray
from tronlab.twin.state import Faults
from tronlab.twin.truth import named_rng

P_HOME_M: Final = point_of_hvd(0.0, np.radians(125.0), 0.21)
"""Where the home reflector sits on the tracker."""
_P_ZERO_M: Final = np.array([0.0, 1.0, 0.0])
"""Where the beam points after initialisation, and in 6-D modes instead of home."""
_BEAM_WIDTH_M: Final = 0.01
"""A target this near the beam is caught without a search."""


class RefusedError(Exception):
    """The tracker does not do it; ``status`` says why."""

    def __init__(self, status: int) -> None:
        self.status = status
        super().__init__(f"status {status}")


@dataclass(frozen=True, slots=True)
class Machine:
    """How fast the tracker is, and how well adjusted."""

    initialize_s: float = 2.0
    slew_rad_per_s: float = 3.0
    face_turn_s: float = 1.5
    search_m_per_s: float = 0.2
    """How fast the searching beam leaves the place it was pointed to."""
    two_face_sigma_rad: float = 1.5e-6
    """Collimation and index error are drawn once from this, by serial number."""
    home_drift_sigma_m: float = 5e-6
    """Of the home reflector's coordinates since the last adjustment."""


class Tracker:
    """State of the tracker, and its optics."""

    def __init__(self, scene: Scene, faults: Faults, machine: Machine) -> None:
        self.scene = scene
        self.machine = machine
        self.settings = Settings()
        self.is_initialised = False
        self.is_busy = False
        self.is_laser_on = True
        self.face = 1
        self.target: Target | None = None
        """What the beam is locked to."""
        self.has_distance = False
        self.is_waiting = False
        """Whether the beam stays where it lost its target, and catches it again by itself."""
        self.last_point_m: FloatArray | None = None
        self.last_status = int(Status.OK)
        """Of the last command."""
        self._p_aim_m: FloatArray = _P_ZERO_M
        self._faults = faults
        rng = named_rng(scene.serial, "adjustment of the tracker")
        self._collimation_rad, self._index_rad = machine.two_face_sigma_rad * rng.standard_normal(2)
        self._home_drift_m = machine.home_drift_sigma_m * rng.standard_normal(3)

    @property
    def is_beam_broken(self) -> bool:
        """Look whether something stands in the beam."""
        return self._faults.is_armed(BEAM_BROKEN)

    @property
    def is_warm(self) -> bool:
        """Look whether the laser is stable."""
        return not self._faults.is_armed(WARMING_UP)

    @property
    def has_probe(self) -> bool:
        """Look whether a T-MAC is recognised."""
        return self.scene.trk_from_tmac is not None and not self._faults.is_armed(PROBE_MISSING)

    @property
    def is_pose_valid(self) -> bool:
        """Look whether the T-MAC's rotation is determined."""
        return not self._faults.is_armed(POSE_INVALID)

    @property
    def status(self) -> TrackerStatus:
        """Get whether the tracker could measure now."""
        if self.is_busy:
            return TrackerStatus.BUSY
        if not self.is_initialised or self.mismatch is not None or not self.is_warm:
            return TrackerStatus.NOT_READY
        if self.settings.mode.is_probe and not self.is_pose_valid:
            return TrackerStatus.PROBE_INVALID
        return TrackerStatus.READY

    @property
    def mismatch(self) -> Status | None:
        """Get why the beam's target cannot be measured in the mode; None if it can."""
        is_probe_mode = self.settings.mode.is_probe
        if is_probe_mode and not self.has_probe:
            return Status.NO_PROBE
        if self.target is None:
            return Status.NOT_READY
        if is_probe_mode and self.target != TMAC:
            return Status.NO_PROBE
        if not is_probe_mode and self.target == TMAC:
            return Status.WRONG_REFLECTOR
        if not self.has_distance and not self.settings.stationary_uses_adm:
            return Status.NO_DISTANCE
        return None

    @property
    def measurement_status(self) -> MeasurementStatus:
        """Get what was found, and what is calibrated."""
        found = MeasurementStatus
        mask = found.TRACKER | found.TRACKER_COMPENSATION | found.ADM | found.ADM_COMPENSATION
        mask |= found.CAMERA | found.CAMERA_PARAMETERS | found.CAMERA_TO_TRACKER
        if self.has_probe:
            mask |= found.PROBE | found.PROBE_PARAMETERS
        if self.target is not None and self.target != TMAC:
            mask |= found.REFLECTOR
        if self.face == 1:
            mask |= found.FACE_1
        if self.settings.has_nivel:
            mask |= found.NIVEL_IN_RANGE
        if self.is_initialised:
            mask |= found.INITIALISED
        return mask

    @property
    def air(self) -> AirReading:
        """Get the air that the tracker reckons with."""
        is_off = self.settings.weather_monitor == MONITOR_OFF
        return self.settings.environment if is_off else self.scene.air

    @property
    def refraction(self) -> tuple[float, float]:
        """Get the indices in use, for interferometer and absolute distance meter."""
        if self.settings.weather_monitor == MONITOR_COMPUTE:
            return ifm_index(self.scene.air), adm_index(self.scene.air)
        return self.settings.refraction

    @property
    def p_beam_m(self) -> FloatArray:
        """Get where the beam ends, shape (3,), frame trk: on the target, else where it points."""
        return self._p_aim_m if self.target is None else self._place(self.target)

    def initialise(self) -> None:
        """Be as after command 7."""
        self.is_initialised, self.face = True, 1
        self.release(p_aim_m=_P_ZERO_M)

    def release(self, *, p_aim_m: FloatArray | None = None) -> None:
        """Let go of the target; the beam stays, or points elsewhere."""
        self._p_aim_m = self.p_beam_m if p_aim_m is None else p_aim_m
        self.target, self.has_distance, self.is_waiting = None, False, False

    def leave(self) -> None:
        """Let go of the target and turn the head away."""
        self.release(p_aim_m=_P_ZERO_M)

    def lose_beam(self) -> None:
        """Be as after something came between: the head leaves, or stays if it is told to."""
        if self.settings.keep_last_position:
            self.release()
            self.is_waiting = True
        else:
            self.leave()

    def recapture(self) -> None:
        """Catch the target again where it was lost, if the tracker waits for that."""
        if self.is_waiting and not self.is_busy:
            found = self.nearest(self._p_aim_m, radius_m=self.settings.search_radius_m)
            if found is not None:
                self.lock(found[0], with_distance=True)

    def lock(self, target: Target, *, with_distance: bool) -> None:
        """Follow a target from now on."""
        self.target, self.has_distance, self.is_waiting = target, with_distance, False

    def lock_home(self) -> None:
        """Go to the bird bath; in 6-D modes to the zero position instead (emScon manual 3.0)."""
        if self.settings.mode.is_probe:
            self.leave()
        elif self.is_beam_broken:
            self.release(p_aim_m=P_HOME_M)
        else:
            self.lock(HOME, with_distance=True)

    def nearest(self, p_m: FloatArray, *, radius_m: float) -> tuple[Target, float] | None:
        """Find what a search about a point comes upon first.

        The beam knows directions only, so a target counts by its distance from the beam, reckoned
        at the distance asked for.

        Args:
            p_m: Where the beam points, shape (3,), frame trk.
            radius_m: Of the search.

        Returns:
            The target and how far from the beam it was; None if there is none.
        """
        if self.is_beam_broken:
            return None
        reach_m = max(radius_m, _BEAM_WIDTH_M)
        distance_m = float(np.linalg.norm(p_m))
        offsets = {
            target: distance_m * _angle_between(p_m, self._place(target))
            for target in self._targets()
        }
        near = {target: offset for target, offset in offsets.items() if offset <= reach_m}
        if not near:
            return None
        target = min(near, key=lambda each: near[each])
        return target, near[target]

    def slew_s(self, p_m: FloatArray) -> float:
        """Give how long the head takes to point there."""
        return _angle_between(self.p_beam_m, p_m) / self.machine.slew_rad_per_s

    def turned(self, d_hz: float, d_vt: float) -> FloatArray:
        """Give where the beam would end if the head turned so far, rad."""
        hz, vt, distance_m = hvd_of(self.p_beam_m)
        return point_of_hvd(hz + d_hz, vt + d_vt, distance_m)

    def beam_at(self, distance_m: float) -> FloatArray:
        """Give the point of the beam at a distance."""
        p_m = self.p_beam_m
        return distance_m * p_m / np.linalg.norm(p_m)

    def measure_point(self) -> PointReading:
        """Measure the reflector the beam is on, as this tracker sees it."""
        target = self.target
        if target is None or target == TMAC:
            raise RefusedError(Status.NOT_READY)
        if target == HOME:
            reading = PointReading(HOME.name, self._place(HOME), 1e-12 * np.eye(3), 0.0)
        else:
            reading = self.scene.point(target.name)
        active = REFLECTORS[self.settings.reflector_id]
        constant_m = MOUNTED.distance_constant_m - active.distance_constant_m
        seen = self._see(reading.p_trk_m, constant_m=constant_m)
        self.last_point_m = seen
        return replace(reading, p_trk_m=seen)

    def measure_pose(self) -> PoseReading:
        """Measure the T-MAC, as this tracker sees it."""
        reading = self.scene.pose()
        pose = reading.trk_from_tmac
        seen = self._see(pose.translation)
        self.last_point_m = seen
        moved = type(pose).from_components(seen, pose.rotation)
        return replace(reading, trk_from_tmac=moved)

    def check_home(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Measure the home reflector: nominal Hz, Vt, distance, and how much it has drifted."""
        nominal = hvd_of(P_HOME_M)
        found = hvd_of(P_HOME_M + self._home_drift_m)
        return nominal, tuple(new - old for new, old in zip(found, nominal, strict=True))

    def _targets(self) -> list[Target]:
        reflectors = [Target("reflector", name) for name in self.scene.reflectors]
        tmac = [] if self.scene.trk_from_tmac is None else [TMAC]
        return [*reflectors, *tmac, HOME]

    def _place(self, target: Target) -> FloatArray:
        """Give where a target truly is now."""
        if target == HOME:
            return P_HOME_M + self._home_drift_m
        if target != TMAC:
            return self.scene.reflectors[target.name]
        trk_from_tmac = self.scene.trk_from_tmac
        return self._p_aim_m if trk_from_tmac is None else trk_from_tmac.translation

    def _see(self, p_m: FloatArray, *, constant_m: float = 0.0) -> FloatArray:
        """Add what is wrong with this tracker's settings and adjustment."""
        hz, vt, distance_m = hvd_of(p_m)
        distance_m *= ifm_index(self.scene.air) / self.refraction[0]
        if self.face == 2:
            hz += 2.0 * self._collimation_rad / max(sin(vt), 1e-6)
            vt = min(pi, max(0.0, vt + 2.0 * self._index_rad))
        return point_of_hvd(hz, vt, distance_m + constant_m)


def _angle_between(a: FloatArray, b: FloatArray) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), np.dot(a, b)))
