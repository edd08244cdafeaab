"""Options of the room in a rig file: its PLC, and what hangs on serial lines."""

import re
from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias

from pydantic import Field, model_validator

from tronlab.yaml_models import Model

WordOrder: TypeAlias = Literal["big", "little"]
Parity: TypeAlias = Literal["none", "even", "odd"]

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Channel = Annotated[int, Field(ge=1, le=512)]

_NO_FILE: Final = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://|COM\d+$")


class PlcOptions(Model):
    """The PLC, by Modbus TCP."""

    host: Annotated[str, Field(min_length=1)]
    """Name or address."""
    port: Annotated[int, Field(ge=1, le=65535)] = 502
    device_id: Annotated[int, Field(ge=0, le=255)] = 1
    """Also called unit or slave number."""
    word_order: WordOrder = "big"
    """Which half of a 32-bit value has the lower address; checked when connecting."""
    timeout_s: Positive = 1.0
    """For connecting, and for each answer."""
    heartbeat_timeout_s: Positive = 3.0
    """The PLC's count must change within this time; it counts once a second."""
    curtain_timeout_s: Positive = 30.0
    """For the curtain to close or open."""


class SerialOptions(Model):
    """A device on a serial line."""

    path: Annotated[str, Field(min_length=1)]
    """Serial port (relative: to the rig file), ``COM3``, or a URL such as ``socket://host:port``."""
    baud: Annotated[int, Field(ge=50)] = 9600
    data_bits: Literal[7, 8] = 8
    parity: Parity = "none"
    stop_bits: Literal[1, 2] = 1
    timeout_s: Positive = 1.0
    """For each answer."""


class DimmerOptions(SerialOptions):
    """The lamp's dimmer, behind an ENTTEC DMX USB Pro; its USB line has no real baud rate."""

    baud: Annotated[int, Field(ge=50)] = 57600
    channel: Channel = 1
    """DMX channel of the lamp's brightness, or of its coarse half."""
    fine_channel: Channel | None = None
    """DMX channel of the fine half, if the lamp has 16 bits."""
    level: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Of the full light, while the lamp is on."""

    @model_validator(mode="after")
    def _channels_differ(self) -> "DimmerOptions":
        if self.fine_channel == self.channel:
            raise ValueError(f"fine_channel: is {self.channel} like channel; must be another")
        return self


class SupplyOptions(SerialOptions):
    """The lamp's supply, by SCPI; the defaults of its line are an Agilent E3632A's."""

    stop_bits: Literal[1, 2] = 2
    voltage_v: Positive
    current_a: Positive
    """Limit of the current."""
    burning_current_a: Positive = 0.1
    """A lamp that burns draws at least this; a broken one draws none."""


class AirOptions(SerialOptions):
    """The air sensor, a Vaisala PTU300."""

    baud: Annotated[int, Field(ge=50)] = 19200


class RoomOptions(Model):
    """What the room has."""

    plc: PlcOptions
    dimmer: DimmerOptions | None = None
    supply: SupplyOptions | None = None
    air: AirOptions | None = None
    """Without one the air is read from the PLC."""
    lamp_settle_s: NotNegative = 1.0
    """From the last switching until the lamp burns steadily, or is dark."""

    def located(self, base_dir: Path) -> "RoomOptions":
        """Give the same with the paths of serial ports starting at a folder."""
        parts = {"dimmer": self.dimmer, "supply": self.supply, "air": self.air}
        return self.model_copy(
            update={
                name: part and part.model_copy(update={"path": _located(part.path, base_dir)})
                for name, part in parts.items()
            }
        )


def _located(path: str, base_dir: Path) -> str:
    return path if _NO_FILE.match(path) else str(base_dir / Path(path).expanduser())
