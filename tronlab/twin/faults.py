"""Scripted faults: a device fails at the call the rig file names."""

from collections import Counter
from collections.abc import Callable

from tronlab.devices.laboratory import Vector
from tronlab.errors import DeviceFaultError, DeviceTimeoutError, TrackingLostError
from tronlab.twin.config import FaultSpec

FAULT_CODE = 900
"""Number of every scripted device fault."""


class FaultScript:
    """Counts the calls of every device and strikes when one's turn has come."""

    def __init__(
        self, faults: tuple[FaultSpec, ...], *, move_tracker: Callable[[Vector], None]
    ) -> None:
        self._faults = faults
        self._move_tracker = move_tracker
        self._calls: Counter[tuple[str, str]] = Counter()

    def count(self, device: str, call: str, *, name: str) -> None:
        """Count one call of a kind of device; ``name`` is what the error calls the device.

        Raises:
            TrackingLostError: The script says so; likewise the two below.
            DeviceTimeoutError: The device does not answer.
            DeviceFaultError: The device reports a fault.
        """
        self._calls[device, call] += 1
        n = self._calls[device, call]
        for fault in self._faults:
            is_meant = (fault.device, fault.call) == (device, call)
            if not is_meant or not fault.at <= n < fault.at + fault.times:
                continue
            if fault.error == "moved":
                self._move_tracker(fault.moved_m)
            else:
                _strike(fault, f"{call}: %s (scripted, call {n})", name)


def _strike(fault: FaultSpec, message: str, name: str) -> None:
    if fault.error == "tracking_lost":
        raise TrackingLostError(message % "the beam is broken", device=name)
    if fault.error == "timeout":
        raise DeviceTimeoutError(message % "no answer", device=name)
    raise DeviceFaultError(message % "the device reports a fault", device=name, code=FAULT_CODE)
