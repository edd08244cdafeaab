"""Driver of the room: PLC, lamp and air sensor as one device."""

import time
from collections.abc import Generator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Protocol

from drivers.room.air import AirSensor
from drivers.room.dimmer import Dimmer
from drivers.room.lamp import Lamp
from drivers.room.options import RoomOptions
from drivers.room.plc import RoomPlc
from drivers.room.registers import SafetyInputs
from drivers.room.supply import Supply
from tronlab.devices.readings import AirReading, DeviceIdentity, RoomReading
from tronlab.devices.registry import DeviceContext
from tronlab.errors import DeviceError, DeviceFaultError, NotConnectedError, SafetyError


class _Part(Protocol):
    def connect(self) -> None: ...
    def close(self) -> None: ...
    def identify(self) -> DeviceIdentity: ...


class RoomDriver:
    """The room.

    Safety is read, never written: no method of this driver reaches it.

    Args:
        name: What errors call it.
        options: What the room has.
        base_dir: Where relative paths of serial ports start.
    """

    def __init__(self, name: str, options: RoomOptions, *, base_dir: Path = Path()) -> None:
        options = options.located(base_dir)
        self._name = name
        self._plc = RoomPlc(options.plc, device=name)
        self._dimmer = options.dimmer and Dimmer(options.dimmer, device=name)
        self._supply = options.supply and Supply(options.supply, device=name)
        self._air = options.air and AirSensor(options.air, device=name)
        self._lamp = Lamp(
            self._plc,
            self._supply,
            self._dimmer,
            level=options.dimmer.level if options.dimmer else 1.0,
            settle_s=options.lamp_settle_s,
            device=name,
        )
        self._is_connected = False

    @property
    def name(self) -> str:
        """Get the name errors and logs use."""
        return self._name

    def connect(self) -> None:
        """Connect to every part; nothing is switched.

        Raises:
            NotConnectedError: A part cannot be reached; if several failed, all are named.
            DeviceError: A part answers, but not as it should.
        """
        self.close()
        with ExitStack() as undo:
            undo.callback(self.close)
            self._connect_parts()
            undo.pop_all()
        self._is_connected = True

    def close(self) -> None:
        """Disconnect; without its heartbeat the PLC then lets the lamp go dark."""
        self._is_connected = False
        self._lamp.forget()
        for part in self._parts().values():
            with suppress(DeviceError, OSError):
                part.close()

    def identify(self) -> DeviceIdentity:
        """Read who made the PLC, and its revision."""
        with self._call("identify"):
            return self._plc.identify()

    def identify_parts(self) -> dict[str, DeviceIdentity]:
        """Read who made each part of the room, by its key in the options."""
        with self._call("identify_parts"):
            return {key: part.identify() for key, part in self._parts().items()}

    def read(self) -> RoomReading:
        """Read door, lamp and air.

        Raises:
            SafetyError: The emergency stop is pressed, the PLC's watchdog has tripped, or the lamp
                got too hot. An open door is no error but part of the reading.
            NotConnectedError: The PLC has let the lamp go dark since it was switched on.
            NotReadyError: The PLC is starting, or the air sensor has no value yet.
        """
        with self._call("read"), self._safe_cell() as inputs:
            self._plc.check_ready()
            is_lamp_on = self._lamp.look()
            air = self._read_air()
            return RoomReading(
                air_temperature_k=air.temperature_k,
                air_pressure_pa=air.pressure_pa,
                relative_humidity=air.relative_humidity,
                is_door_closed=inputs.is_door_closed,
                is_lamp_on=is_lamp_on,
                time_s=time.time(),
            )

    def switch_lamp(self, *, on: bool) -> None:
        """Switch the lamp; when this returns it burns steadily, or is dark.

        Raises:
            SafetyError: It must not burn now: emergency stop, tripped watchdog, lamp too hot.
            LimitError: The supply cannot give what the options ask for.
            DeviceFaultError: A part reports a fault, or the lamp does not burn.
        """
        with self._call("switch_lamp"):
            if not on:
                self._lamp.switch_off()
                return
            with self._safe_cell():
                self._lamp.switch_on()

    def safety(self) -> SafetyInputs:
        """Read every safety input; raises nothing because of what they say."""
        with self._call("safety"):
            return self._plc.safety()

    def diagnose(self) -> Mapping[str, str]:
        """Read the safety inputs, and which parts the room has; nothing is switched."""
        inputs = asdict(self.safety())
        words = {
            name.removeprefix("is_").replace("_", " "): "yes" if value else "no"
            for name, value in inputs.items()
        }
        parts = {"dimmer": self._dimmer, "supply": self._supply, "air sensor": self._air}
        there = [name for name, part in parts.items() if part is not None]
        return {**words, "besides the PLC": ", ".join(there) or "nothing"}

    def set_curtain(self, *, closed: bool) -> None:
        """Close or open the blackout curtain; returns when it is closed, or no longer is."""
        with self._call("set_curtain"):
            self._plc.set_curtain(closed=closed)

    def set_warning_light(self, *, on: bool) -> None:
        """Switch the warning light at the door."""
        with self._call("set_warning_light"):
            self._plc.set_warning_light(on=on)

    def _connect_parts(self) -> None:
        failures: list[DeviceError] = []
        for part in self._parts().values():
            try:
                with self._naming("connect"):
                    part.connect()
            except DeviceError as error:
                failures.append(error)
        if failures:
            raise self._joined(failures)

    def _parts(self) -> dict[str, _Part]:
        parts: dict[str, _Part | None] = {
            "plc": self._plc,
            "dimmer": self._dimmer,
            "supply": self._supply,
            "air": self._air,
        }
        return {key: part for key, part in parts.items() if part is not None}

    def _read_air(self) -> AirReading:
        return self._air.read() if self._air else self._plc.read_air()

    @contextmanager
    def _safe_cell(self) -> Generator[SafetyInputs]:
        """Refuse to begin in an unsafe cell; a lamp that goes dark as it becomes so is sound."""
        inputs = self._check_safe()
        try:
            yield inputs
        except (DeviceFaultError, NotConnectedError):
            self._check_safe()
            raise

    def _check_safe(self) -> SafetyInputs:
        inputs = self._plc.safety()
        reasons = _stops(inputs)
        if reasons:
            raise SafetyError(
                f"{' and '.join(reasons)}; have a person make the cell safe", device=self._name
            )
        return inputs

    @contextmanager
    def _call(self, call: str) -> Generator[None]:
        if not self._is_connected:
            raise NotConnectedError(
                f"{call}: not connected; call connect() first", device=self._name
            )
        with self._naming(call):
            yield

    @contextmanager
    def _naming(self, call: str) -> Generator[None]:
        """Have the errors of the parts, which do not know it, begin with the call."""
        try:
            yield
        except DeviceError as error:
            error.args = (f"{self._name}: {call}: {self._message(error)}",)
            raise

    def _message(self, error: DeviceError) -> str:
        return str(error).removeprefix(f"{self._name}: ")

    def _joined(self, failures: list[DeviceError]) -> DeviceError:
        if len(failures) == 1:
            return failures[0]
        messages = "".join(f"\n  - {self._message(error)}" for error in failures)
        return NotConnectedError(
            f"connect: {len(failures)} parts failed:{messages}", device=self._name
        )


def _stops(inputs: SafetyInputs) -> list[str]:
    """Give why nothing may go on, if so."""
    reasons = {
        "the emergency stop is pressed": not inputs.is_emergency_stop_released,
        "the PLC's watchdog has tripped": not inputs.is_watchdog_ok,
        "the lamp is too hot": inputs.is_lamp_too_hot,
    }
    return [reason for reason, holds in reasons.items() if holds]


def open_room(context: DeviceContext) -> RoomDriver:
    """Make the room, not yet connected.

    Raises:
        ConfigError: The options are not those of a room.
    """
    return RoomDriver(context.name, context.parse_options(RoomOptions), base_dir=context.base_dir)
