"""Where the targets are, and how the beam gets there."""

from contextlib import suppress
from dataclasses import replace
from typing import NoReturn

import numpy as np

from drivers.leica import status as statuses
from drivers.leica.beam import Beam, Place
from drivers.leica.codes import Mode, Ready
from drivers.leica.controller import Controller
from drivers.leica.options import ReflectorOption, TrackerOptions
from drivers.leica.replies import Direction
from tronlab.errors import (
    DeviceError,
    DeviceFaultError,
    LimitError,
    NotReadyError,
    TrackingLostError,
)
from tronlab.geometry.poses import FloatArray


class Aim:
    """Points the beam at reflectors and the T-MAC, and remembers where they were measured.

    What it remembers outlives a lost connection: the targets do too.
    """

    def __init__(
        self, controller: Controller, beam: Beam, options: TrackerOptions, *, device: str
    ) -> None:
        self._controller = controller
        self._connection = controller.connection
        self._beam = beam
        self._options = options
        self._device = device
        self._p_reflectors_trk: dict[str, FloatArray] = {}
        self._p_tmac_trk: FloatArray | None = None
        """None until it was found once."""
        self._is_on_tmac = False
        self._lost_towards: Direction | None = None
        """Where the head pointed when it lost the T-MAC; None once it was found again."""
        self._found_towards: Direction | None = None
        """Where the head pointed when the beam was on the T-MAC from an earlier session; None once
        it was measured in this one."""

    def reset(self) -> None:
        """Forget what the beam was on: the head has moved, or the connection is a new one."""
        self._is_on_tmac = False

    def _ensure_initialised(self) -> None:
        if self._beam.ensure_initialised():
            self.reset()

    # --- T-MAC ---

    def at_tmac(self) -> None:
        """Have the beam on the T-MAC; where it is already, nothing moves.

        Raises:
            TrackingLostError: The T-MAC is in none of the likely places.
            DeviceFaultError: What is there is no T-MAC; or the tracker's own.
        """
        self._ensure_initialised()
        self._controller.set_mode(Mode.POSE)
        if not self._beam.sees(Ready.PROBE_FOUND):
            self._lock_on_tmac()
        elif self._p_tmac_trk is None:
            with suppress(DeviceFaultError):  # a controller that does not tell
                self._found_towards = self._controller.direction()
        if not self._is_on_tmac:
            self._controller.probe_info()
        self._is_on_tmac = True
        self._lost_towards = None
        if self._p_tmac_trk is None:
            self._p_tmac_trk = np.array(self._options.tmac.p_trk_m)

    def give_back(self) -> None:
        """Point at the T-MAC again, if it was ever found.

        A T-MAC that is not there does not spoil what was measured; the next who needs it will see.
        """
        if self._p_tmac_trk is not None:
            with suppress(TrackingLostError, DeviceFaultError):
                self.at_tmac()

    def tmac_is_at(self, p_trk_m: FloatArray) -> None:
        """Remember where the T-MAC was measured."""
        self._p_tmac_trk = p_trk_m
        self._found_towards = None

    def _lock_on_tmac(self) -> None:
        if self._beam.has_invalid_pose() and not self._beam.is_lost:
            # The beam is where it should be: moving it helps nobody.
            return self._beam.await_lock(self._here(), needed=Ready.PROBE_FOUND)
        if self._is_on_tmac:
            with suppress(DeviceFaultError):  # a controller that does not tell
                self._lost_towards = self._controller.direction()
        failures: list[DeviceError] = []
        for place in self._tmac_places():
            try:
                return self._beam.acquire(place, needed=Ready.PROBE_FOUND)
            except NotReadyError:
                raise
            except (TrackingLostError, DeviceFaultError) as error:
                failures.append(error)
            if self._beam.is_on_target and self._is_tmac_at_fault():
                break
        self._is_on_tmac = self._beam.is_on_target
        self._explain_missing_tmac(failures)

    def _is_tmac_at_fault(self) -> bool:
        """Look whether the T-MAC cannot be measured wherever it is: then no other place helps."""
        return self._beam.has_invalid_pose() or Ready.PROBE_FOUND not in self._controller.ready()

    def _tmac_places(self) -> list[Place]:
        """Give where to look for the T-MAC, the likeliest place first."""
        tmac = self._options.tmac
        home = Place(np.array(tmac.p_trk_m), tmac.search_radius_m)
        if self._p_tmac_trk is None:
            return [home]
        last = Place(self._p_tmac_trk, tmac.search_radius_m, direction=self._found_towards)
        # The head stays where the beam broke: the robot may have moved since the last measurement.
        if self._is_on_tmac:
            return [self._here(), last, home]
        if self._lost_towards is not None:
            return [replace(last, direction=self._lost_towards), last, home]
        return [last, home]

    def _here(self) -> Place:
        tmac = self._options.tmac
        p_trk_m = np.array(tmac.p_trk_m) if self._p_tmac_trk is None else self._p_tmac_trk
        return Place(p_trk_m, tmac.search_radius_m, is_pointed_at=True)

    def _explain_missing_tmac(self, failures: list[DeviceError]) -> NoReturn:
        call, ready = self._connection.call, self._controller.ready()
        for failure in failures:
            if isinstance(failure, DeviceFaultError):
                raise failure
        if Ready.MEASUREMENT_CAMERA not in ready:
            raise statuses.error_of(statuses.NO_MEASUREMENT_CAMERA, call, device=self._device)
        if self._beam.is_on_target and Ready.PROBE_FOUND not in ready:
            self._controller.probe_info()
        beginning = f"{self._device}: {call}: "
        reasons = "; ".join(str(failure).removeprefix(beginning) for failure in failures)
        raise TrackingLostError(
            f"{call}: no T-MAC: {reasons}; clear the beam and turn the T-MAC to the tracker; if the"
            " robot has moved meanwhile, drive it back to one of these places, or home (where"
            " options.tmac.p_trk_m has it)",
            device=self._device,
        )

    # --- Reflectors ---

    def check_known(self, target: str) -> None:
        """Return if the options name such a reflector.

        Raises:
            LimitError: They do not.
        """
        self._reflector(target)

    def at_reflector(self, target: str) -> None:
        """Have the beam on a reflector, with the distance meter set for its kind.

        Raises:
            TrackingLostError: It is not there.
            DeviceFaultError: The tracker keeps another kind of reflector; or its own.
        """
        self._ensure_initialised()
        self._controller.set_mode(Mode.POINT)
        self._controller.select_reflector(self._reflector(target).type)
        self.find_reflector(target)

    def find_reflector(self, target: str) -> None:
        """Search where it was last; where that fails the next search starts from the options."""
        self._is_on_tmac = False
        reflector = self._reflector(target)
        p_trk_m = self._p_reflectors_trk.pop(target, np.array(reflector.p_trk_m))
        place = Place(p_trk_m, reflector.search_radius_m)
        self._beam.acquire(place, needed=Ready.REFLECTOR_FOUND)

    def reflector_is_at(self, target: str, p_trk_m: FloatArray) -> None:
        """Remember where a reflector was measured.

        Raises:
            LimitError: That is too far from where it should be.
        """
        reflector = self._reflector(target)
        off_m = float(np.linalg.norm(p_trk_m - np.array(reflector.p_trk_m)))
        if off_m > reflector.search_radius_m:
            raise LimitError(
                f"{self._connection.call}: '{target}' measured {off_m:.3f} m from where"
                f" options.reflectors has it, allowed {reflector.search_radius_m:g} m; it may be"
                " another reflector",
                device=self._device,
            )
        self._p_reflectors_trk[target] = p_trk_m

    def _reflector(self, target: str) -> ReflectorOption:
        reflectors = self._options.reflectors
        if target not in reflectors:
            raise LimitError(
                f"{self._connection.call}: no reflector '{target}'; options.reflectors has:"
                f" {', '.join(reflectors) or 'none'}",
                device=self._device,
            )
        return reflectors[target]
