"""The conversation with one client: requests, replies, what happens meanwhile."""

import asyncio
from collections.abc import Mapping
from typing import Any, Final

from drivers.leica.simulator import packets, results
from drivers.leica.simulator.actions import Actions
from drivers.leica.simulator.codes import Command, DataType, Event, Status, TrackerStatus
from drivers.leica.simulator.connection import Connection, HangUpError
from drivers.leica.simulator.faults import DISCONNECT, EVENTS, SILENT, UNKNOWN_CODE
from drivers.leica.simulator.getters import GETTERS
from drivers.leica.simulator.layout import Values
from drivers.leica.simulator.setters import SETTERS, apply, wrong_parameter
from drivers.leica.simulator.tables import REQUESTS
from drivers.leica.simulator.tracker import RefusedError, Tracker
from tronlab.errors import DeviceTimeoutError
from tronlab.twin.state import Faults

_LOOK_S: Final = 0.1
"""How often the tracker looks what has changed by itself."""

_GREATEST: Final = 1e12
"""Of any number in a request: a world's coordinates in microns stay below."""

_EVENT_OF_STATUS: Final = {
    TrackerStatus.NOT_READY: Event.NOT_READY,
    TrackerStatus.BUSY: Event.BUSY,
    TrackerStatus.READY: Event.READY,
    TrackerStatus.PROBE_INVALID: Event.PROBE_INVALID,
}
_MEASURE: Final = (
    Command.START_MEASUREMENT,
    Command.START_NIVEL_MEASUREMENT,
    Command.GO_AND_MEASURE,
)


class Session:
    """One client and the tracker."""

    def __init__(self, connection: Connection, tracker: Tracker, faults: Faults) -> None:
        self._connection = connection
        self._tracker = tracker
        self._faults = faults
        self._actions = Actions(tracker, faults, self._send)
        self._measuring: asyncio.Task[None] | None = None
        self._announced = tracker.status
        self._had_probe = tracker.has_probe
        self._was_warm = tracker.is_warm

    async def run(self) -> None:
        """Serve the client until one of the two hangs up."""
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._connection.pump())
                tasks.create_task(self._watch())
                await self._converse(tasks)
        except* HangUpError:
            pass
        finally:
            self._tracker.is_busy = False

    async def _converse(self, tasks: asyncio.TaskGroup) -> None:
        while True:
            request = await self._connection.receive()
            if self._faults.strike(DISCONNECT):
                raise HangUpError("told to")
            if not self._faults.strike(SILENT):
                await self._answer(request, tasks)

    async def _answer(self, request: bytes, tasks: asyncio.TaskGroup) -> None:
        kind, command = packets.request_of(request)
        if kind != DataType.COMMAND:
            raise HangUpError(f"data type {kind} in a request")
        layout = REQUESTS.get(command)
        if layout is not None and layout.size != len(request):
            raise HangUpError(f"command {command} has {len(request)} bytes, expected {layout.size}")
        await self._look_at_beam()
        if self._faults.strike(UNKNOWN_CODE):
            self._reply(command, Status.UNHEARD_OF)
        elif layout is None:
            self._reply(command, Status.NOT_IMPLEMENTED)
        else:
            await self._carry_out(command, layout.unpack(request), tasks)

    async def _carry_out(
        self, command: int, values: Mapping[str, Any], tasks: asyncio.TaskGroup
    ) -> None:
        if not _are_sane(values):
            self._reply(command, Status.INVALID_INPUT)
        elif command in GETTERS:
            self._ask(command, values)
        elif command == Command.STOP_MEASUREMENT:
            await self._stop_measuring()
            self._reply(command, Status.OK)
        elif command == Command.CLEAR_COMMAND_QUEUE:
            self._reply(command, Status.OK if values["whose"] < 2 else wrong_parameter(1).status)
        elif command == Command.EXIT_APPLICATION:
            await self._exit()
        elif self._tracker.is_busy:
            self._reply(command, Status.BUSY)
        elif command in SETTERS:
            self._change(Command(command), values)
        else:
            self._begin(command, values, tasks)
        self._announce()

    def _ask(self, command: int, values: Mapping[str, Any]) -> None:
        try:
            bodies = GETTERS[command](self._tracker, values)
        except RefusedError as refusal:
            self._reply(command, refusal.status)
            return
        for body in bodies:
            self._reply(command, Status.OK, body)

    def _change(self, command: Command, values: Mapping[str, Any]) -> None:
        try:
            told = apply(command, self._tracker, values, self._faults)
        except RefusedError as refusal:
            self._reply(command, refusal.status)
            return
        self._reply(command, Status.OK)
        self._tell(told)

    def _begin(self, command: int, values: Mapping[str, Any], tasks: asyncio.TaskGroup) -> None:
        """Begin what takes its time."""
        try:
            self._actions.check(command)
        except RefusedError as refusal:
            self._reply(command, refusal.status)
        except DeviceTimeoutError:
            return
        else:
            self._tracker.is_busy = True
            action = tasks.create_task(self._act(command, values))
            self._measuring = action if command in _MEASURE else None

    async def _act(self, command: int, values: Mapping[str, Any]) -> None:
        tracker = self._tracker
        try:
            body = await self._actions.perform(command, values)
            tracker.is_busy = command in _MEASURE
            self._reply(command, Status.OK, body)
            await self._actions.follow_up(command)
        except RefusedError as refusal:
            tracker.is_busy = False
            self._reply(command, refusal.status)
        except DeviceTimeoutError:
            pass
        finally:
            tracker.is_busy = False
        self._announce()

    async def _stop_measuring(self) -> None:
        """Return when no measurement runs: one that still ended would end the next one too."""
        if self._measuring is not None:
            self._measuring.cancel()
            await asyncio.wait([self._measuring])

    async def _exit(self) -> None:
        self._reply(Command.EXIT_APPLICATION, Status.OK)
        self._tell(Event.CONNECTION_CLOSING)
        await self._connection.flush()
        raise HangUpError("the client said good-bye")

    async def _watch(self) -> None:
        """Notice what changes by itself."""
        while True:
            await asyncio.sleep(_LOOK_S)
            await self._look_at_beam()
            self._look_at_target()
            self._tell_conditions()
            self._announce()

    async def _look_at_beam(self) -> None:
        tracker = self._tracker
        if tracker.target is not None and tracker.is_beam_broken:
            self._actions.measurements.break_beam()
            await self._stop_measuring()
        tracker.recapture()

    def _look_at_target(self) -> None:
        is_disturbing = self._faults.is_armed(EVENTS)
        is_wanted = self._tracker.settings.send_positions and self._tracker.mismatch is None
        if is_disturbing or is_wanted:
            self._send(results.live_position(self._tracker))

    def _tell_conditions(self) -> None:
        has_probe, is_warm = self._tracker.has_probe, self._tracker.is_warm
        if has_probe != self._had_probe:
            self._tell(Event.PROBE)
        if is_warm and not self._was_warm:
            self._tell(Event.LASER_WARMED_UP)
        self._had_probe, self._was_warm = has_probe, is_warm

    def _announce(self) -> None:
        """Tell whether the tracker could measure, if that has changed."""
        status = self._tracker.status
        if status != self._announced:
            self._announced = status
            self._tell(_EVENT_OF_STATUS[status])

    def _tell(self, event: Event) -> None:
        if self._tracker.settings.send_unsolicited:
            self._send(packets.event(event))

    def _reply(self, command: int, status: int, body: Values | None = None) -> None:
        if self._faults.is_armed(EVENTS):
            self._send(packets.event(Event.ENVIRONMENT))
            self._send(results.live_position(self._tracker))
            self._send(packets.event(Event.REFRACTION))
        self._tracker.last_status = status
        self._send(packets.reply(command, status, body))

    def _send(self, packet: bytes) -> None:
        if not self._faults.is_armed(SILENT):
            self._connection.send(packet)


def _are_sane(values: Mapping[str, Any]) -> bool:
    """Look whether all are finite, and small enough to reckon with."""
    numbers = (
        number
        for value in values.values()
        for number in (value if isinstance(value, tuple) else (value,))
    )
    return all(abs(number) <= _GREATEST for number in numbers)
