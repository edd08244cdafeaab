"""Commands that take their time: what moves the head, and what measures.

Each is a coroutine that may refuse, and then gives the body of its reply; those that measure go on
after the reply with another.
"""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Final, TypeAlias

import numpy as np

from drivers.leica.simulator import packets
from drivers.leica.simulator.codes import Command, Event, Status
from drivers.leica.simulator.faults import BUSY, WARMING_UP
from drivers.leica.simulator.getters import direction_values
from drivers.leica.simulator.layout import Values
from drivers.leica.simulator.measurements import Measurements
from drivers.leica.simulator.presentation import point_of_hvd
from drivers.leica.simulator.setters import out_of_range
from drivers.leica.simulator.settings import SHORTEST_DISTANCE_M
from drivers.leica.simulator.tracker import P_HOME_M, RefusedError, Tracker
from tronlab.geometry.poses import FloatArray
from tronlab.twin.state import Faults

Send: TypeAlias = Callable[[bytes], None]
Arguments: TypeAlias = Mapping[str, Any]
Move: TypeAlias = Callable[[Arguments], Awaitable[Values | None]]

_ALLOWED_UNINITIALISED: Final = (
    Command.INITIALIZE,
    Command.RELEASE_MOTORS,
    Command.SWITCH_LASER,
    Command.START_NIVEL_MEASUREMENT,
)


class Actions:
    """What the tracker does for a client, one thing at a time."""

    def __init__(self, tracker: Tracker, faults: Faults, send: Send) -> None:
        self._tracker = tracker
        self._faults = faults
        self._send = send
        self.measurements = Measurements(tracker, faults, send)
        self._moves: dict[int, Move] = {
            Command.INITIALIZE: self._initialise,
            Command.RELEASE_MOTORS: self._release_motors,
            Command.PARK: self._park,
            Command.SWITCH_LASER: self._switch_laser,
            Command.CHANGE_FACE: self._change_face,
            Command.GO_BIRD_BATH: self._go_home,
            Command.GO_BIRD_BATH_2: self._go_home,
            Command.GO_POSITION: self._go_position,
            Command.GO_POSITION_HVD: self._go_position_hvd,
            Command.GO_LAST_MEASURED_POINT: self._go_last_point,
            Command.POINT_LASER: self._point_laser,
            Command.POINT_LASER_HVD: self._point_laser_hvd,
            Command.POSITION_RELATIVE_HV: self._turn,
            Command.FIND_REFLECTOR: self._find_reflector,
            Command.LOOK_FOR_TARGET: self._look_for_target,
            Command.CHECK_BIRD_BATH: self._check_home,
            Command.START_MEASUREMENT: self._stay,
            Command.START_NIVEL_MEASUREMENT: self._start_nivel,
            Command.GO_AND_MEASURE: self._go_and_measure,
        }

    def knows(self, command: int) -> bool:
        """Look whether the command is one of these."""
        return command in self._moves

    def check(self, command: int) -> None:
        """Return if the tracker can begin with it now.

        Raises:
            RefusedError: It cannot.
            DeviceTimeoutError: A script says that there shall be no answer.
        """
        self._check_ready(command)
        if command == Command.START_MEASUREMENT:
            self.measurements.check()

    async def perform(self, command: int, arguments: Arguments) -> Values | None:
        """Do it, as far as until the reply.

        Returns:
            Body of the reply, if it has one.

        Raises:
            RefusedError: It turned out that the tracker cannot.
        """
        return await self._moves[command](arguments)

    async def follow_up(self, command: int) -> None:
        """Do what comes after the reply: measure."""
        if command == Command.START_NIVEL_MEASUREMENT:
            await self.measurements.measure_nivel()
        elif command in (Command.START_MEASUREMENT, Command.GO_AND_MEASURE):
            await self.measurements.measure()

    def _check_ready(self, command: int) -> None:
        tracker = self._tracker
        if self._faults.strike(BUSY):
            raise RefusedError(Status.BUSY)
        if self._faults.strike(WARMING_UP):
            raise RefusedError(Status.WARMING_UP)
        if command in _ALLOWED_UNINITIALISED:
            return
        if not tracker.is_initialised:
            raise RefusedError(Status.NOT_INITIALISED)
        if not tracker.is_laser_on:
            raise RefusedError(Status.SYSTEM_NOT_READY)

    async def _initialise(self, _arguments: Arguments) -> None:
        tracker = self._tracker
        tracker.is_initialised = False
        await asyncio.sleep(tracker.machine.initialize_s)
        tracker.initialise()

    async def _release_motors(self, _arguments: Arguments) -> None:
        self._tracker.release()

    async def _park(self, _arguments: Arguments) -> None:
        self._tracker.leave()

    async def _switch_laser(self, arguments: Arguments) -> None:
        self._tracker.is_laser_on = bool(arguments["on"])
        if not self._tracker.is_laser_on:
            self._tracker.release()

    async def _change_face(self, _arguments: Arguments) -> None:
        tracker = self._tracker
        if tracker.settings.mode.is_probe:
            raise RefusedError(Status.NO_PROBE_IN_FACE_2)
        await asyncio.sleep(tracker.machine.face_turn_s)
        tracker.face = 3 - tracker.face
        self._tell(Event.FACE_1 if tracker.face == 1 else Event.FACE_2)

    async def _go_home(self, _arguments: Arguments) -> None:
        await asyncio.sleep(self._tracker.slew_s(P_HOME_M))
        self._tracker.lock_home()
        if self._tracker.target is not None:
            self._tell(Event.DISTANCE_SET)

    async def _go_position(self, arguments: Arguments) -> None:
        p_m = self._tracker.settings.presentation.point_trk(arguments["point"])
        await self._go(p_m, with_distance=bool(arguments["use_adm"]))

    async def _go_position_hvd(self, arguments: Arguments) -> None:
        await self._go(self._point_hvd(arguments), with_distance=bool(arguments["use_adm"]))

    async def _go_last_point(self, _arguments: Arguments) -> None:
        if self._tracker.last_point_m is None:
            raise RefusedError(Status.NO_LAST_POINT)
        await self._go(self._tracker.last_point_m, with_distance=True)

    async def _point_laser(self, arguments: Arguments) -> None:
        await self._point(self._tracker.settings.presentation.point_trk(arguments["point"]))

    async def _point_laser_hvd(self, arguments: Arguments) -> None:
        await self._point(self._point_hvd(arguments))

    async def _turn(self, arguments: Arguments) -> None:
        """Turn the beam from where it is; it catches only what it hits."""
        tracker = self._tracker
        rad = tracker.settings.units.rad_per_angle
        d_hz, d_vt = (angle * rad for angle in arguments["angles"])
        p_m = tracker.turned(d_hz, d_vt)
        await self._slew(p_m)
        await self._search(p_m, radius_m=0.0, with_distance=True)

    async def _find_reflector(self, arguments: Arguments) -> None:
        """Search about where the beam points, at the distance the client expects."""
        tracker = self._tracker
        distance_m = arguments["distance"] * tracker.settings.units.m_per_length
        if not distance_m > 0.0:
            raise out_of_range(1)
        if tracker.target is not None:
            return
        await self._must_find(tracker.beam_at(distance_m), with_distance=True)

    async def _look_for_target(self, arguments: Arguments) -> Values:
        tracker = self._tracker
        p_m = tracker.settings.presentation.point_trk(arguments["point"])
        radius_m = arguments["radius"] * tracker.settings.units.m_per_length
        if not radius_m >= 0.0:
            raise out_of_range(4)
        await self._slew(p_m)
        await self._must_find(p_m, radius_m=radius_m, with_distance=True)
        return {"angles": direction_values(tracker)}

    async def _check_home(self, _arguments: Arguments) -> Values:
        tracker = self._tracker
        await asyncio.sleep(tracker.slew_s(P_HOME_M))
        tracker.lock_home()
        if tracker.target is None:
            raise RefusedError(Status.BEAM_BROKEN)
        units = tracker.settings.units
        unit = (units.rad_per_angle, units.rad_per_angle, units.m_per_length)
        initial, difference = tracker.check_home()
        return {
            "initial": [value / each for value, each in zip(initial, unit, strict=True)],
            "difference": [value / each for value, each in zip(difference, unit, strict=True)],
        }

    async def _stay(self, _arguments: Arguments) -> None:
        """Move nothing: the measurement follows the reply."""

    async def _start_nivel(self, _arguments: Arguments) -> None:
        if not self._tracker.settings.has_nivel:
            raise RefusedError(Status.NO_NIVEL)

    async def _go_and_measure(self, arguments: Arguments) -> None:
        p_m = self._tracker.settings.presentation.point_trk(arguments["point"])
        await self._go(p_m, with_distance=True)
        self.measurements.check()

    async def _go(self, p_m: FloatArray, *, with_distance: bool) -> None:
        """Turn there; a target must be found."""
        await self._slew(p_m)
        await self._must_find(p_m, with_distance=with_distance)

    async def _point(self, p_m: FloatArray) -> None:
        """Turn there; a target may be caught."""
        await self._slew(p_m)
        if self._tracker.settings.beam_capture:
            radius_m = self._tracker.settings.search_radius_m
            await self._search(p_m, radius_m=radius_m, with_distance=True)

    async def _slew(self, p_m: FloatArray) -> None:
        if np.linalg.norm(p_m) < SHORTEST_DISTANCE_M:
            raise out_of_range(1)
        await asyncio.sleep(self._tracker.slew_s(p_m))
        self._tracker.release(p_aim_m=p_m)

    async def _must_find(
        self, p_m: FloatArray, *, with_distance: bool, radius_m: float | None = None
    ) -> None:
        """Search; that nothing was found is an error. Its number is not documented."""
        radius_m = self._tracker.settings.search_radius_m if radius_m is None else radius_m
        if not await self._search(p_m, radius_m=radius_m, with_distance=with_distance):
            raise RefusedError(Status.BEAM_BROKEN)

    async def _search(self, p_m: FloatArray, *, radius_m: float, with_distance: bool) -> bool:
        """Search until a target is found, all is searched, or the client's time is over."""
        tracker = self._tracker
        speed = tracker.machine.search_m_per_s
        patience_s = tracker.settings.search_timeout_ms / 1000.0
        found = tracker.nearest(p_m, radius_m=min(radius_m, patience_s * speed))
        await asyncio.sleep(min(patience_s, (radius_m if found is None else found[1]) / speed))
        if found is None or tracker.is_beam_broken:
            return False
        tracker.lock(found[0], with_distance=with_distance)
        if with_distance:
            self._tell(Event.DISTANCE_SET)
        return True

    def _point_hvd(self, arguments: Arguments) -> FloatArray:
        units = self._tracker.settings.units
        hz, vt, distance = arguments["point"]
        rad = units.rad_per_angle
        return point_of_hvd(hz * rad, vt * rad, distance * units.m_per_length)

    def _tell(self, event: Event) -> None:
        if self._tracker.settings.send_unsolicited:
            self._send(packets.event(event))
