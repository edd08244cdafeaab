"""What a plan comes to: of every shot whether it can be taken, why not, and how long it takes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from scipy.spatial.transform import RigidTransform

from tronlab.devices.readings import Posture
from tronlab.planning.shots import Shot

CheckName: TypeAlias = Literal[
    "reach",
    "branch",
    "singularity",
    "collision",
    "sight",
    "view",
    "usable",
    "range",
    "light",
]
"""reach: rail and axes; branch: the arm would change its configuration on the way; sight: from
tracker to T-MAC; view: the optical axis meets the terrain; light: the lamp reaches what is seen."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that speaks against a shot."""

    check: CheckName
    text: str
    """What, the value and what is allowed."""
    is_refusal: bool = True
    """Else a warning: it can be taken all the same."""


@dataclass(frozen=True, slots=True)
class ShotDuration:
    """How long the parts of a shot take by estimate, seconds; as ``ShotTiming`` of the data."""

    move_s: float
    settle_s: float
    tracker_s: float
    camera_s: float
    """Exposure and read-out."""
    confirm_s: float
    read_s: float
    write_s: float

    @property
    def total_s(self) -> float:
        """Get the sum."""
        return (
            self.move_s
            + self.settle_s
            + self.tracker_s
            + self.camera_s
            + self.confirm_s
            + self.read_s
            + self.write_s
        )


@dataclass(frozen=True, slots=True)
class ShotAssessment:
    """What is known of one shot before it is taken; None or NaN where a check could not be made."""

    shot: Shot
    posture: Posture | None
    """How the robot will stand; None if it cannot."""
    findings: tuple[Finding, ...]
    range_los_m: float
    usable_fraction: float
    lit_fraction: float
    """Part of the visible model that the lamp lights, terrain's and robot's shadow considered."""
    robot_shadow: float
    """Part of the visible model that the robot keeps the lamp from."""
    tmac_distance_m: float
    """From the tracker."""
    tmac_angle_rad: float
    """Between the T-MAC's axis and the beam."""
    clearance_m: float
    """Least distance of arm, plate, floor, model and obstacles; negative: they meet."""
    duration: ShotDuration
    """All 0 for a shot that is refused: it will not be taken."""
    nearest: RigidTransform | None = None
    """``trs_from_cam`` of the nearest pose known that could be taken instead, if this one cannot:
    itself checked, with the ways to and from it. None: none was found, or none looked for."""

    @property
    def is_refused(self) -> bool:
        """Get whether it cannot be taken."""
        return any(finding.is_refusal for finding in self.findings)


@dataclass(frozen=True, slots=True)
class PlanAssessment:
    """What is known of all shots, in the order in which they would be taken."""

    shots: tuple[ShotAssessment, ...]
    drift_checks_s: float
    """Time of all drift checks."""
    start_s: float
    """Before the first shot."""

    @property
    def refused(self) -> tuple[ShotAssessment, ...]:
        """Get the shots that cannot be taken."""
        return tuple(shot for shot in self.shots if shot.is_refused)

    @property
    def total_s(self) -> float:
        """Get the estimate of the whole run's time."""
        return self.start_s + self.drift_checks_s + sum(s.duration.total_s for s in self.shots)

    @property
    def parts_s(self) -> Mapping[str, float]:
        """Get the time of all shots by part, then drift checks and start."""
        names = ("move_s", "settle_s", "tracker_s", "camera_s", "confirm_s", "read_s", "write_s")
        by_part = {name: sum(getattr(shot.duration, name) for shot in self.shots) for name in names}
        return {**by_part, "drift_checks_s": self.drift_checks_s, "start_s": self.start_s}
