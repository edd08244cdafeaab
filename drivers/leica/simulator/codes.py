"""Numbers of the emScon TPI that the simulated tracker uses (emScon 3.6 header)."""

from enum import IntEnum, IntFlag


class DataType(IntEnum):
    """What a packet is: the second number of its header."""

    COMMAND = 0
    ERROR = 1
    SINGLE = 2
    MULTI = 3
    PROBE_STATIONARY = 4
    PROBE_CONTINUOUS = 5
    NIVEL = 6
    REFLECTOR_POSITION = 7
    EVENT = 8
    SINGLE_EXTENDED = 9
    MULTI_EXTENDED = 10
    PROBE_POSITION = 11


class Command(IntEnum):
    """Commands the simulated tracker knows; it answers all others with NOT_IMPLEMENTED."""

    EXIT_APPLICATION = 0
    GET_SYSTEM_STATUS = 1
    GET_TRACKER_STATUS = 2
    SET_TEMPERATURE_RANGE = 3
    GET_TEMPERATURE_RANGE = 4
    SET_UNITS = 5
    GET_UNITS = 6
    INITIALIZE = 7
    RELEASE_MOTORS = 8
    PARK = 10
    SWITCH_LASER = 11
    SET_STATION_ORIENTATION = 12
    GET_STATION_ORIENTATION = 13
    SET_TRANSFORMATION = 14
    GET_TRANSFORMATION = 15
    SET_ENVIRONMENT = 20
    GET_ENVIRONMENT = 21
    SET_REFRACTION = 22
    GET_REFRACTION = 23
    SET_MEASUREMENT_MODE = 24
    GET_MEASUREMENT_MODE = 25
    SET_COORDINATE_SYSTEM = 26
    GET_COORDINATE_SYSTEM = 27
    SET_STATIONARY_MODE = 28
    GET_STATIONARY_MODE = 29
    SET_CONTINUOUS_TIME_MODE = 30
    GET_CONTINUOUS_TIME_MODE = 31
    SET_CONTINUOUS_DISTANCE_MODE = 32
    GET_CONTINUOUS_DISTANCE_MODE = 33
    SET_REFLECTOR = 40
    GET_REFLECTOR = 41
    GET_REFLECTORS = 42
    SET_SEARCH = 43
    GET_SEARCH = 44
    SET_ADM = 45
    GET_ADM = 46
    SET_SYSTEM_SETTINGS = 47
    GET_SYSTEM_SETTINGS = 48
    START_MEASUREMENT = 49
    START_NIVEL_MEASUREMENT = 51
    STOP_MEASUREMENT = 52
    CHANGE_FACE = 53
    GO_BIRD_BATH = 54
    GO_POSITION = 55
    GO_POSITION_HVD = 56
    POSITION_RELATIVE_HV = 57
    POINT_LASER = 58
    POINT_LASER_HVD = 59
    GO_LAST_MEASURED_POINT = 62
    FIND_REFLECTOR = 63
    UNKNOWN = 64
    LOOK_FOR_TARGET = 65
    GET_DIRECTION = 66
    SET_COMPENSATION = 79
    SET_STATISTIC_MODE = 80
    GET_STATISTIC_MODE = 81
    GET_COMPENSATION = 85
    GET_COMPENSATIONS = 86
    CHECK_BIRD_BATH = 87
    GET_TP_INFO = 90
    GO_BIRD_BATH_2 = 95
    GET_FACE = 98
    SET_CAMERA_MODE = 101
    GET_CAMERA_MODE = 102
    GET_PROBES = 103
    GET_PROBE = 104
    GET_TIP_ADAPTERS = 105
    GET_TIP_ADAPTER = 106
    GET_CAMERA_COMPENSATION = 108
    SET_CAMERA_COMPENSATION = 109
    GET_PROBE_COMPENSATIONS = 110
    GET_PROBE_COMPENSATION = 111
    SET_PROBE_COMPENSATION = 112
    GET_PROBE_INFO = 119
    SET_LONG_PARAMETER = 120
    GET_LONG_PARAMETER = 121
    GET_MEASUREMENT_STATUS_INFO = 122
    GET_COMPENSATIONS_2 = 123
    GET_PRISM_POSITION = 124
    SET_DOUBLE_PARAMETER = 125
    GET_DOUBLE_PARAMETER = 126
    CLEAR_COMMAND_QUEUE = 130
    GET_TRACKER_INFO = 132
    RESTORE_STARTUP_CONDITIONS = 134
    GO_AND_MEASURE = 135
    GET_METEO_STATION_INFO = 139
    GET_SOFTWARE_VERSION = 142


class Status(IntEnum):
    """How a command ended."""

    OK = 0
    BUSY = 1
    NOT_IMPLEMENTED = 2
    WRONG_PARAMETER = 3
    """Parameter n has 3 + n."""
    OUT_OF_RANGE_1 = 12
    """Parameter n has 10 + 2 n; the odd numbers mean that the value was adjusted."""
    WRONG_REFLECTOR = 23
    NO_LAST_POINT = 28
    NO_NIVEL = 31
    USAGE_CONFLICT = 35
    NO_DISTANCE = 37
    NOT_INITIALISED = 39
    NO_SUCH_COMPENSATION = 56
    METEO_OUT_OF_RANGE = 57
    NO_PROBE = 75
    NO_TIP = 83
    BAD_PROBE_RESULT = 93
    NO_PROBE_IN_FACE_2 = 97
    INVALID_INPUT = 98
    BEAM_BROKEN = 701
    """Number of the tracker itself, beyond the header's list."""
    NOT_READY = 10004
    NO_STATIONARY_RESULT = 10009
    ONE_CONNECTION_ONLY = 10011
    WARMING_UP = 10012
    SYSTEM_NOT_READY = 10014
    UNHEARD_OF = 31999
    """In nobody's list: what a client does with a number it does not know."""


class Event(IntEnum):
    """What changed."""

    DISTANCE_SET = 0
    LASER_WARMED_UP = 1
    ENVIRONMENT = 2
    REFRACTION = 3
    SEARCH = 4
    ADM = 5
    UNITS = 6
    REFLECTOR = 7
    SETTINGS = 8
    TEMPERATURE_RANGE = 9
    COMPENSATION = 11
    COORDINATE_SYSTEM = 12
    STATION_ORIENTATION = 15
    TRANSFORMATION = 16
    MEASUREMENT_MODE = 17
    STATIONARY_MODE = 18
    CONTINUOUS_TIME_MODE = 19
    CONTINUOUS_DISTANCE_MODE = 20
    STATISTIC_MODE = 24
    NOT_READY = 25
    BUSY = 26
    READY = 27
    COUNT_REACHED = 28
    FACE_1 = 30
    FACE_2 = 31
    CAMERA = 34
    PROBE = 36
    PROBE_COMPENSATION = 39
    PROBE_INVALID = 99
    CONNECTION_CLOSING = 997


class Mode(IntEnum):
    """Measurement modes the simulated tracker has."""

    STATIONARY = 0
    CONTINUOUS_TIME = 1
    CONTINUOUS_DISTANCE = 2
    PROBE_STATIONARY = 6
    PROBE_CONTINUOUS_TIME = 7
    PROBE_CONTINUOUS_DISTANCE = 8

    @property
    def is_probe(self) -> bool:
        """Look whether the mode measures a T-MAC."""
        return self >= Mode.PROBE_STATIONARY

    @property
    def is_continuous(self) -> bool:
        """Look whether the mode gives many results."""
        return self not in (Mode.STATIONARY, Mode.PROBE_STATIONARY)


class TrackerStatus(IntEnum):
    """Whether the tracker could measure now."""

    NOT_READY = 0
    BUSY = 1
    READY = 2
    PROBE_INVALID = 3


class MeasurementStatus(IntFlag):
    """What the tracker has found, and what is calibrated (command 122)."""

    TRACKER = 1
    TRACKER_COMPENSATION = 2
    ADM = 4
    ADM_COMPENSATION = 8
    CAMERA = 16
    CAMERA_PARAMETERS = 32
    CAMERA_TO_TRACKER = 64
    PROBE = 128
    PROBE_PARAMETERS = 256
    REFLECTOR = 2048
    FACE_1 = 4096
    NIVEL_IN_RANGE = 32768
    INITIALISED = 65536


class RotationStatus(IntFlag):
    """What a T-MAC measurement says of its own rotation."""

    PRESENT = 1
    ERROR = 2
    NOT_ENOUGH_LEDS = 4
    RESIDUAL_TOO_HIGH = 8
    GOOD_GAUGE = 3 << 14
    FACE_2 = 1 << 16
