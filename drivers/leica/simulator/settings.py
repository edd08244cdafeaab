"""What a client can set, in SI, and what holds when the tracker starts.

The first values are no client's wish on purpose: one that relies on them, and not on its own
settings, measures in millimetres and gon, with the wrong reflector, through standard air.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import lru_cache
from typing import Final

from drivers.leica.simulator.codes import Mode
from drivers.leica.simulator.presentation import Presentation, rigid
from drivers.leica.simulator.refraction import adm_index, ifm_index
from drivers.leica.simulator.targets import FIRST_ACTIVE_REFLECTOR
from drivers.leica.simulator.units import Units
from tronlab.devices.readings import AirReading

STANDARD_AIR: Final = AirReading(temperature_k=293.15, pressure_pa=101_325.0, relative_humidity=0.5)
_FIRST_UNITS: Final = Units(length=1, angle=2, temperature=0, pressure=0, humidity=0)
_NO_STATION: Final = (0.0,) * 6
_NO_TRANSFORMATION: Final = (*_NO_STATION, 1.0)
MONITOR_OFF, MONITOR_READ, MONITOR_COMPUTE = 0, 1, 2
"""Weather monitor: off, reads the air, computes refraction from it too."""


@dataclass
class Settings:
    """Everything a client can set."""

    units: Units = _FIRST_UNITS
    coordinate_system: int = 0
    station: tuple[float, ...] = _NO_STATION
    """Three translations (m), three rotations (rad); likewise the next, which ends with a scale."""
    transformation: tuple[float, ...] = _NO_TRANSFORMATION
    environment: AirReading = STANDARD_AIR
    refraction: tuple[float, float] = (ifm_index(STANDARD_AIR), adm_index(STANDARD_AIR))
    """Indices for interferometer and absolute distance meter."""
    temperature_range: int = 1
    mode: Mode = Mode.STATIONARY
    stationary_ms: int = 2000
    stationary_uses_adm: bool = True
    separation_ms: int = 100
    separation_count: int = 0
    distance_m: float = 0.01
    distance_count: int = 0
    reflector_id: int = FIRST_ACTIVE_REFLECTOR
    search_radius_m: float = 0.05
    search_timeout_ms: int = 10_000
    adm_tolerance_m: float = 50e-6
    adm_window_ms: int = 1000
    adm_retries: int = 3
    statistics: tuple[int, int] = (0, 0)
    """Of stationary and continuous 3-D measurements: 0 standard, 1 extended."""
    camera_mode: int = 0
    weather_monitor: int = MONITOR_OFF
    apply_transformation: int = 0
    apply_station_orientation: int = 0
    keep_last_position: int = 0
    send_unsolicited: int = 1
    send_positions: int = 0
    try_mode: int = 0
    has_nivel: int = 1
    has_video_camera: int = 0
    show_all_probe_results: int = 0
    beam_capture: int = 1
    tip_rule: int = 1
    command_queue: int = 0
    packets_per_s: int = 3
    power_lock: int = 0
    power_lock_mode: int = 0
    thresholds: dict[int, float] = field(
        default_factory=lambda: {1000: 5.0, 1001: 10.0, 1002: 20.0}
    )
    """By parameter: changes of temperature, pressure and humidity worth an event."""

    def restore(self) -> None:
        """Go back to what holds at start."""
        fresh = Settings()
        for each in fields(self):
            setattr(self, each.name, getattr(fresh, each.name))

    @property
    def presentation(self) -> Presentation:
        """Get how results are given."""
        return _presentation(
            self.units,
            self.coordinate_system,
            self.station if self.apply_station_orientation else _NO_STATION,
            self.transformation if self.apply_transformation else _NO_TRANSFORMATION,
        )


@lru_cache(maxsize=4)
def _presentation(
    units: Units,
    coordinate_system: int,
    station: tuple[float, ...],
    transformation: tuple[float, ...],
) -> Presentation:
    return Presentation(
        units=units,
        coordinate_system=coordinate_system,
        user_from_trk=rigid(transformation).inv() * rigid(station),
        scale=transformation[6],
    )


@dataclass(frozen=True, slots=True)
class LongParameter:
    """A parameter of commands 120 and 121."""

    attribute: str
    """Of ``Settings``."""
    lowest: int
    highest: int


LONG_PARAMETERS: Final[Mapping[int, LongParameter]] = {
    0: LongParameter("keep_last_position", 0, 1),
    1: LongParameter("weather_monitor", 0, 2),
    2: LongParameter("show_all_probe_results", 0, 1),
    3: LongParameter("beam_capture", 0, 1),
    10: LongParameter("send_positions", 0, 1),
    52: LongParameter("tip_rule", 0, 2),
    200: LongParameter("command_queue", 0, 10),
    400: LongParameter("packets_per_s", 3, 10),
    411: LongParameter("power_lock", 0, 1),
    450: LongParameter("power_lock_mode", 0, 1),
}

MOST_POSES_PER_S: Final = 100
"""Of this simulation; a real T-MAC does more."""
MOST_POINTS_PER_S: Final = 1000
READ_ONLY_LONG_PARAMETERS: Final = {300: MOST_POSES_PER_S, 410: 0}

LONGEST_DISTANCE_M: Final = 18.0
"""Of the AT901-MR with a T-MAC; taken for reflectors too."""
SHORTEST_DISTANCE_M: Final = 0.1
LONGEST_DISTANCES: Final = (1100, 1101, 1102)
"""Double parameters: longest distance of interferometer, absolute distance meter and T-MAC."""
