"""Scripted faults: a device fails, or something happens, at the call the rig file names."""

from collections import Counter
from collections.abc import Mapping
from typing import Any, Protocol

from tronlab.devices.laboratory import Vector
from tronlab.errors import (
    DeviceError,
    DeviceFaultError,
    DeviceTimeoutError,
    IncompleteFrameError,
    NotConnectedError,
    NotReadyError,
    SafetyError,
    TrackingLostError,
)
from tronlab.twin.config import ErrorKind, FaultSpec

FAULT_CODE = 900
"""Number of every scripted device fault."""

_ERRORS: Mapping[ErrorKind, tuple[type[DeviceError], str]] = {
    "tracking_lost": (TrackingLostError, "the beam is broken"),
    "timeout": (DeviceTimeoutError, "no answer"),
    "lost": (NotConnectedError, "the connection is lost"),
    "fault": (DeviceFaultError, "the device reports a fault"),
    "not_ready": (NotReadyError, "the device is busy"),
    "unsafe": (SafetyError, "an emergency stop is pressed"),
    "incomplete_frame": (IncompleteFrameError, "parts of the image are missing"),
}


class Happenings(Protocol):
    """What can happen to a laboratory."""

    def move_tracker(self, shift_m: Vector) -> None:
        """Push the tracker; in trs."""
        ...

    def open_door(self, *, is_open: bool) -> None:
        """Open the door, or close it."""
        ...

    def dim_lamp(self, level: float) -> None:
        """Let the lamp give this part of its full light."""
        ...


class FaultScript:
    """Counts the calls of every device and strikes when one's turn has come."""

    def __init__(self, faults: tuple[FaultSpec, ...], *, laboratory: Happenings) -> None:
        self._faults = faults
        self._laboratory = laboratory
        self._calls: Counter[tuple[str, str]] = Counter()

    def count(self, device: str, call: str, *, name: str) -> None:
        """Count one call of a kind of device; ``name`` is what the error calls the device.

        Raises:
            DeviceError: The script says so, and which.
        """
        self._calls[device, call] += 1
        n = self._calls[device, call]
        for fault in self._faults:
            if (fault.device, fault.call) != (device, call):
                continue
            if fault.error in _ERRORS:
                if _is_struck(fault, n):
                    raise _error(fault, f"{call}: %s (scripted, call {n})", name)
            else:
                self._happen(fault, n)

    def _happen(self, fault: FaultSpec, n: int) -> None:
        """Let something begin or end at the n-th call."""
        is_begun, is_ended = n == fault.at, n == fault.at + fault.times
        if fault.error == "moved" and _is_struck(fault, n):
            self._laboratory.move_tracker(fault.moved_m)
        elif fault.error == "door_open" and (is_begun or is_ended):
            self._laboratory.open_door(is_open=is_begun)
        elif fault.lamp_level is not None and (is_begun or is_ended):
            self._laboratory.dim_lamp(fault.lamp_level if is_begun else 1.0)


def _is_struck(fault: FaultSpec, n: int) -> bool:
    return fault.at <= n < fault.at + fault.times


def _error(fault: FaultSpec, message: str, name: str) -> DeviceError:
    kind, what = _ERRORS[fault.error]
    code: dict[str, Any] = {"code": FAULT_CODE} if issubclass(kind, DeviceFaultError) else {}
    return kind(message % what, device=name, **code)
