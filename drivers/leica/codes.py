"""Numbers of the emScon programming interface that this driver uses (emScon 3.6 header)."""

from enum import IntEnum, IntFlag
from typing import Final


class PacketType(IntEnum):
    """What a packet is."""

    COMMAND = 0
    ERROR = 1
    POINT = 2
    EVENT = 8
    POINT_EXTENDED = 9
    POSE = 4
    POSE_STREAM = 5


class Command(IntEnum):
    """What a tracker can be told."""

    GET_SYSTEM_STATUS = 1
    GET_TRACKER_STATUS = 2
    SET_UNITS = 5
    INITIALIZE = 7
    SET_STATION_ORIENTATION = 12
    SET_TRANSFORMATION = 14
    SET_ENVIRONMENT = 20
    GET_ENVIRONMENT = 21
    SET_MEASUREMENT_MODE = 24
    SET_COORDINATE_SYSTEM_TYPE = 26
    SET_STATIONARY_PARAMETERS = 28
    SET_CONTINUOUS_TIME_PARAMETERS = 30
    SET_REFLECTOR = 40
    GET_REFLECTOR = 41
    GET_REFLECTORS = 42
    SET_SEARCH_PARAMETERS = 43
    SET_SYSTEM_SETTINGS = 47
    GET_SYSTEM_SETTINGS = 48
    START_MEASUREMENT = 49
    STOP_MEASUREMENT = 52
    CHANGE_FACE = 53
    POINT_LASER = 58
    POINT_LASER_HVD = 59
    FIND_REFLECTOR = 63
    GET_DIRECTION = 66
    SET_STATISTIC_MODE = 80
    CHECK_BIRDBATH = 87
    GET_FACE = 98
    GET_PROBES = 103
    GET_MEASUREMENT_PROBE_INFO = 119
    SET_LONG_PARAMETER = 120
    GET_MEASUREMENT_STATUS_INFO = 122
    GET_TRACKER_INFO = 132
    GET_METEO_STATION_INFO = 139

    @property
    def title(self) -> str:
        """Get the name as people write it: ``PointLaser``."""
        return self.name.title().replace("_", "")


class Mode(IntEnum):
    """What a measurement measures."""

    POINT = 0
    POSE = 6
    POSE_STREAM = 7


class TrackerStatus(IntEnum):
    """Whether a measurement could start."""

    NOT_READY = 0
    BUSY = 1
    READY = 2
    POSE_INVALID = 3


class LaserStatus(IntEnum):
    """State of the laser."""

    COMMUNICATION_FAILED = 0
    NOT_AVAILABLE = 1
    HEATING = 2
    READY = 3
    CANNOT_STABILISE = 4
    OFF = 5


class WeatherMonitor(IntEnum):
    """Who measures the air."""

    OFF = 0
    READ_AND_CORRECT = 2


class Event(IntEnum):
    """What a tracker says by itself; those that drivers and people care for."""

    DISTANCE_SET = 0
    LASER_WARMED_UP = 1
    ENVIRONMENT_CHANGED = 2
    REFRACTION_CHANGED = 3
    REFLECTOR_CHANGED = 7
    SETTINGS_CHANGED = 8
    MODE_CHANGED = 17
    NOT_READY = 25
    BUSY = 26
    READY = 27
    COUNT_REACHED = 28
    FACE_1 = 30
    FACE_2 = 31
    EXTERNAL_CONTROL = 32
    MEASUREMENT_CAMERA_CHANGED = 34
    PROBE_CHANGED = 36
    POSE_INVALID = 99
    LASER_NEAR_LIMIT = 145
    LASER_NOT_STABILISED = 146
    CONNECTION_CLOSING = 997
    SERVER_CLOSING = 998
    SERVER_STARTED = 999


class Ready(IntFlag):
    """What of a measurement is there (mask of GetMeasurementStatusInfo)."""

    TRACKER = 1
    MEASUREMENT_CAMERA = 16
    CAMERA_PARAMETERS = 32
    CAMERA_TO_TRACKER = 64
    PROBE_FOUND = 128
    PROBE_PARAMETERS = 256
    REFLECTOR_FOUND = 2048
    FACE_1 = 4096
    INITIALISED = 65536


INITIALISED: Final = 5
"""State of the tracker processor once initialised; lower ones lead there."""
BOOTED: Final = 3
"""State of the tracker processor from which it can be initialised."""
UNKNOWN_COMMAND: Final = 64
"""In the place of the command in an error that answers none."""
TMAC_PROBE_TYPES: Final = frozenset({4, 5, 8})
"""Machine-control probes; 8 is the TMC30E of newer controllers."""
NO_METEO_STATION: Final = 0
EXTENDED_STATISTICS: Final = 1
STANDARD_STATISTICS: Final = 0
TIP_RULE_PARAMETER: Final = 52
NO_TIP_ALLOWED: Final = 1
"""Value of the tip rule: a T-MAC has no tip."""

_ROTATION_PROBLEMS: Final = {
    1: "error",
    2: "too few LEDs seen",
    3: "residual too high",
    4: "angle out of range",
    5: "values frozen",
    6: "distance out of range",
}


def rotation_problem(status: int) -> str | None:
    """Say what is wrong with a rotation by its status bits; None if it can be used."""
    problems = [text for bit, text in _ROTATION_PROBLEMS.items() if status >> bit & 1]
    if problems:
        return ", ".join(problems)
    return None if status & 1 else "no 6-D status"


def laser_text(number: int) -> str:
    """Give the plain state of the laser; an unknown one by its number."""
    try:
        return LaserStatus(number).name.lower().replace("_", " ")
    except ValueError:
        return f"state {number}"


def event_text(number: int) -> str:
    """Give the plain name of an event; an unknown one by its number."""
    try:
        return Event(number).name.lower().replace("_", " ")
    except ValueError:
        return f"event {number}"
