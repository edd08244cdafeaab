"""Status numbers of a tracker: what they mean, and which error each becomes.

Numbers below 10100 are emScon's own (emScon 3.6 header). The tracker adds numbers of its own that
no public list has; 701 is a broken beam. One that is not known here is carried through as it is.
"""

from typing import Final

from tronlab.errors import (
    AccessDeniedError,
    DeviceError,
    DeviceFaultError,
    LimitError,
    NotReadyError,
    TrackingLostError,
)

OK: Final = 0
BUSY: Final = 1
WRONG_REFLECTOR: Final = 23
NO_WEATHER_STATION: Final = 27
NOT_INITIALISED: Final = 39
NO_MEASUREMENT_CAMERA: Final = 67
NO_ACTIVE_PROBE: Final = 76
NO_PROBE_COMPENSATION: Final = 78
REFUSED_CONNECTION: Final = 10011
NOT_WARMED_UP: Final = 10012
BEAM_BROKEN: Final = 701

_ADJUSTED: Final = range(11, 22, 2)
"""Parameter out of range, and the controller took another value instead."""
_OUT_OF_RANGE: Final = range(12, 23, 2)

_MEANINGS: Final = {
    BUSY: "busy with another command",
    2: "command not implemented",
    3: "wrong parameter",
    **{number: f"parameter {number - 3} is wrong" for number in range(4, 11)},
    **{number: f"parameter {(number - 9) // 2} adjusted to its range" for number in _ADJUSTED},
    **{number: f"parameter {(number - 10) // 2} is out of range" for number in _OUT_OF_RANGE},
    WRONG_REFLECTOR: "wrong reflector",
    26: "no tracker processor found",
    NO_WEATHER_STATION: "no weather station found",
    28: "no point was measured before",
    30: "no absolute distance meter",
    34: "licence expired",
    35: "not allowed in this state",
    36: "unknown error",
    37: "the beam is locked, but its distance is not known",
    38: "no tracker connected to the controller",
    NOT_INITIALISED: "not initialised",
    46: "under control of another program",
    **{number: f"parameter {number - 39} is wrong" for number in range(47, 56)},
    56: "no such compensation",
    57: "air out of range",
    NO_MEASUREMENT_CAMERA: "no measurement camera",
    68: "no active measurement camera",
    70: "no camera-to-tracker compensation set",
    74: "no communication with the measurement camera",
    75: "probe missing: no probe",
    NO_ACTIVE_PROBE: "probe missing: no active probe",
    77: "probe missing: none in the data base",
    NO_PROBE_COMPENSATION: "no probe compensation set",
    79: "no probe compensation in the data base",
    82: "no communication with the probe",
    83: "no tip",
    84: "no active tip",
    85: "no tips in the data base",
    86: "no tip compensation in the data base",
    87: "no tip compensation set",
    92: "6-D mode not allowed",
    93: "the 6-D result is bad",
    94: "no temperature from the weather station",
    95: "no pressure from the weather station",
    96: "no humidity from the weather station",
    97: "6-D not allowed in face 2",
    98: "invalid input",
    BEAM_BROKEN: "the beam is broken",
    10001: "no shank compensation set",
    10002: "no compensation of the absolute distance meter",
    10004: "not ready to measure",
    10005: "the absolute distance meter is starting",
    10009: "no stationary result",
    10010: "not levelled",
    REFUSED_CONNECTION: "another client holds the tracker",
    NOT_WARMED_UP: "not warmed up",
    10013: "not stable",
    10014: "system not ready",
    10015: "no communication with the sensor",
    10020: "hardware problem of the absolute distance meter",
    10021: "hardware problem of the target recognition",
}

_NOT_YET: Final = frozenset(
    {BUSY, NOT_INITIALISED, 46, 10004, 10005, 10009, NOT_WARMED_UP, 10013, 10014}
)
_TARGET_LOST: Final = frozenset({37, 93, BEAM_BROKEN})


def meaning_of(status: int) -> str:
    """Say in plain words what a status means."""
    return _MEANINGS.get(status, "a status this driver does not know; see the maker's manual")


def error_of(status: int, call: str, *, device: str) -> DeviceError:
    """Make the error that a status other than 0 stands for.

    Args:
        status: The number.
        call: What was asked; the message begins with it.
        device: Name of the device.
    """
    message = f"{call}: {meaning_of(status)}"
    if status in _NOT_YET:
        return NotReadyError(message, device=device, code=status)
    if status in _TARGET_LOST:
        return TrackingLostError(f"{message} (code {status})", device=device)
    if status in _ADJUSTED or status in _OUT_OF_RANGE:
        return LimitError(f"{message} (code {status})", device=device)
    if status == REFUSED_CONNECTION:
        return AccessDeniedError(
            f"{message} (code {status}); close the other program", device=device
        )
    return DeviceFaultError(message, device=device, code=status)
