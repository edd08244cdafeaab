"""The room's PLC: safety is only read, the rest is requested, and the PLC decides."""

import time
from dataclasses import dataclass
from typing import Final

from drivers.room.air import air_reading
from drivers.room.heartbeat import Heartbeat
from drivers.room.modbus import ModbusLink
from drivers.room.options import PlcOptions, WordOrder
from drivers.room.registers import (
    MAGIC,
    MAP_VERSION,
    N_AIR_REGISTERS,
    N_SAFETY_INPUTS,
    N_STATUS_REGISTERS,
    Coil,
    HoldingRegister,
    InputRegister,
    PlcState,
    SafetyInputs,
    count_from_words,
    float_from_words,
)
from tronlab.devices.readings import AirReading, DeviceIdentity
from tronlab.errors import (
    DeviceFaultError,
    DeviceTimeoutError,
    NotReadyError,
    ProtocolError,
)

_VENDOR, _PRODUCT, _REVISION, _PRODUCT_NAME = 0, 1, 2, 4
_POLL_S: Final = 0.1


@dataclass(frozen=True, slots=True)
class PlcStatus:
    """What the PLC says of itself."""

    heartbeat: int
    state: int
    """See ``PlcState``; other numbers are the PLC's own."""
    error_code: int
    """0: none."""


class RoomPlc:
    """The room's PLC, by Modbus TCP.

    A heartbeat runs between ``connect`` and ``close``. When it stops, the PLC drops every request:
    the lamp goes dark.
    """

    def __init__(self, options: PlcOptions, *, device: str) -> None:
        self._options = options
        self._device = device
        self._link = ModbusLink(
            options.host,
            options.port,
            device_id=options.device_id,
            timeout_s=options.timeout_s,
            device=device,
        )
        self._heartbeat: Heartbeat | None = None

    def connect(self) -> None:
        """Connect, see that both sides mean the same registers, and begin the heartbeat.

        Raises:
            NotConnectedError: Nobody listens there.
            ProtocolError: The word order or the version of the map is another.
        """
        self.close()
        self._link.open()
        self._check_word_order()
        self._check_map_version()
        (last_count,) = self._link.read_holding_registers(HoldingRegister.HEARTBEAT, 1)
        heartbeat = Heartbeat(self._beat, last_count=last_count)
        heartbeat.start()
        self._heartbeat = heartbeat

    def close(self) -> None:
        """Stop the heartbeat and disconnect; may be called twice."""
        heartbeat, self._heartbeat = self._heartbeat, None
        if heartbeat is not None:
            heartbeat.stop()
        self._link.close()

    def identify(self) -> DeviceIdentity:
        """Read who made the PLC; one that does not say is a ``Modbus PLC``."""
        objects = self._link.read_identification()
        return DeviceIdentity(
            maker=objects.get(_VENDOR, ""),
            model=objects.get(_PRODUCT_NAME) or objects.get(_PRODUCT) or "Modbus PLC",
            serial="",
            firmware=objects.get(_REVISION, ""),
        )

    def safety(self) -> SafetyInputs:
        """Read the safety inputs.

        Raises:
            DeviceFaultError: The PLC answers, but its program stands: the inputs may be old.
        """
        inputs = self._link.read_discrete_inputs(0, N_SAFETY_INPUTS)
        self._check_alive()
        return SafetyInputs(*inputs)

    def status(self) -> PlcStatus:
        """Read what the PLC says of itself."""
        registers = self._link.read_input_registers(InputRegister.MAP_VERSION, N_STATUS_REGISTERS)
        _, heartbeat, state, error_code = registers
        return PlcStatus(heartbeat=heartbeat, state=state, error_code=error_code)

    def check_ready(self) -> None:
        """Return if the PLC works.

        Raises:
            DeviceFaultError: It reports an error, by number.
            NotReadyError: It is starting.
        """
        status = self.status()
        if status.error_code:
            raise DeviceFaultError(
                "the PLC reports an error", device=self._device, code=status.error_code
            )
        if status.state == PlcState.STARTING:
            raise NotReadyError("the PLC is starting", device=self._device, code=status.state)

    def uptime_s(self) -> float:
        """Read how long the PLC has run, seconds."""
        words = self._link.read_input_registers(InputRegister.UPTIME, 2)
        return float(count_from_words(words, word_order=self._options.word_order))

    def read_air(self) -> AirReading:
        """Read the air by the PLC's own sensor.

        Raises:
            DeviceFaultError: The sensor gives values that no room has.
        """
        words = self._link.read_input_registers(InputRegister.AIR, N_AIR_REGISTERS)
        order = self._options.word_order
        temperature_c, pressure_hpa, humidity_pct = (
            float_from_words(words[i : i + 2], word_order=order) for i in (0, 2, 4)
        )
        try:
            return air_reading(
                temperature_c=temperature_c, pressure_hpa=pressure_hpa, humidity_pct=humidity_pct
            )
        except ValueError as error:
            code = self._error_code()
            raise DeviceFaultError(
                f"the PLC's air sensor: {error}", device=self._device, code=code
            ) from None

    def request_lamp(self, *, on: bool) -> None:
        """Have the lamp's contactor closed or opened; returns when the PLC accepted it."""
        self._request(Coil.LAMP, on=on)

    def is_lamp_requested(self) -> bool:
        """Read whether the PLC keeps the lamp's contactor closed."""
        return self._link.read_coils(Coil.LAMP, 1)[0]

    def set_curtain(self, *, closed: bool) -> None:
        """Close or open the blackout curtain; returns when it is closed, or no longer is.

        Raises:
            DeviceTimeoutError: It takes longer than allowed.
        """
        self._request(Coil.CURTAIN, on=closed)
        timeout_s = self._options.curtain_timeout_s
        end_s = time.monotonic() + timeout_s
        while self.safety().is_curtain_closed is not closed:
            if time.monotonic() > end_s:
                wanted = "closed" if closed else "open"
                raise DeviceTimeoutError(
                    f"the curtain is not {wanted} after {timeout_s:g} s", device=self._device
                )
            time.sleep(_POLL_S)

    def set_warning_light(self, *, on: bool) -> None:
        """Switch the warning light at the door."""
        self._request(Coil.WARNING_LIGHT, on=on)

    def _request(self, coil: Coil, *, on: bool) -> None:
        self._link.write_coil(coil, on=on)
        self._check_alive()
        if self._link.read_coils(coil, 1)[0] is not on:
            what = coil.name.lower().replace("_", " ")
            raise DeviceFaultError(
                f"the PLC did not keep the request: {what} {'on' if on else 'off'}",
                device=self._device,
                code=self._error_code(),
            )

    def _error_code(self) -> int:
        return self._link.read_input_registers(InputRegister.ERROR_CODE, 1)[0]

    def _beat(self, count: int) -> int:
        self._link.write_register(HoldingRegister.HEARTBEAT, count)
        return self._link.read_input_registers(InputRegister.HEARTBEAT, 1)[0]

    def _check_alive(self) -> None:
        allowed_s = self._options.heartbeat_timeout_s
        if self._heartbeat is None or self._heartbeat.still_s <= allowed_s:
            return
        raise DeviceFaultError(
            f"the PLC's program stands: its heartbeat has not changed for"
            f" {self._heartbeat.still_s:.1f} s, allowed {allowed_s:g} s",
            device=self._device,
            code=self._error_code(),
        )

    def _check_word_order(self) -> None:
        words = self._link.read_input_registers(InputRegister.MAGIC, 2)
        order = self._options.word_order
        if float_from_words(words, word_order=order) == MAGIC:
            return
        other: WordOrder = "little" if order == "big" else "big"
        hint = "the PLC's program has another register map"
        if float_from_words(words, word_order=other) == MAGIC:
            hint = f"set plc.word_order to '{other}'"
        raise self._other_map(
            f"input registers 40 and 41 are not the constant {MAGIC:.1f} with"
            f" plc.word_order '{order}'; {hint}"
        )

    def _check_map_version(self) -> None:
        (version,) = self._link.read_input_registers(InputRegister.MAP_VERSION, 1)
        if version != MAP_VERSION:
            raise self._other_map(
                f"the PLC has version {version} of the register map, this driver knows"
                f" {MAP_VERSION}"
            )

    def _other_map(self, message: str) -> ProtocolError:
        sent, received = self._link.last_exchange
        return ProtocolError(message, device=self._device, sent=sent, received=received)
