"""What every step of a wizard works with: devices, laboratory, and how to measure."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TypeVar

from tronlab.calib.wizard.dialogue import Dialogue
from tronlab.devices.laboratory import LaboratorySpec
from tronlab.devices.mounting import Mounting
from tronlab.devices.registry import Devices
from tronlab.errors import (
    DeviceTimeoutError,
    IncompleteFrameError,
    NotReadyError,
    NotSettledError,
    TrackingLostError,
)

RETRYABLE = (
    TrackingLostError,
    NotSettledError,
    DeviceTimeoutError,
    NotReadyError,
    IncompleteFrameError,
)
"""What may go well when it is tried again."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Settings:
    """How a calibration measures."""

    window_s: float = 2.0
    """The tracker averages over this; trackers of this make gave outliers of 0.1 mm with less."""
    look_window_s: float = 0.5
    """The same of a look that only tells whether the T-MAC stands still."""
    n_reflector_readings: int = 8
    """Of each reflector: far from the model the frame's rotation is most of the truth's error."""
    n_stations: int = 20
    n_views: int = 20
    """Images, where the camera alone is calibrated."""
    n_tries: int = 3
    """Of a measurement that fails."""
    exposure_s: float = 0.005
    """Where the search for the exposure begins."""
    gain_db: float = 0.0
    pixel_format: str = "Mono8"
    move_timeout_s: float = 120.0
    grab_timeout_s: float = 10.0


def _utc_now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


@dataclass(frozen=True, slots=True)
class Bench:
    """A rig that is being calibrated."""

    devices: Devices
    """Connected, as far as the parts to be measured need them."""
    laboratory: LaboratorySpec
    """As designed; it says where to look."""
    dialogue: Dialogue
    mounting: Mounting
    """How to drive to a pose: as designed, or as calibrated before."""
    settings: Settings = Settings()
    utc_now: Callable[[], str] = _utc_now
    """Gives the date of what is measured now."""

    def persist(self, what: str, act: Callable[[], T]) -> T:
        """Do what may fail by chance, up to ``settings.n_tries`` times.

        Args:
            what: What is done, for the announcement of a failure.
            act: Does it.

        Raises:
            DeviceError: It failed every time, or in a way that will not pass.
        """
        for n_left in range(self.settings.n_tries - 1, 0, -1):
            try:
                return act()
            except RETRYABLE as error:
                self.dialogue.announce(f"{what}: {error}; tried again, {n_left} tries left")
        return act()
