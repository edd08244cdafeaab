"""What the tracker's data base lists: reflectors and the T-MAC.

Names are as real data bases spell them; ids and distance constants differ from one instrument to
the next, so these are inventions. Ids are no sequence, and the reflector active at start is not
the one that is usual.
"""

from dataclasses import dataclass
from typing import Final, Literal


@dataclass(frozen=True, slots=True)
class ReflectorType:
    """A kind of reflector the tracker knows."""

    id: int
    name: str
    target_type: int
    """By the header: 3 glass prism, 5 red ring 1.5", 6 red ring 0.5", 9 tooling ball 0.5"."""
    surface_offset_m: float
    distance_constant_m: float
    """What its optics add to the distance; the tracker takes off that of the active type."""


MOUNTED: Final = ReflectorType(7, "CCR-1.5in", 5, 0.01905, 0.0)
"""What every reflector of the scene is."""

REFLECTORS: Final = {
    reflector.id: reflector
    for reflector in (
        ReflectorType(2, "CCR-0.5in", 6, 0.00635, -0.000_150),
        MOUNTED,
        ReflectorType(11, "TBR-0.5in", 9, 0.00635, 0.000_240),
        ReflectorType(4, "GP-1.5in", 3, 0.01905, 0.009_580),
    )
}
"""All kinds by id, in the order they are listed."""

FIRST_ACTIVE_REFLECTOR: Final = 2

PROBE_ID: Final = 3
PROBE_NAME: Final = "T-MAC"
PROBE_TYPE: Final = 5
"""Machine-control probe with several sides; that this is a T-MAC is inferred, not stated."""
N_PROBE_FIELDS: Final = 4
PROBE_COMPENSATION_ID: Final = 21
CAMERA_COMPENSATION_ID: Final = 14
TRACKER_COMPENSATION_ID: Final = 5


@dataclass(frozen=True, slots=True)
class Target:
    """What the beam can lock to."""

    kind: Literal["reflector", "tmac", "home"]
    name: str


TMAC: Final = Target("tmac", PROBE_NAME)
HOME: Final = Target("home", "bird bath")
