"""How the tracker is today: state, two faces and home reflector, as numbers to judge by."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from drivers.leica.codes import INITIALISED, LaserStatus, Ready, TrackerStatus
from drivers.leica.replies import BirdbathCheck, SystemStatus
from tronlab.devices.readings import PointReading

TWO_FACE_M: Final = 30e-6
TWO_FACE_M_PER_M: Final = 12e-6
"""Largest difference of the two faces, and its growth with distance (Leica AT500 manual)."""


@dataclass(frozen=True, slots=True)
class TrackerState:
    """How the tracker is, as it says itself; numbers as in the emScon header."""

    system: SystemStatus
    tracker: int
    """0 not ready, 1 busy, 2 ready, 3 6-D not valid."""
    face: int
    """0 if it does not know."""
    ready: Ready
    """What of a measurement is there."""

    @property
    def is_initialised(self) -> bool:
        """Get whether the tracker has been initialised since it was switched on."""
        return self.system.processor == INITIALISED

    def in_words(self) -> dict[str, str]:
        """Give it as a person reads it, by quantity; unknown numbers stay numbers."""
        return {
            "tracker": _title(TrackerStatus, self.tracker),
            "laser": _title(LaserStatus, self.system.laser),
            "initialised": "yes" if self.is_initialised else "no",
            "face": str(self.face) if self.face else "not known",
            "T-MAC": "seen" if Ready.PROBE_FOUND in self.ready else "not seen",
        }


def _title(names: type[IntEnum], number: int) -> str:
    try:
        return names(number).name.lower().replace("_", " ")
    except ValueError:
        return f"unknown state {number}"


@dataclass(frozen=True, slots=True)
class TwoFaceCheck:
    """One reflector measured in both faces."""

    target: str
    face_1: PointReading
    face_2: PointReading

    @property
    def distance_m(self) -> float:
        """Get how far the reflector is."""
        return float(np.linalg.norm(self.face_1.p_trk_m + self.face_2.p_trk_m)) / 2.0

    @property
    def difference_m(self) -> float:
        """Get how far the two lie apart across the beam; the distance has no faces."""
        a, b = self.face_1.p_trk_m, self.face_2.p_trk_m
        angle_rad = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
        return float(angle_rad) * self.distance_m

    @property
    def allowed_m(self) -> float:
        """Get how far they may."""
        return TWO_FACE_M + TWO_FACE_M_PER_M * self.distance_m

    @property
    def is_good(self) -> bool:
        """Get whether the tracker needs no field check."""
        return self.difference_m <= self.allowed_m


@dataclass(frozen=True, slots=True)
class BirdbathDrift:
    """How the home reflector differs from when the tracker was initialised."""

    hz_rad: float
    vt_rad: float
    distance_m: float

    @classmethod
    def of(cls, check: BirdbathCheck) -> "BirdbathDrift":
        """Make it of the tracker's answer."""
        return cls(*check.difference_hvd)
