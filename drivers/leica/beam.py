"""The head of a tracker and its beam: initialise, point, search, lock, measure."""

import time
from collections.abc import Collection, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

import numpy as np

from drivers.leica import codes
from drivers.leica import status as statuses
from drivers.leica.codes import Command, Event, Mode, Ready, TrackerStatus
from drivers.leica.controller import Controller
from drivers.leica.options import TrackerOptions
from drivers.leica.packets import Packet
from drivers.leica.replies import BirdbathCheck, Direction
from tronlab.errors import NotReadyError, TrackingLostError
from tronlab.geometry.poses import FloatArray

_POLL_S: Final = 0.05
_NO_REGION: Final = (0, 0)
_SEARCH_SHARE: Final = 0.5
"""Of the time for a move, how much the tracker may search: it must answer before we give up."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where to look for a target."""

    p_trk_m: FloatArray
    """Shape (3,), frame trk."""
    radius_m: float
    is_pointed_at: bool = False
    """The head points there already: search without moving it first."""
    direction: Direction | None = None
    """Where to point instead, if only that is known; ``p_trk_m`` is as far away then."""

    @property
    def distance_m(self) -> float:
        """Get how far away it is."""
        return float(np.linalg.norm(self.p_trk_m))

    def __str__(self) -> str:
        if self.direction is not None:
            return "where the beam was lost"
        if self.is_pointed_at:
            return "where the beam points"
        return f"within {self.radius_m:g} m of {np.round(self.p_trk_m, 3).tolist()} m"


@dataclass(frozen=True, slots=True)
class Measured:
    """A result and when it was measured."""

    packet: Packet
    time_s: float
    """Middle of the window, seconds since 1970 UTC."""


class Beam:
    """The beam of a tracker whose controller is set up."""

    def __init__(self, controller: Controller, options: TrackerOptions, *, device: str) -> None:
        self.is_lost = False
        """Whether an error said so since the last search; the next search clears it."""
        self._controller = controller
        self._connection = controller.connection
        self._options = options
        self._device = device
        self._is_found = False

    @property
    def is_on_target(self) -> bool:
        """Get whether the last search found something, and no error came since."""
        return self._is_found and not self.is_lost

    def reset(self) -> None:
        """Forget what was known of the tracker before it was connected."""
        self.is_lost = self._is_found = False

    def initialise(self) -> None:
        """Initialise the tracker: the head moves, and the distance is set at the home reflector."""
        self._controller.forget_mode()
        self._connection.exchange(Command.INITIALIZE, timeout_s=self._options.initialize_timeout_s)

    def ensure_initialised(self) -> bool:
        """Initialise a tracker that is not, if the options allow it.

        Returns:
            Whether it had to be: then the beam is elsewhere now.

        Raises:
            NotReadyError: It is not, and they do not.
        """
        status = self._controller.system_status()
        self._controller.check_state(status)
        if status.processor >= codes.INITIALISED:
            return False
        if self._options.initialize == "never":
            raise NotReadyError(
                f"{self._connection.call}: the tracker is not initialised; call initialize(), which"
                " moves its head, or set options.initialize to auto",
                device=self._device,
                code=statuses.NOT_INITIALISED,
            )
        self.initialise()
        return True

    def sees(self, needed: Ready) -> bool:
        """Look whether the beam is locked and everything needed to measure is there."""
        is_ready = self._controller.tracker_status() == TrackerStatus.READY
        return is_ready and not self.is_lost and needed in self._controller.ready()

    def has_invalid_pose(self) -> bool:
        """Look whether the beam is on a probe whose rotation is not determined."""
        return self._controller.tracker_status() == TrackerStatus.POSE_INVALID

    def acquire(self, place: Place, *, needed: Ready) -> None:
        """Point the beam and search; when this returns it is locked and all needed is there.

        Raises:
            TrackingLostError: Nothing is there.
            NotReadyError: The tracker stays busy.
            DeviceFaultError: The search failed with a number of the tracker's own.
        """
        self._is_found = False
        search_ms = round(self._options.move_timeout_s * _SEARCH_SHARE * 1e3)
        self._connection.exchange(Command.SET_SEARCH_PARAMETERS, place.radius_m, search_ms)
        if not place.is_pointed_at:
            self._point(place)
            self._wait_while_busy()
        self.is_lost = False
        self._search(place)
        self._is_found = True
        self.await_lock(place, needed=needed)

    def await_lock(self, place: Place, *, needed: Ready) -> None:
        """Wait until the beam is locked and all needed is there; nothing moves.

        Raises:
            TrackingLostError: It does not come to that within ``lock_timeout_s``.
            NotReadyError: The tracker stays busy.
        """
        give_up_s = time.monotonic() + self._options.lock_timeout_s
        while not self.sees(needed):
            self._wait_while_busy()
            if self.is_lost or time.monotonic() > give_up_s:
                raise TrackingLostError(
                    f"{self._connection.call}: {self._problem()} {place}", device=self._device
                )
            self._connection.wait(_POLL_S)

    def change_face(self) -> None:
        """Turn the head over; it points at the same place in the other face."""
        self._move(Command.CHANGE_FACE)
        self._wait_while_busy()

    def check_birdbath(self) -> BirdbathCheck:
        """Measure the home reflector."""
        timeout_s = self._options.move_timeout_s
        return self._connection.ask(BirdbathCheck, Command.CHECK_BIRDBATH, timeout_s=timeout_s)

    def _point(self, place: Place) -> None:
        if place.direction is None:
            self._move(Command.POINT_LASER, *place.p_trk_m)
        else:
            angles_rad = place.direction.hz_rad, place.direction.vt_rad
            self._move(Command.POINT_LASER_HVD, *angles_rad, place.distance_m)

    def _search(self, place: Place) -> None:
        call = self._connection.call
        try:
            self._move(Command.FIND_REFLECTOR, place.distance_m)
        except TrackingLostError as error:
            reason = str(error).removeprefix(f"{self._device}: {call}: ")
            raise TrackingLostError(
                f"{call}: nothing found {place}: {reason}", device=self._device
            ) from error

    def _move(self, command: Command, *values: float) -> None:
        self._connection.exchange(command, *values, timeout_s=self._options.move_timeout_s)

    def _problem(self) -> str:
        if self.is_lost:
            return "the beam is broken"
        if self.has_invalid_pose():
            return "the 6-D values are not valid"
        return "the tracker does not get ready to measure"

    def _wait_while_busy(self) -> None:
        give_up_s = time.monotonic() + self._options.move_timeout_s
        while self._controller.tracker_status() == TrackerStatus.BUSY:
            if time.monotonic() > give_up_s:
                raise statuses.error_of(statuses.BUSY, self._connection.call, device=self._device)
            self._connection.wait(_POLL_S)

    # --- Measuring ---

    def measure(self, *, window_s: float, fatal_events: Collection[Event] = ()) -> Measured:
        """Measure what the mode says, averaging over a window.

        Raises:
            TrackingLostError: The beam broke, or one of ``fatal_events`` came.
            DeviceError: Another error of the tracker, or no result.
        """
        use_adm = 1
        self._connection.exchange(Command.SET_STATIONARY_PARAMETERS, round(window_s * 1e3), use_adm)
        begun_s = time.time()
        with self._noting_losses():
            self._start(window_s=window_s)
            packet = self._connection.result(
                timeout_s=window_s + self._options.timeout_s, fatal_events=fatal_events
            )
        return Measured(packet, time_s=(begun_s + time.time()) / 2.0)

    def start_stream(self, *, interval_s: float, n: int) -> None:
        """Begin to measure poses again and again; ``n`` of 0 is without end."""
        self._controller.set_mode(Mode.POSE_STREAM)
        self._connection.exchange(
            Command.SET_CONTINUOUS_TIME_PARAMETERS, round(interval_s * 1e3), n, *_NO_REGION
        )
        with self._noting_losses():
            self._start(window_s=0.0)

    def next_of_stream(self, *, timeout_s: float) -> Packet:
        """Wait for the next packet of the stream."""
        with self._noting_losses():
            return self._connection.result(timeout_s=timeout_s)

    def stop(self) -> None:
        """Stop whatever is being measured."""
        self._connection.exchange(Command.STOP_MEASUREMENT)

    def _start(self, *, window_s: float) -> None:
        self._connection.begin_measurement()
        self._connection.exchange(
            Command.START_MEASUREMENT, timeout_s=window_s + self._options.timeout_s
        )

    @contextmanager
    def _noting_losses(self) -> Generator[None]:
        """Remember that the beam was lost, so that the next call searches."""
        try:
            yield
        except TrackingLostError:
            self.is_lost = True
            raise
