"""The lamp's supply: SCPI over a serial line, as an Agilent E3632A speaks it."""

from typing import Final

from drivers.room.options import SupplyOptions
from drivers.room.serial_line import SerialLine
from tronlab.devices.readings import DeviceIdentity
from tronlab.errors import DeviceFaultError, LimitError, ProtocolError

OUT_OF_RANGE: Final = -222
"""SCPI: data out of range."""
_MAX_ERRORS: Final = 32
"""More than a supply's queue holds."""
_TOLERANCE: Final = 1e-3
"""A supply rounds what it is told to its own steps."""


class Supply:
    """A supply with one output, remote-controlled from ``connect`` on.

    Args:
        options: Its serial line, voltage and current.
        device: Name of the device whose part it is.
    """

    def __init__(self, options: SupplyOptions, *, device: str) -> None:
        self._options = options
        self._line = SerialLine(options, what="supply", device=device)
        self._device = device

    def connect(self) -> None:
        """Open the line, take over control and forget old errors; the output stays as it is.

        Raises:
            NotConnectedError: The line cannot be opened.
            DeviceTimeoutError: Nobody answers there.
        """
        self._line.open()
        self._tell("SYST:REM")
        self._tell("*CLS")
        self.identify()

    def close(self) -> None:
        """Close the line; the output stays as it is."""
        self._line.close()

    def identify(self) -> DeviceIdentity:
        """Read maker, model, serial number and firmware."""
        answer = self._ask("*IDN?")
        fields = [field.strip() for field in answer.split(",")]
        if len(fields) != 4:
            raise self._nonsense("*IDN?", answer, "four fields with commas between them")
        maker, model, serial, firmware = fields
        return DeviceIdentity(
            maker=maker, model=model, serial="" if serial == "0" else serial, firmware=firmware
        )

    def switch(self, *, on: bool) -> None:
        """Switch the output; on with the voltage and current of the options.

        Raises:
            LimitError: The supply cannot give so much.
            DeviceFaultError: It reports another error, by number, or did not do it.
        """
        if on:
            self._set("VOLT", self._options.voltage_v, key="voltage_v")
            self._set("CURR", self._options.current_a, key="current_a")
        self._command(f"OUTP {'ON' if on else 'OFF'}")
        if self.is_output_on() is not on:
            raise DeviceFaultError(
                f"the supply's output is not {'on' if on else 'off'} after it was switched",
                device=self._device,
                code=0,
            )

    def is_output_on(self) -> bool:
        """Read whether the output is on."""
        answer = self._ask("OUTP?")
        if answer not in {"0", "1"}:
            raise self._nonsense("OUTP?", answer, "0 or 1")
        return answer == "1"

    def is_burning(self) -> bool:
        """Measure whether the output is on and the lamp draws its current."""
        if not self.is_output_on():
            return False
        return self.measure_current_a() >= self._options.burning_current_a

    def measure_current_a(self) -> float:
        """Measure the current, A."""
        return self._number("MEAS:CURR?")

    def _set(self, header: str, value: float, *, key: str) -> None:
        self._command(f"{header} {value:.4f}", key=key)
        kept = self._number(f"{header}?")
        if abs(kept - value) > _TOLERANCE * value:
            raise DeviceFaultError(
                f"the supply was told {header} {value:g}, but has {kept:g}",
                device=self._device,
                code=0,
            )

    def _command(self, command: str, *, key: str | None = None) -> None:
        """Send a command, and read what the supply thinks of it."""
        self._tell(command)
        first = self._read_error()
        if first is None:
            return
        for _ in range(_MAX_ERRORS):
            if self._read_error() is None:
                break
        code, text = first
        if code == OUT_OF_RANGE and key is not None:
            raise LimitError(
                f"the supply refuses {command} (error {code}, {text}); lower supply.{key}",
                device=self._device,
            )
        raise DeviceFaultError(
            f"the supply answers {command} with error {code}, {text}",
            device=self._device,
            code=code,
        )

    def _read_error(self) -> tuple[int, str] | None:
        """Take the oldest error from the supply's queue."""
        answer = self._ask("SYST:ERR?")
        number, comma, text = answer.partition(",")
        try:
            code = int(number)
        except ValueError:
            comma = ""
            code = 0
        if not comma:
            raise self._nonsense("SYST:ERR?", answer, 'NUMBER,"text"')
        return (code, text.strip().strip('"')) if code else None

    def _number(self, query: str) -> float:
        answer = self._ask(query)
        try:
            return float(answer)
        except ValueError:
            raise self._nonsense(query, answer, "a number") from None

    def _ask(self, query: str) -> str:
        self._line.discard()
        self._tell(query)
        line = self._line.read_line(until_s=self._line.deadline_s())
        return line.decode("ascii", "replace").strip()

    def _tell(self, command: str) -> None:
        self._line.write(f"{command}\n".encode("ascii"))

    def _nonsense(self, query: str, answer: str, expected: str) -> ProtocolError:
        return ProtocolError(
            f"supply: {query} answered '{answer}', expected {expected}",
            device=self._device,
            sent=query.encode("ascii"),
            received=answer.encode("utf-8"),
        )
